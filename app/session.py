"""The state of the app: one frozen value replaced whole, with undo by name.

No viser and no engine here, only rules; everything on screen is made from the
state, and every click changes the state and nothing else.
"""

import dataclasses
import threading
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Literal

import numpy as np

from photoreg.camera import Camera
from photoreg.errors import InputError, RefinementError
from photoreg.mesh import Mesh
from photoreg.photo import Photo

SAME_CAMERA_TOLERANCE = 1e-10
"""Relative difference under which two cameras count as the same. Poses pass through
quaternions on their way to the page and back, which costs about 1e-15."""

UNDO_STEPS = 200

Status = Literal["idle", "starting", "running", "stopping", "review"]
PresetName = Literal["default", "fast", "thorough", "paper"]
OverlayStyle = Literal["blend", "checkerboard", "difference", "edges"]


def same_camera(a: Camera, b: Camera) -> bool:
    """Whether two cameras are equal to rounding."""
    if a is b:
        return True
    if (a.width, a.height) != (b.width, b.height):
        return False
    scale = max(float(np.abs(a.t_cam_world).max()), 1e-300)
    return (
        bool(np.abs(a.K - b.K).max() <= SAME_CAMERA_TOLERANCE * a.focal_px)
        and bool(np.abs(a.R_cam_world - b.R_cam_world).max() <= SAME_CAMERA_TOLERANCE)
        and bool(
            np.abs(a.t_cam_world - b.t_cam_world).max() <= SAME_CAMERA_TOLERANCE * scale
        )
    )


@dataclasses.dataclass(frozen=True, eq=False)
class PhotoEntry:
    """A photo of the document and the camera it was taken with, as far as known."""

    photo: Photo
    camera: Camera
    enabled: bool = True
    """Whether the refinement and the texture use it."""

    @property
    def name(self) -> str:
        """The photo's file name, unique within the document."""
        return self.photo.name

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, PhotoEntry)
            and self.photo is other.photo
            and self.enabled == other.enabled
            and same_camera(self.camera, other.camera)
        )

    def __hash__(self) -> int:
        return hash((id(self.photo), self.enabled))


@dataclasses.dataclass(frozen=True)
class Document:
    """What the user works on, and what undo brings back."""

    mesh: Mesh | None = None
    display_mesh: Mesh | None = None
    """The mesh, decimated if it is too big to be drawn quickly."""
    photos: tuple[PhotoEntry, ...] = ()
    truth: tuple[tuple[str, Camera], ...] = ()
    """True cameras by photo name, where they are known (the demo)."""
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Upwards in world axes, for the view and for first cameras."""

    @property
    def used(self) -> tuple[PhotoEntry, ...]:
        """The photos that take part."""
        return tuple(entry for entry in self.photos if entry.enabled)

    @property
    def used_cameras(self) -> tuple[Camera, ...]:
        """Cameras of the photos that take part."""
        return tuple(entry.camera for entry in self.used)

    def true_cameras(self, names: Sequence[str]) -> tuple[Camera, ...] | None:
        """The true cameras of these photos, or None unless all are known."""
        known = dict(self.truth)
        if not names or any(name not in known for name in names):
            return None
        return tuple(known[name] for name in names)


@dataclasses.dataclass(frozen=True)
class CurvePoint:
    """One point of the cost curve."""

    step: int
    """Which step of search and polish it is, from 0."""
    best: float
    """Cost of the best, relative to the first."""
    median: float
    """The same of the population's median; equal to ``best`` without one."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A refinement: running, or ended and waiting to be accepted or reverted."""

    status: Status = "idle"
    photo_names: tuple[str, ...] = ()
    start: tuple[Camera, ...] = ()
    cameras: tuple[Camera, ...] = ()
    """The best so far, in the order of ``photo_names``."""
    phase: str = ""
    step: str = ""
    fraction: float = 0.0
    elapsed_s: float = 0.0
    evaluations: int = 0
    curve: tuple[CurvePoint, ...] = ()
    start_cost: float | None = None
    """Photo-inconsistency of the start; known at the end."""
    cost: float | None = None
    """The same of the answer, measured in the same way."""
    start_error_px: float | None = None
    """Mean projection error against the truth, where it is known."""
    error_px: float | None = None
    outcome: str = ""
    """How it ended, in words."""
    warnings: tuple[str, ...] = ()

    @property
    def is_active(self) -> bool:
        """Whether the worker is at it."""
        return self.status in ("starting", "running", "stopping")


@dataclasses.dataclass(frozen=True, eq=False)
class Texture:
    """A textured model as made by the worker."""

    archive: bytes
    """OBJ, MTL and PNG in a zip."""
    glb: bytes
    """The same model for the preview."""
    cameras: tuple[Camera, ...]
    """The cameras it was made with, to tell whether it is still of today."""
    summary: str
    """Size and coverage in words."""


@dataclasses.dataclass(frozen=True)
class Job:
    """Something other than a refinement that the worker does for the user."""

    title: str
    fraction: float = 0.0


@dataclasses.dataclass(frozen=True)
class State:
    """Everything that is on screen, but for each browser's own view."""

    document: Document = dataclasses.field(default_factory=Document)
    selected: int = 0
    mesh_opacity: float = 0.55
    overlay_style: OverlayStyle = "blend"
    overlay_onto: int = 0
    """Index, among the photos used, of the photo the overlay is drawn upon."""
    keep_size: bool = True
    """Whether a change of focal length keeps the object's size in the photo."""
    preset: PresetName = "default"
    dark: bool = True
    show_texture: bool = True
    run: Run = dataclasses.field(default_factory=Run)
    job: Job | None = None
    texture: Texture | None = None
    worker: str = "Starting the engine"
    """What the worker process is about, in words; empty when it is ready."""
    note: str = ""
    """The last thing that happened, for the status line."""
    undo_name: str | None = None
    redo_name: str | None = None

    @property
    def photos(self) -> tuple[PhotoEntry, ...]:
        """The photos with the cameras to show: those of the run while there is one."""
        if self.run.status == "idle":
            return self.document.photos
        shown = dict(zip(self.run.photo_names, self.run.cameras, strict=True))
        return tuple(
            dataclasses.replace(entry, camera=shown.get(entry.name, entry.camera))
            for entry in self.document.photos
        )

    @property
    def selected_photo(self) -> PhotoEntry | None:
        """The photo chosen for alignment."""
        photos = self.photos
        return photos[self.selected] if photos else None

    @property
    def texture_is_current(self) -> bool:
        """Whether the texture was made with the cameras as they are now."""
        now = self.document.used_cameras
        return (
            self.texture is not None
            and len(now) == len(self.texture.cameras)
            and all(map(same_camera, now, self.texture.cameras))
        )


Change = Callable[[State], State]
Listener = Callable[[State, State], None]


class Session:
    """Holds the state; replaces it whole; remembers documents for undo.

    Safe to call from any thread. Listeners are called in the order of the changes,
    with the old and the new state, and must return at once.
    """

    def __init__(self, state: State | None = None) -> None:
        self._state = state if state is not None else State()
        self.lock = threading.RLock()
        """Held during a change; hold it to make several changes as one."""
        self._listeners: list[Listener] = []
        self._past: list[tuple[str, Document]] = []
        self._future: list[tuple[str, Document]] = []
        self._gesture: Hashable = None

    @property
    def state(self) -> State:
        """The state now."""
        return self._state

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Calls ``listener(old, new)`` after each change; returns how to stop that."""
        with self.lock:
            self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def change(
        self, name: str | None, change: Change, gesture: Hashable = None
    ) -> bool:
        """Replaces the state by ``change(state)``.

        Args:
            name: Name of the undo step, like "Move camera 2"; None for changes that
                cannot touch the document.
            change: Makes the new state from the old; may raise, then nothing happens.
            gesture: Changes in a row with the same gesture are one undo step, so a
                drag is one step however many updates it sends.

        Returns:
            Whether anything changed.
        """
        with self.lock:
            old = self._state
            new = change(old)
            if new == old:
                return False
            if new.document != old.document:
                if name is None:
                    raise ValueError("A change of the document needs a name.")
                if old.run.is_active:
                    raise RefinementError(
                        "The refinement is running. Stop it first, or wait for its end."
                    )
                if gesture is None or gesture != self._gesture:
                    self._past.append((name, old.document))
                    del self._past[:-UNDO_STEPS]
                self._future.clear()
                self._gesture = gesture
            self._replace(new)
            return True

    def undo(self) -> str | None:
        """Takes the last step back; returns its name, None if there is none."""
        return self._travel(self._past, self._future)

    def redo(self) -> str | None:
        """Does the step taken back again; returns its name, None if there is none."""
        return self._travel(self._future, self._past)

    def _travel(
        self, source: list[tuple[str, Document]], target: list[tuple[str, Document]]
    ) -> str | None:
        with self.lock:
            if not source:
                return None
            if self._state.run.status != "idle":
                raise RefinementError(
                    "Accept or revert the refinement first; then undo works again."
                    if self._state.run.status == "review"
                    else "The refinement is running. Stop it first."
                )
            name, document = source.pop()
            target.append((name, self._state.document))
            self._gesture = None
            self._replace(dataclasses.replace(self._state, document=document))
            return name

    def _replace(self, new: State) -> None:
        old = self._state
        self._state = dataclasses.replace(
            new,
            selected=min(new.selected, max(0, len(new.document.photos) - 1)),
            overlay_onto=min(new.overlay_onto, max(0, len(new.document.used) - 1)),
            undo_name=self._past[-1][0] if self._past else None,
            redo_name=self._future[-1][0] if self._future else None,
        )
        for listener in tuple(self._listeners):
            listener(old, self._state)


def setting(**values: Any) -> Change:
    """A change of fields of the state that are not the document."""
    return lambda state: dataclasses.replace(state, **values)


def select(index: int) -> Change:
    """Chooses a photo."""

    def change(state: State) -> State:
        if not 0 <= index < len(state.document.photos):
            raise InputError(f"There is no photo {index + 1}.")
        return dataclasses.replace(state, selected=index)

    return change


def with_document(**values: Any) -> Change:
    """A change of fields of the document."""
    return lambda state: dataclasses.replace(
        state, document=dataclasses.replace(state.document, **values)
    )


def with_entry(index: int, **values: Any) -> Change:
    """A change of fields of one photo's entry."""

    def change(state: State) -> State:
        photos = list(state.document.photos)
        if not 0 <= index < len(photos):
            raise InputError(f"There is no photo {index + 1} any more.")
        if state.run.status == "review":
            raise RefinementError("Accept or revert the refinement first.")
        photos[index] = dataclasses.replace(photos[index], **values)
        return with_document(photos=tuple(photos))(state)

    return change


def with_photo_added(photo: Photo, camera: Camera) -> Change:
    """Adds a photo at the end; a name that is taken gets a number."""

    def change(state: State) -> State:
        taken = {entry.name for entry in state.document.photos}
        name, number = photo.name, 2
        while name in taken:
            stem, dot, suffix = photo.name.rpartition(".")
            name = f"{stem}-{number}.{suffix}" if dot else f"{photo.name}-{number}"
            number += 1
        entry = PhotoEntry(dataclasses.replace(photo, name=name), camera)
        photos = (*state.document.photos, entry)
        return dataclasses.replace(
            with_document(photos=photos)(state), selected=len(photos) - 1
        )

    return change


def with_photo_removed(index: int) -> Change:
    """Removes a photo; the files on disk stay."""

    def change(state: State) -> State:
        photos = state.document.photos
        if not 0 <= index < len(photos):
            raise InputError(f"There is no photo {index + 1} any more.")
        return with_document(photos=photos[:index] + photos[index + 1 :])(state)

    return change


def with_cameras(cameras: dict[str, Camera]) -> Change:
    """Replaces the cameras of the photos that are named."""

    def change(state: State) -> State:
        return with_document(
            photos=tuple(
                dataclasses.replace(entry, camera=cameras.get(entry.name, entry.camera))
                for entry in state.document.photos
            )
        )(state)

    return change


def accepted(state: State) -> State:
    """Takes the run's cameras into the document."""
    if state.run.status != "review":
        raise RefinementError("There is no finished refinement to accept.")
    cameras = dict(zip(state.run.photo_names, state.run.cameras, strict=True))
    run = Run(error_px=state.run.error_px)
    return dataclasses.replace(with_cameras(cameras)(state), run=run)


def reverted(state: State) -> State:
    """Leaves the run's cameras; those from before it are in force again."""
    if state.run.status != "review":
        raise RefinementError("There is no finished refinement to revert.")
    return dataclasses.replace(state, run=Run())
