"""What is on screen, as one frozen value: the document, the run, the choices.

No viser and no engine here.
"""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from app.model.durations import Speed
from app.model.masks import decode_mask, encode_mask, masks_stamp
from app.model.pictures import (
    Cloud,
    Compared,
    OverlayStyle,
    Picture,
    Surface,
    ThroughStyle,
)
from app.model.run import KeptSearch, Run
from photoreg.formats.cameras.camera_set import FormatName
from photoreg.formats.models.encode_texture import PictureKind
from photoreg.geometry.camera import Camera, same_camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.gene_box import BoxReach
from photoreg.placing.outcome import Box, PlacingGrade
from photoreg.project.files import FileProblem
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.readiness import Readiness
from photoreg.registration.verdict import Grade
from photoreg.texture.config import TextureConfig

GizmoKind = Literal["move", "orbit"]
UpAxis = Literal["auto", "y", "z"]
Unit = Literal["", "mm", "cm", "m"]
HeldPart = Literal["pose", "focal", "principal_point", "lens"]


@dataclasses.dataclass(frozen=True)
class PointPair:
    """A point of the surface and the same point in a photo; either may be to come."""

    number: int
    """What its markers say; unique within the photo."""
    world: tuple[float, float, float] | None = None
    """On the surface, in world axes."""
    pixel: tuple[float, float] | None = None
    """In the photo; (0, 0) is the centre of the first pixel."""

    @property
    def is_whole(self) -> bool:
        """Whether both points are there."""
        return self.world is not None and self.pixel is not None


@dataclasses.dataclass(frozen=True, eq=False)
class PhotoEntry:
    """A photo of the document and the camera it was taken with, as far as known."""

    photo: Photo
    """Without a mask: a mask that it comes with is moved to ``mask_png``."""
    camera: Camera
    enabled: bool = True
    """Whether the refinement and the texture use it."""
    pairs: tuple[PointPair, ...] = ()
    """Points clicked in the photo and on the surface, by rising number."""
    mask_png: bytes | None = None
    """Where the photo counts, as ``app.model.masks`` encodes it; None: everywhere."""
    cropped: bool | None = None
    """Whether a part of the photo was cut off; None: as its EXIF tells."""
    box: Box | None = None
    """Around the object, as a person drew it: a hint for finding the camera."""

    def __post_init__(self) -> None:
        if self.photo.mask is not None:
            if self.mask_png is None:
                object.__setattr__(self, "mask_png", encode_mask(self.photo.mask))
            object.__setattr__(
                self, "photo", dataclasses.replace(self.photo, mask=None)
            )

    @property
    def name(self) -> str:
        """The photo's file name, unique within the document."""
        return self.photo.name

    @property
    def is_cropped(self) -> bool:
        """Whether its principal point may be far off its middle."""
        return self.photo.is_cropped if self.cropped is None else self.cropped

    @property
    def whole_pairs(self) -> tuple[PointPair, ...]:
        """The pairs of which both points are there."""
        return tuple(pair for pair in self.pairs if pair.is_whole)

    @property
    def masked_photo(self) -> Photo:
        """The photo with its mask, as the engine wants it; made anew at each call."""
        if self.mask_png is None:
            return self.photo
        return dataclasses.replace(self.photo, mask=decode_mask(self.mask_png))

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, PhotoEntry)
            and self.photo is other.photo
            and self.enabled == other.enabled
            and self.pairs == other.pairs
            and self.mask_png == other.mask_png
            and self.cropped == other.cropped
            and self.box == other.box
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
    up_axis: UpAxis = "auto"
    """How ``up`` is found: guessed from mesh and cameras, or as chosen."""
    unit: Unit = ""
    """Of the mesh's coordinates, as a person says; empty: not known."""

    @property
    def has_lens(self) -> bool:
        """Whether the lens of a photo bends anything."""
        return any(not entry.camera.lens.is_ideal for entry in self.photos)

    @property
    def used(self) -> tuple[PhotoEntry, ...]:
        """The photos that take part."""
        return tuple(entry for entry in self.photos if entry.enabled)

    @property
    def used_cameras(self) -> tuple[Camera, ...]:
        """Cameras of the photos that take part."""
        return tuple(entry.camera for entry in self.used)

    @property
    def masks(self) -> tuple[bytes | None, ...]:
        """Masks of the photos that take part, see ``app.model.masks``."""
        return tuple(entry.mask_png for entry in self.used)

    def shows_same_as(self, other: "Document") -> bool:
        """Whether mesh and photos in use are the same, whatever their cameras."""
        ours, theirs = self.used, other.used
        return (
            self.mesh is other.mesh
            and len(ours) == len(theirs)
            and all(a.photo is b.photo for a, b in zip(ours, theirs, strict=True))
        )

    def true_cameras(self, names: Sequence[str]) -> tuple[Camera, ...] | None:
        """The true cameras of these photos, or None unless all are known."""
        known = dict(self.truth)
        if not names or any(name not in known for name in names):
            return None
        return tuple(known[name] for name in names)


@dataclasses.dataclass(frozen=True, eq=False)
class Texture:
    """A textured model as made by the worker."""

    glb: bytes
    """The model for the preview; the worker keeps it whole for downloads."""
    cameras: tuple[Camera, ...]
    """The cameras it was made with, to tell whether it is still of today."""
    config: TextureConfig
    """The settings it was made with, for the same reason."""
    summary: str
    """Size and coverage in words."""
    coverage_jpeg: bytes
    """Which photo paints each texel, and how well; a small picture."""
    coverage: tuple[tuple[str, float, tuple[int, int, int]], ...]
    """Of each photo: name, share of the surface's area, colour in that picture."""
    doubts: tuple[str, ...] = ()
    """What speaks against it, a sentence each."""
    took_s: float = 0.0
    """Seconds that it took to be made."""
    masks: str = ""
    """The masks it was made with, as ``app.model.masks.masks_stamp`` tells them apart."""


ModelFormat = Literal["obj", "glb", "usdz", "ply", "coloured ply"]


@dataclasses.dataclass(frozen=True)
class ModelChoice:
    """What kind of file the textured model is downloaded as."""

    format: ModelFormat = "obj"
    """"coloured ply": colours at the vertices and no texture."""
    picture: PictureKind = "png"


@dataclasses.dataclass(frozen=True)
class CamerasChoice:
    """What kind of file the cameras are downloaded as."""

    format: FormatName = "photoreg"
    with_photos: bool = True
    """Whether photos and mesh go with them, where the format looks for these."""
    undistorted: bool = False
    """Whether photos and cameras are given as ideal lenses would have taken them."""


@dataclasses.dataclass(frozen=True, eq=False)
class FoundCamera:
    """Where the camera of a photo may be, as it was found without a click."""

    photo: str
    """The photo's name."""
    grade: PlacingGrade
    sentence: str
    candidates: tuple[Camera, ...]
    """The most likely poses, the best first."""
    pictures: tuple[bytes, ...]
    """A JPEG of each, with the surface over the photo."""


TELLING_S, TELLING_SHARE = 2.0, 0.1
"""A job that has gone on for less, or has done less, does not tell when it will end."""


@dataclasses.dataclass(frozen=True)
class Job:
    """Something other than a refinement that the worker does for the user."""

    title: str
    fraction: float = 0.0
    can_stop: bool = False
    """Whether the user may end it early."""
    is_stopping: bool = False
    """Whether the user has asked for that."""
    then_refine: bool = False
    """Whether cameras that are found beyond doubt are refined at once."""
    began_s: float = dataclasses.field(default_factory=time.monotonic, compare=False)
    """When, by the monotonic clock."""

    def seconds_left(self, now_s: float) -> float | None:
        """Seconds until it ends, if it goes on as until now; None while that says nothing."""
        gone_s = now_s - self.began_s
        if gone_s < TELLING_S or not TELLING_SHARE <= self.fraction < 1.0:
            return None
        return gone_s * (1.0 - self.fraction) / self.fraction


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """What a photo's point pairs say about its camera."""

    photo: Photo
    pairs: tuple[PointPair, ...]
    """The whole pairs that it was solved from."""
    resection: Any
    """A ``photoreg.resection.solver.Resection``; None if there is no camera."""
    problem: str
    """Why there is none, if there are pairs enough."""

    def is_of(self, entry: "PhotoEntry | None") -> bool:
        """Whether it is that of the photo's pairs as they are."""
        return (
            entry is not None
            and self.photo is entry.photo
            and self.pairs == entry.whole_pairs
        )


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How well the photos agree on the surface, for the cameras on screen."""

    cost: float
    """Photo-consistency cost: trimmed mean of squared colour differences, in CIE LUV;
    infinite where too little is seen in common."""
    chance: float
    """What unrelated colours of the same contrast would cost."""
    share_seen: float
    """Of the points that any photo sees, the share that two or more see."""

    @property
    def share(self) -> float | None:
        """1: the same colours everywhere; 0: no better than chance; None: no overlap."""
        if not np.isfinite(self.cost) or self.chance <= 0.0:
            return None
        return float(np.clip(1.0 - self.cost / self.chance, 0.0, 1.0))


@dataclasses.dataclass(frozen=True)
class WaitingProject:
    """A project that is opened once its files are found."""

    name: str
    problems: tuple[FileProblem, ...]
    """What there is to find, at least one."""


@dataclasses.dataclass(frozen=True, eq=False)
class Notice:
    """A notification shown once to everybody on the page."""

    title: str
    sentence: str


@dataclasses.dataclass(frozen=True, kw_only=True)
class State:
    """Everything that is on screen, but for each browser's own view."""

    document: Document = dataclasses.field(default_factory=Document)
    selected: int = 0
    mesh_opacity: float = 0.55
    photo_gain: float = 1.0
    """Factor on the values of photos that are looked at or through; on screen alone."""
    overlay_style: OverlayStyle = "blend"
    overlay_share: float = 0.5
    """Share of the carried photo in a blend; where the line of a swipe is."""
    through_style: ThroughStyle = "surface"
    gizmo: GizmoKind = "move"
    agreement: Agreement | None = None
    """None until it is measured, or where there are no two photos to compare."""
    live_solve: bool = True
    """Whether a camera is solved anew whenever one of its point pairs changes."""
    chosen_pair: int | None = None
    """Number of the point that the next clicks put elsewhere."""
    solution: Solution | None = None
    """Of the selected photo's pairs; may be of some milliseconds ago."""
    found: tuple[FoundCamera, ...] = ()
    """Of the photos whose cameras were looked for last."""
    keep_size: bool = True
    """Whether a change of focal length keeps the object's size in the photo."""
    preset: PresetName = "default"
    """The settings of the next run, by name."""
    config: RegistrationConfig | None = None
    """Settings changed against the preset; None: the preset's own."""
    held: tuple[tuple[str, HeldPart], ...] = ()
    """What of which photo's camera the next run leaves exactly as it is."""
    one_focal: bool = False
    """Whether the photos were taken with one camera at one zoom: they then get one
    focal length and one lens."""
    start_line: float | None = None
    """Where the line is between the start, on the left, and the overlay now, as a share
    of the width; None: no line."""
    surface: Surface = "photos"
    """What the object shows while cameras of a run are on screen: nothing, the photos laid
    onto it, or where they disagree."""
    dark: bool = True
    show_texture: bool = True
    show_own_colours: bool = True
    """Whether the model wears the colours that the scan came with, where it has any."""
    run: Run = dataclasses.field(default_factory=Run)
    """The run on screen."""
    runs: tuple[Run, ...] = ()
    """All runs that have ended, the oldest first."""
    kept_search: KeptSearch | None = None
    """Of the last run: its newest state, unless it came to its end by itself."""
    readiness: Readiness | None = None
    """Whether a refinement from the cameras on screen can work; None: not yet known."""
    reach: BoxReach | None = None
    """How far the next run looks around the start; None: not known yet."""
    speed: Speed | None = None
    """How fast this machine refines the scene; None: not measured yet."""
    compared_with: int = 0
    """Number of the run that the one on screen is compared with; 0: its start."""
    job: Job | None = None
    texture: Texture | None = None
    texture_config: TextureConfig = TextureConfig()
    """How the next texture is made."""
    model_choice: ModelChoice = ModelChoice()
    cameras_choice: CamerasChoice = CamerasChoice()
    drawn: Picture | None = None
    """The newest pictures of the scene as it is; None until there are some."""
    shows_other: bool = False
    """Whether it is the turn of a blink's other picture."""
    surface_glb: bytes | None = None
    """The newest state of the surface in a run, a GLB file in page axes."""
    cloud: Cloud | None = None
    """Of the search that runs."""
    comparison: Compared | None = None
    """The newest of a run that has ended; may be of the one looked at before."""
    worker: str = "Starting the engine"
    """What the worker process is about, in words; empty when it is ready."""
    note: str = ""
    """The last thing that happened, for the status line."""
    notice: Notice | None = None
    """The last notification."""
    project: Path | None = None
    """The folder that the work is kept in; None: it is not kept."""
    read_only: str = ""
    """Why the document cannot be changed, in one sentence; empty where it can."""
    waiting: WaitingProject | None = None
    """What was to be opened, and asks for its files first."""
    saving: str = ""
    """Why the work is not being kept, in one sentence; empty while it is."""
    undo_name: str | None = None
    redo_name: str | None = None

    @property
    def freedom(self) -> Freedom:
        """What the next run may move, for the photos in use."""
        names = [entry.name for entry in self.document.used]

        def holding(part: HeldPart) -> list[str]:
            return [name for name, p in self.held if p == part and name in names]

        return Freedom.of_photos(
            names,
            lock_focal=holding("focal"),
            lock_principal_point=holding("principal_point"),
            lock_pose=holding("pose"),
            lock_distortion=holding("lens"),
            share_focal=[names] if self.one_focal else (),
            cropped=[e.name for e in self.document.used if e.is_cropped],
        )

    @property
    def can_go_on(self) -> bool:
        """Whether the run on screen was cut short and can go on where it was."""
        kept = self.kept_search
        return (
            self.run.is_cut_short and kept is not None and kept.run == self.run.number
        )

    @property
    def grade(self) -> Grade | None:
        """How far the cameras on screen are to be believed.

        What the run that made them said; None where none did, or they have moved.
        """
        if self.run.status == "review":
            return self.run.grade
        if self.run.is_active or self.document_run is None:
            return None
        return self.document_run.grade

    @property
    def document_run(self) -> Run | None:
        """The run that made the document's cameras; None: none did, or they have moved."""
        used = self.document.used
        names = tuple(entry.name for entry in used)
        for run in reversed(self.runs):
            if run.photo_names == names and all(
                same_camera(entry.camera, camera)
                for entry, camera in zip(used, run.cameras, strict=True)
            ):
                return run
        return None

    @property
    def has_run_cameras(self) -> bool:
        """Whether the cameras on screen are those of a run."""
        return self.run.status != "idle" or self.document_run is not None

    @property
    def wears_run(self) -> bool:
        """Whether the object shows what a run made; a texture is shown by itself."""
        is_textured = self.run.status == "idle" and self.texture_has_cameras
        return self.has_run_cameras and not is_textured

    @property
    def worn(self) -> Surface:
        """What the object shows now."""
        return self.surface if self.wears_run else "clay"

    @property
    def picture(self) -> bytes | None:
        """The overlay, a JPEG file; of a blink the photo whose turn it is."""
        if self.drawn is None:
            return None
        other = self.drawn.other_jpeg if self.shows_other else None
        return self.drawn.jpeg if other is None else other

    @property
    def settings(self) -> RegistrationConfig:
        """The settings of the next run."""
        return self.config or RegistrationConfig.preset(self.preset)

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
    def current_solution(self) -> Solution | None:
        """The solution, if it is that of the selected photo's pairs as they are."""
        solution = self.solution
        if solution is None or not solution.is_of(self.selected_photo):
            return None
        return solution

    @property
    def overlay_onto(self) -> int:
        """Index, among the photos used, of the one the overlay is drawn upon.

        It is the selected one, so that the picture beside the scene and the view
        through a photo show the same.
        """
        used = [i for i, entry in enumerate(self.document.photos) if entry.enabled]
        return used.index(self.selected) if self.selected in used else 0

    @property
    def texture_has_cameras(self) -> bool:
        """Whether the texture was made with the cameras as they are now."""
        now = self.document.used_cameras
        return (
            self.texture is not None
            and len(now) == len(self.texture.cameras)
            and all(map(same_camera, now, self.texture.cameras))
        )

    @property
    def texture_is_current(self) -> bool:
        """Whether the texture was made with cameras, masks and settings as they are now."""
        return (
            self.texture is not None
            and self.texture.config == self.texture_config
            and self.texture.masks == masks_stamp(self.document.masks)
            and self.texture_has_cameras
        )
