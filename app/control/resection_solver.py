"""Cameras from point pairs, solved on a thread of its own as the points come in.

No viser here. Solving takes 10 to 100 ms, too long for the thread that serves the page.
"""

import dataclasses
import threading
from collections.abc import Callable, Hashable
from typing import NamedTuple

import numpy as np

from app.model.failures import log_failure
from app.model.session import Session, with_entry
from app.model.state import PhotoEntry, Solution, State
from photoreg.errors import InputError, PhotoregError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.resection.solver import N_POSE, Resection, solve_camera

SURFACE_POINTS = 400
"""Vertices over which the error is foretold."""


class WantedCamera(NamedTuple):
    """A camera that shall stand where its pairs say."""

    photo: str
    step: str
    gesture: Hashable


class ResectionSolver:
    """Keeps ``State.solution`` that of the selected photo's pairs."""

    def __init__(
        self,
        session: Session,
        on_failure: Callable[[str, Exception], None] = log_failure,
    ) -> None:
        """``on_failure`` is called with what failed and the unexpected exception."""
        self._session = session
        self._on_failure = on_failure
        self._wake = threading.Event()
        self._closed = False
        self._lock = threading.Lock()
        self._wanted: WantedCamera | None = None
        self._leave = session.listen(self._follow)
        self._thread = threading.Thread(target=self._run, daemon=True, name="solver")
        self._thread.start()
        self._wake.set()

    def close(self) -> None:
        """Ends the thread."""
        self._leave()
        self._closed = True
        self._wake.set()
        self._thread.join(timeout=5.0)

    def place(self, photo: str, step: str, gesture: Hashable) -> None:
        """Moves the photo's camera to where its pairs say, as soon as that is known.

        Args:
            photo: Name of the photo.
            step: Name of the undo step.
            gesture: That of the click which asked for it; both are one undo step.
        """
        with self._lock:
            self._wanted = WantedCamera(photo, step, gesture)
        self._wake.set()

    def _follow(self, old: State, new: State) -> None:
        before, now = old.selected_photo, new.selected_photo
        if (now and (now.name, now.pairs)) != (before and (before.name, before.pairs)):
            self._wake.set()

    def _run(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._closed:
                return
            try:
                self._solve()
            except Exception as error:  # noqa: BLE001 - the border of a thread: report.
                self._on_failure("Solving the points", error)

    def _solve(self) -> None:
        # Taken before the pairs are read: a wish that comes later is for newer pairs.
        with self._lock:
            wanted, self._wanted = self._wanted, None
        state = self._session.state
        known, selected = state.solution, state.selected_photo
        # By name: while a run goes on, the selected photo has another camera.
        names = {selected and selected.name, wanted and wanted.photo}
        solutions = {
            entry.name: known
            if known is not None and known.is_of(entry)
            else solved(entry, state.document.mesh)
            for entry in state.document.photos
            if entry.name in names
        }
        with self._session.lock:
            if selected is not None:
                solution = solutions[selected.name]
                self._session.change(
                    None, lambda state: dataclasses.replace(state, solution=solution)
                )
            if wanted is not None and wanted.photo in solutions:
                self._place(solutions[wanted.photo], wanted)

    def _place(self, solution: Solution, wanted: WantedCamera) -> None:
        state = self._session.state
        if solution.resection is None or state.run.status != "idle":
            return
        camera = solution.resection.camera
        for i, entry in enumerate(state.document.photos):
            if entry.name == wanted.photo and solution.is_of(entry):
                change = with_entry(i, camera=camera)
                self._session.change(wanted.step, change, wanted.gesture)


def solved(entry: PhotoEntry, mesh: Mesh | None) -> Solution:
    """The camera of a photo's pairs, or why there is none."""
    pairs = entry.whole_pairs
    if len(pairs) < N_POSE:
        return Solution(entry.photo, pairs, None, "")
    try:
        resection = resection_of(entry, mesh)
    except PhotoregError as error:
        return Solution(entry.photo, pairs, None, str(error))
    return Solution(entry.photo, pairs, resection, "")


def resection_of(entry: PhotoEntry, mesh: Mesh | None) -> Resection:
    """Solves the camera of a photo's whole pairs.

    Raises:
        InputError: if the pairs are too few or do not determine a camera.
    """
    pairs = entry.whole_pairs
    if len(pairs) < N_POSE:
        raise InputError(
            f"{len(pairs)} whole pairs so far; {N_POSE} are needed to place the camera."
        )
    surface = None
    if mesh is not None:
        surface = mesh.vertices[:: max(1, len(mesh.vertices) // SURFACE_POINTS)]
    return solve_camera(
        np.array([pair.world for pair in pairs]),
        np.array([pair.pixel for pair in pairs]),
        entry.photo.width,
        entry.photo.height,
        prior_camera(entry.photo),
        surface=surface,
    )


def prior_camera(photo: Photo) -> Camera | None:
    """What EXIF knows of the lens, as a camera somewhere; None if it knows nothing."""
    if photo.exif_focal_px is None:
        return None
    return Camera.look_at(
        (0, 0, 0), (0, 0, 1), (0, 1, 0), photo.exif_focal_px, photo.width, photo.height
    )
