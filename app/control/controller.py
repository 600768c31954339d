"""Between session and worker: clicks become jobs, the worker's events become states.

No viser here: the tests drive a whole refinement through this without a browser.
"""

import dataclasses
import logging
from collections.abc import Callable
from typing import Any

from app.control.camera_finder import CameraFinder
from app.control.file_intake import FileIntake
from app.control.projects import Projects
from app.control.resection_solver import ResectionSolver
from app.control.run_control import RunControl, must_be_idle
from app.engine.client import Worker
from app.engine.scene_opening import demo_folder, open_folder
from app.model import reducers
from app.model import session as rules
from app.model.failures import UNFORESEEN, log_failure
from app.model.masks import masks_stamp
from app.model.messages import (
    SPARE_TIME,
    Bake,
    Baked,
    BakingStopped,
    CamerasFound,
    Checked,
    Died,
    Download,
    DrawOverlay,
    Event,
    Failed,
    FindingStopped,
    Live,
    Measured,
    MeasureReach,
    Pack,
    Reached,
    Ready,
    Refine,
    Refined,
    SearchKept,
    SetMask,
    SetScene,
    Stop,
    SurfaceDrawn,
    Timed,
    Watch,
    Working,
)
from app.model.pictures import Compared, Picture
from app.model.session import Session
from app.model.state import Document, Job, Notice, State
from app.model.wanted_pictures import (
    needs_overlay,
    next_comparison,
    shown_cameras,
    wanted_reach,
    wanted_view,
)
from app.web.photo_server import PhotoServer
from photoreg.errors import InputError
from photoreg.formats.cameras.download import CamerasDownload, cameras_download

log = logging.getLogger(__name__)

NOTHING_CHANGED = "Nothing has changed."

Deliver = Callable[[str, bytes], None]
"""Takes a file's name and content, for the person who asked for it."""


class Controller:
    """What the app can do for its user beyond changing a value."""

    def __init__(
        self, session: Session, warm_up: bool = True, projects: Projects | None = None
    ) -> None:
        self.session = session
        self.projects = projects if projects is not None else Projects(session)
        self.pictures = PhotoServer()
        """What pages fetch."""
        self._scene_sent: Document | None = None
        self._reach_asked: MeasureReach | None = None
        self._is_watched = True
        self._deliver: Deliver = _drop
        # One lock for both: listeners run under the session's.
        self._lock = session.lock
        self.worker = Worker(self._hear, warm_up)
        self.refinement = RunControl(session, self.worker, self._send_scene)
        self.finder = CameraFinder(
            session, self.worker, self._send_scene, self.refinement.start
        )
        self.solver = ResectionSolver(session, self._fail)
        self.intake = FileIntake(
            session,
            lambda: must_be_idle(session.state),
            self._tell,
            self.projects.keep_file,
        )
        session.listen(self._follow)
        self._follow(State(), session.state)

    def close(self) -> None:
        """Ends the worker and removes uploaded files."""
        self.solver.close()
        self.worker.close()
        self.intake.close()

    # What the user asks for.

    def open_demo(self) -> None:
        """Opens the demo in place of what is open; undo brings that back."""
        self.open(open_folder(demo_folder()), "Open the demo")

    def open(self, document: Document, name: str) -> None:
        """Makes ``document`` the one that is worked on."""
        must_be_idle(self.session.state)
        self.session.change(
            name,
            lambda state: dataclasses.replace(
                state, document=document, selected=0, texture=None
            ),
        )

    def bake(self) -> None:
        """Makes the textured model of the document's cameras."""
        with self._lock:
            state = self.session.state
            must_be_idle(state)
            if state.document.mesh is None or not state.document.used:
                raise InputError(
                    "A textured model needs a mesh and a photo. Load them in the "
                    "Data tab."
                )
            self._set(job=Job("Making the texture", can_stop=True))
            self._send_scene(state.document)
            document = state.document
            masks = masks_stamp(document.masks)
            self.worker.send(Bake(document.used_cameras, state.texture_config, masks))

    def stop_job(self) -> None:
        """Ends the reading of files or a project at once, the making of a texture after its step."""
        with self._lock:
            if self.intake.cancel() or self.projects.stop_opening():
                return
            job = self.session.state.job
            if job is not None and job.can_stop:
                self._set(
                    job=dataclasses.replace(
                        job, title="Stopping", can_stop=False, is_stopping=True
                    )
                )
                self.worker.send(Stop())

    def pack_model(self, deliver: Deliver) -> None:
        """Has the textured model made into a file; ``deliver`` is then called with it."""
        with self._lock:
            state = self.session.state
            texture = state.texture
            if texture is None:
                raise InputError("Make the texture first.")
            must_be_idle(state)
            self._set(job=Job("Packing the files"))
            self._deliver = deliver
            self._send_scene(state.document)
            made_with = Bake(texture.cameras, texture.config, texture.masks)
            self.worker.send(
                Pack(state.model_choice, made_with, state.texture_is_current)
            )

    def pack_cameras(self) -> CamerasDownload:
        """The document's cameras as a file in the format chosen.

        Raises:
            InputError: if there are none, or this format cannot hold them.
        """
        with self._lock:
            state = self.session.state
            must_be_idle(state)
            document, choice = state.document, state.cameras_choice
            if not document.photos:
                raise InputError(
                    "There are no photos, so there are no cameras to save."
                )
            self._set(job=Job("Writing the cameras"))
        try:
            return cameras_download(
                choice.format,
                {entry.name: entry.camera for entry in document.photos},
                [entry.photo for entry in document.photos],
                document.mesh,
                choice.with_photos,
                choice.undistorted and document.has_lens,
            )
        finally:
            self._set(job=None)

    def watch(self, on: bool) -> None:
        """Says whether any browser looks: a run draws its pictures only then."""
        with self._lock:
            if on != self._is_watched:
                self._is_watched = on
                self.worker.send(Watch(on))

    # What the worker reports.

    def _hear(self, event: Event) -> None:
        try:
            self._on_event(event)
        except Exception as error:  # noqa: BLE001 - nobody clicked, so all are notified.
            self._fail(type(event).__name__, error)

    def _fail(self, what: str, error: Exception) -> None:
        log_failure(what, error)
        try:
            self._tell("That did not work", UNFORESEEN)
        except Exception:
            # Somebody who listens has failed, perhaps with this very error.
            log.exception("A change was not followed")

    def _on_event(self, event: Event) -> None:
        match event:
            case Ready():
                self._set(worker="")
            case Live():
                self.session.change(None, lambda state: reducers.advanced(state, event))
            case SearchKept():
                self._set(kept_search=event.kept)
            case Picture():
                self.session.change(None, lambda state: reducers.pictured(state, event))
            case Measured():
                self._set(agreement=event.agreement)
            case SurfaceDrawn():
                self._set(surface_glb=event.glb)
            case Refined():
                self.session.change(None, lambda state: reducers.ended(state, event))
            case Compared():
                self._set(comparison=event)
            case Checked():
                self.session.change(None, lambda state: reducers.checked(state, event))
            case Reached():
                self._set(reach=event.reach)
            case CamerasFound():
                self.finder.heard(event)
            case FindingStopped():
                self._set(job=None, note="Stopped; the cameras are as they were.")
            case Timed():
                self._set(speed=event.speed)
            case Working():
                self.session.change(None, lambda state: reducers.worked(state, event))
            case Baked():
                self._set(job=None, texture=event.texture, note="The texture is ready.")
            case BakingStopped():
                self._set(job=None, note="Stopped; the texture is as it was.")
            case Download():
                self._set(job=None)
                self._deliver(event.name, event.content)
            case Failed():
                self._on_failure(event)
            case Died():
                self._on_death(event)

    def _on_failure(self, event: Failed) -> None:
        if event.details:
            log.error("%s failed:\n%s", event.job, event.details)
        if event.job in (DrawOverlay.__name__, SPARE_TIME):
            return  # Nothing to see from there; the last picture and numbers stay.
        what, rest = "Drawing", NOTHING_CHANGED
        job = self.session.state.job
        if job is not None and not self.intake.is_busy:
            what = job.title
            self._set(job=None)
        if event.job == Refine.__name__:
            what, rest = "The refinement", self._break_off("The refinement failed")
        if event.details:
            self._tell(f"{what} was cut short", f"{event.message} {rest}")
        else:
            self._tell(f"{what} failed", event.message)

    def _on_death(self, event: Died) -> None:
        log.error("The worker process died (exit code %s)", event.exit_code)
        with self._lock:
            self._scene_sent = self._reach_asked = None
            self.worker.send(Watch(self._is_watched))
        state = self.session.state
        job = state.job if self.intake.is_busy else None
        self._set(job=job, worker="Starting the engine again")
        if state.run.is_active:
            what, rest = "The refinement", self._break_off("The engine died")
        elif state.job is not None and job is None:
            what, rest = state.job.title, NOTHING_CHANGED
        else:
            return
        self._tell(
            f"{what} was cut short",
            f"The engine process died. It is being started again. {rest}",
        )

    def _break_off(self, outcome: str) -> str:
        """Ends the run as it is; returns a sentence on where its result is now."""
        self.session.change(None, lambda state: reducers.broken_off(state, outcome))
        now = self.session.state
        if now.can_go_on:
            return "Tab 3 has it as it was, to go on with."
        return (
            "Its best is in tab 3." if now.run.status == "review" else NOTHING_CHANGED
        )

    # What follows from a change of state.

    def _follow(self, old: State, new: State) -> None:
        """Keeps the pictures up to date with the cameras and the choices."""
        wanted = next_comparison(old, new)
        if wanted is not None:
            with self._lock:
                self._send_scene(new.document)
                self.worker.send(wanted)
        if new.run.is_active:
            if wanted_view(new) != wanted_view(old):
                self.worker.send(wanted_view(new))
            return
        if new.document.mesh is None or not new.document.used:
            return
        with self._lock:
            reach = wanted_reach(new)
            is_drawn = needs_overlay(old, new)
            if is_drawn or reach != self._reach_asked:
                # First, because locks refer to photos by their index.
                self._send_scene(new.document)
            if reach is not None and reach != self._reach_asked:
                self.worker.send(reach)
                self._reach_asked = reach
            if not is_drawn:
                return
            names = tuple(entry.name for entry in new.document.used)
            truth = new.document.true_cameras(names)
            self.worker.send(DrawOverlay(shown_cameras(new), wanted_view(new), truth))

    def _send_scene(self, document: Document) -> None:
        """Sends what of the scene the worker does not have yet."""
        sent = self._scene_sent
        if document.mesh is None:
            return
        if sent is None or not document.shows_same_as(sent):
            photos = tuple(entry.photo for entry in document.used)
            addresses = tuple(self.pictures.address(p, "small") for p in photos)
            self.worker.send(SetScene(document.mesh, photos, document.masks, addresses))
        else:
            masks = enumerate(zip(sent.masks, document.masks, strict=True))
            self.worker.send(
                *(SetMask(i, mask) for i, (known, mask) in masks if mask != known)
            )
        self._scene_sent = document

    def _tell(self, title: str, sentence: str) -> None:
        self._set(notice=Notice(title, sentence))

    def _set(self, **values: Any) -> None:
        self.session.change(None, rules.setting(**values))


def _drop(_name: str, _content: bytes) -> None:
    """Nobody has asked for a file."""
