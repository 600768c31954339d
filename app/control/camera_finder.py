"""Cameras found without a click: which photos, and what becomes of the answer."""

from collections.abc import Callable

from app.control.run_control import must_be_idle, must_be_ready
from app.engine.client import Worker
from app.model import reducers
from app.model import session as rules
from app.model.messages import CamerasFound, FindCameras
from app.model.session import Session, with_entry
from app.model.state import Document, Job, State
from app.model.up_axis import moved_photos
from photoreg.errors import InputError


class CameraFinder:
    """Finds cameras of the document that is open."""

    def __init__(
        self,
        session: Session,
        worker: Worker,
        send_scene: Callable[[Document], None],
        refine: Callable[[], None],
    ) -> None:
        """``refine`` starts a refinement of the document's cameras."""
        self._session, self._worker = session, worker
        self._send_scene, self._refine = send_scene, refine
        # Shared with the session: listeners run under it.
        self._lock = session.lock

    def find(self, only_selected: bool = False) -> None:
        """Finds the cameras that nobody has placed yet, or that of the selected photo.

        Args:
            only_selected: The selected photo's alone, which may have been placed.

        Raises:
            RefinementError: if there is no mesh, or no photo in use.
            InputError: if there is no such photo among those.
        """
        with self._lock:
            state = self._session.state
            must_be_ready(state)
            wanted = _wanted(state, only_selected)
            if not wanted:
                raise InputError(
                    "Every camera has been placed already. Find this photo's alone, or "
                    "reset those that are wrong."
                )
            self._send(wanted)

    def find_and_refine(self) -> None:
        """Leaves the run on screen, finds all cameras anew, and refines from there.

        The refinement starts where all are found beyond doubt; else they stand where they
        may be, with the poses to pick from.

        Raises:
            RefinementError: if there is no mesh, or no photo in use.
        """
        with self._lock:
            if self._session.state.run.status == "review":
                self._session.change(None, rules.reverted)
            state = self._session.state
            must_be_ready(state)
            self._send(tuple(range(len(state.document.used))), then_refine=True)

    def _send(self, wanted: tuple[int, ...], then_refine: bool = False) -> None:
        document = self._session.state.document
        job = Job("Finding the cameras", can_stop=True, then_refine=then_refine)
        self._session.change(None, rules.setting(job=job, found=()))
        self._send_scene(document)
        boxes = tuple(document.used[i].box for i in wanted)
        self._worker.send(FindCameras(wanted, boxes))

    def heard(self, event: CamerasFound) -> None:
        """Puts the cameras where they may be, as one step of undo; refines if asked to."""
        with self._lock:
            job = self._session.state.job
            self._session.change(
                "Find the cameras", lambda state: reducers.found(state, event)
            )
            are_found = all(one.grade == "found" for one in event.found)
            if job is not None and job.then_refine and are_found:
                self._refine()

    def pick(self, photo: str, place: int) -> None:
        """Puts a photo's camera into one of the poses that were found for it."""
        with self._lock:
            state = self._session.state
            must_be_idle(state)
            (one,) = (found for found in state.found if found.photo == photo)
            for i, entry in enumerate(state.document.photos):
                if entry.name == photo:
                    self._session.change(
                        f"Pose {place + 1} of {photo}",
                        with_entry(i, camera=one.candidates[place]),
                    )


def _wanted(state: State, only_selected: bool) -> tuple[int, ...]:
    """Which of the photos in use."""
    document = state.document
    moved = moved_photos(document)
    selected = state.selected_photo
    return tuple(
        i
        for i, entry in enumerate(document.used)
        if (
            entry is selected
            if only_selected
            else not any(entry is other for other in moved)
        )
    )
