"""What runs inside the worker process: warm up, then one job after the other."""

import contextlib
import dataclasses
import logging
import threading
import time
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Connection

from app.engine.agreement_meter import AgreementMeter
from app.engine.bake_job import BakeJob
from app.engine.finding_job import finding
from app.engine.overlay_job import Drawing
from app.engine.picture_stream import PictureStream
from app.engine.refine_job import Preparation, RefineJob
from app.engine.speed_meter import measure_speed
from app.engine.warm_up import warm_up_steps
from app.model.masks import decode_mask
from app.model.messages import (
    SPARE_TIME,
    Bake,
    BakingStopped,
    Checked,
    DrawOverlay,
    Event,
    Failed,
    FindCameras,
    FindingStopped,
    Job,
    Measured,
    MeasureReach,
    Pack,
    Pause,
    Reached,
    Ready,
    Refine,
    Resume,
    SetMask,
    SetScene,
    Stop,
    Timed,
    Watch,
    Working,
)
from app.model.pictures import Compare, OverlayView
from photoreg.errors import PhotoregError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.registration.check_readiness import check_readiness
from photoreg.search.box_reach import box_reach

REST_S = 0.25
"""So long nothing must have been asked for before time counts as spare: while a camera
is dragged, the next number and picture are wanted every 50 ms."""

PREPARE_REST_S = 0.5
"""The same, once more, before a run is begun: that takes a third of a second, with many
large photos more, and cannot be broken off."""


def run_worker(connection: Connection, warm_up: bool) -> None:
    """Entry of the process: works until the pipe ends."""
    logging.captureWarnings(True)
    try:
        WorkerProcess(connection).run(warm_up)
    except (EOFError, OSError):
        return  # The app is gone, and with it the reason to work.


class WorkerProcess:
    """The loop of the process and the scene it keeps between jobs."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._send_lock = threading.Lock()
        self._mesh: Mesh | None = None
        self._photos: tuple[Photo, ...] = ()
        self._addresses: tuple[str, ...] = ()
        self._drawing: Drawing | None = None
        self._agreement_meter: AgreementMeter | None = None
        self._picture_stream = PictureStream(self._send)
        self._baker = BakeJob()
        self._unchecked: tuple[Camera, ...] | None = None
        self._unreached: tuple[Camera, ...] | None = None
        self._cameras: tuple[Camera, ...] | None = None
        self._reach_of: MeasureReach | None = None
        self._possible: tuple[Camera, ...] | None = None
        self._preparation: Preparation | None = None
        self._prepared_for: object = None
        self._is_timed = self._works_ahead = False
        self._backlog: list[Job] = []

    def run(self, warm_up: bool) -> None:
        """Serves jobs until the pipe ends."""
        self._works_ahead = warm_up
        if warm_up:
            started = time.monotonic()
            with self._failures(SPARE_TIME):
                self._warm_up()
            self._send(Ready(time.monotonic() - started))
        else:
            self._send(Ready(0.0))
        while True:
            # What is wrong with a scene, Refine itself will say.
            with self._failures(SPARE_TIME):
                while not self._backlog and not self._connection.poll(REST_S):
                    if not self._use_spare_time():
                        break
            job = self._backlog.pop(0) if self._backlog else self._connection.recv()
            with self._failures(type(job).__name__):
                self._do(job)

    @contextlib.contextmanager
    def _failures(self, job: str) -> Iterator[None]:
        """Reports what goes wrong with a job; the process goes on."""
        try:
            yield
        except PhotoregError as error:
            self._send(Failed(job, str(error)))
        except EOFError:
            raise  # The app is gone. Where its pipe is broken, sending tells so again.
        except Exception as error:  # noqa: BLE001 - the border of the process: report.
            self._send(Failed(job, cause(error), traceback.format_exc()))

    def _send(self, event: Event) -> None:
        with self._send_lock:
            self._connection.send(event)

    def _do(self, job: Job) -> None:
        match job:
            case SetScene():
                self._mesh, self._photos = job.mesh, masked_photos(job)
                self._addresses = job.addresses
                self._begin_anew()
            case SetMask(photo, png):
                photos = list(self._photos)
                photos[photo] = masked(photos[photo], png)
                self._photos = tuple(photos)
                self._begin_anew()
            case DrawOverlay():
                newer = self._newer_overlay(job)
                # The number first, it is there in no time; the picture on its thread,
                # so that the next number need not wait for it.
                self._measure(newer.cameras)
                self._unchecked = self._unreached = self._cameras = newer.cameras
                self._picture_stream.offer(
                    self._its_drawing(), newer.cameras, newer.view, newer.truth
                )
            case Refine():
                self._refine(job)
            case Bake():
                self._drop_preparation()  # The memory is needed.
                self._bake(job)
            case Pack():
                self._pack(job)
            case FindCameras():
                self._drop_preparation()
                self._find_cameras(job)
            case MeasureReach():
                self._reach_of, self._unreached = job, self._cameras
            case Compare():
                self._compare(job)
            case Watch():
                self._picture_stream.is_watched = job.on
            case OverlayView() | Stop() | Pause() | Resume():
                pass  # Meant for work that has just ended.

    def _begin_anew(self) -> None:
        """Drops what was made of the scene as it was."""
        self._drawing = self._agreement_meter = None
        self._unchecked = self._possible = None
        self._cameras = self._unreached = None
        self._is_timed = False
        self._drop_preparation()

    def _newer_overlay(self, job: DrawOverlay) -> DrawOverlay:
        """Skips overlays that are already overtaken by the next one in the pipe."""
        while not self._backlog and self._connection.poll(0):
            following = self._connection.recv()
            if isinstance(following, DrawOverlay):
                job = following
            else:
                self._backlog.append(following)
        return job

    def _its_drawing(self) -> "Drawing":
        if self._drawing is None:
            self._drawing = Drawing(self._scene_mesh(), self._photos, self._addresses)
        return self._drawing

    def _measure(self, cameras: tuple[Camera, ...]) -> None:
        if len(self._photos) < 2:
            return  # There is nothing to compare one photo with.
        if self._agreement_meter is None:
            self._agreement_meter = AgreementMeter(self._scene_mesh(), self._photos)
        self._send(Measured(self._agreement_meter.agreement(cameras)))

    def _scene_mesh(self) -> Mesh:
        if self._mesh is None:
            raise PhotoregError("There is no mesh yet. Load one in the Data tab.")
        return self._mesh

    def _refine(self, job: Refine) -> None:
        work = RefineJob(
            job,
            self._scene_mesh(),
            self._photos,
            self._its_drawing(),
            self._picture_stream,
            self._measure,
            self._send,
            self._preparation,
        )
        self._drop_preparation()
        work.run(self._messages)

    def _messages(self, wait: bool) -> Iterator[Job]:
        """What the app sent meanwhile; with ``wait`` at least one message."""
        while wait or self._connection.poll(0):
            yield self._connection.recv()
            wait = False

    def _compare(self, job: Compare) -> None:
        self._picture_stream.finish()
        drawing = self._its_drawing()
        self._send(drawing.comparison(job))
        if job.surface != "clay":
            self._send(drawing.surface(job.after, job.surface))

    def _use_spare_time(self) -> bool:
        """While nothing is asked for: what a run would bring, then the run's beginning.

        One part at a time, so that what is asked for meanwhile need not wait for all.

        Returns:
            Whether there was anything to do.
        """
        if self._unchecked is not None:
            self._check(self._unchecked)
        elif self._unreached is not None and self._reach_of is not None:
            self._tell_reach(self._unreached, self._reach_of)
        elif not self._works_ahead or self._possible is None:
            return False
        elif self._prepared_for != (self._possible, self._reach_of):
            if not self._connection.poll(PREPARE_REST_S):
                self._prepare(self._possible)
        elif self._is_timed:
            return False
        else:
            speed = measure_speed(
                self._scene_mesh(),
                self._photos,
                self._possible,
                lambda: self._connection.poll(0),
            )
            if speed is not None:
                self._is_timed = True
                self._send(Timed(speed))
        return True

    def _pack(self, job: Pack) -> None:
        mesh, made_with = self._scene_mesh(), job.made_with
        is_there = self._baker.has(mesh, made_with)
        if not is_there and job.can_be_made:
            self._drop_preparation()
            for step in self._baker.bake(mesh, self._photos, made_with):
                if isinstance(step, Working):
                    self._send(step)
        elif not is_there:
            raise PhotoregError(
                "The engine was started again since the texture was made, and cameras, "
                "masks or settings have changed. Make it anew."
            )
        self._send(Working("Packing the files", 0.96))
        self._send(self._baker.pack(job.choice))

    def _check(self, cameras: tuple[Camera, ...]) -> None:
        """Tells whether a run from there can work."""
        self._unchecked = None
        readiness = check_readiness(self._scene_mesh(), self._photos, cameras)
        self._send(Checked(cameras, readiness))
        self._possible = cameras if readiness.is_possible else None

    def _tell_reach(self, cameras: tuple[Camera, ...], wanted: MeasureReach) -> None:
        """Tells how far a run from there would look."""
        self._unreached, config = None, wanted.config
        reach = box_reach(
            self._scene_mesh(),
            cameras,
            config.box,
            config.camera_model,
            config.coordinates,
            wanted.freedom,
        )
        self._send(Reached(reach))

    def _prepare(self, cameras: tuple[Camera, ...]) -> None:
        """Begins the run that the user is likely to ask for next."""
        wanted = self._reach_of
        self._preparation, self._prepared_for = None, (cameras, wanted)
        if wanted is None:
            return
        _ = self._its_drawing().live_surface
        self._preparation = Preparation(
            self._scene_mesh(), self._photos, cameras, wanted.config, wanted.freedom
        )

    def _drop_preparation(self) -> None:
        self._preparation = self._prepared_for = None

    def _bake(self, job: Bake) -> None:
        mesh = self._scene_mesh()
        for step in self._baker.bake(mesh, self._photos, job):
            self._send(step)
            if isinstance(step, Working) and self._is_told_to_stop():
                self._send(BakingStopped())
                return

    def _find_cameras(self, job: FindCameras) -> None:
        photos = [self._photos[i] for i in job.photos]
        told: Working | None = None
        for step in finding(self._scene_mesh(), photos, job.boxes):
            if step != told:
                self._send(step)
            if isinstance(step, Working):
                told = step
                if self._is_told_to_stop():
                    self._send(FindingStopped())
                    return

    def _is_told_to_stop(self) -> bool:
        """Whether the app sent a stop; what else it sent is kept for afterwards."""
        messages = list(self._messages(wait=False))
        self._backlog += [job for job in messages if not isinstance(job, Stop)]
        return any(isinstance(job, Stop) for job in messages)

    def _warm_up(self) -> None:
        """Compiles every kernel on a toy, and drops it when real work comes."""
        for _ in warm_up_steps():
            if self._connection.poll(0):
                return


def cause(error: Exception) -> str:
    """The user's message for an unexpected error, as the end of a sentence."""
    match error:
        case MemoryError():
            return "there is not enough memory."
        case OSError(strerror=str(reason)):
            return f"the system says: {reason}."
        case _:
            return (
                "photoreg did not foresee this; photoreg.log in the project's folder has "
                "the details."
            )


def masked_photos(scene: SetScene) -> tuple[Photo, ...]:
    """The scene's photos with their masks."""
    if not scene.mask_pngs:
        return scene.photos
    return tuple(
        photo if png is None else masked(photo, png)
        for photo, png in zip(scene.photos, scene.mask_pngs, strict=True)
    )


def masked(photo: Photo, png: bytes | None) -> Photo:
    """The photo with this mask, see `app.model.masks`."""
    return dataclasses.replace(photo, mask=None if png is None else decode_mask(png))
