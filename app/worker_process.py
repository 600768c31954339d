"""What runs inside the worker process: warm up, then one job after the other."""

import logging
import signal
import threading
import time
import traceback
from multiprocessing.connection import Connection

import cv2
import numpy as np

from app.baking import Baker
from app.messages import (
    Bake,
    DrawOverlay,
    Event,
    Failed,
    Job,
    Live,
    LoadMesh,
    LoadPhoto,
    MeshLoaded,
    OverlayView,
    PhotoLoaded,
    Picture,
    Ready,
    Refine,
    Refined,
    SetScene,
    Stop,
    Working,
)
from app.opening import DISPLAY_FACES
from app.state import CurvePoint
from app.warm_up import warm_up_steps
from photoreg.camera import Camera
from photoreg.errors import PhotoregError
from photoreg.evaluate import projection_error
from photoreg.mesh import Mesh, load_mesh
from photoreg.overlay import LiveOverlay
from photoreg.photo import Photo, load_photo
from photoreg.registration import Finished, Progress, RegistrationConfig, refine

PICTURE_PERIOD_S = 0.18
"""Time between overlay pictures during a refinement: five and a half a second."""

PICTURE_SIDE_PX = 1024
LIVE_PERIOD_S = 0.08
ERROR_SAMPLES = 2_000
JPEG_QUALITY = 82


def run_worker(connection: Connection, warm_up: bool) -> None:
    """Entry of the process: works until the pipe ends."""
    # Ctrl-C in the terminal reaches the whole group; only the app decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
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
        self._overlay: LiveOverlay | None = None
        self._baker = Baker()
        self._backlog: list[Job] = []

    def run(self, warm_up: bool) -> None:
        """Serves jobs until the pipe ends."""
        if warm_up:
            started = time.monotonic()
            try:
                self._warm_up()
            except PhotoregError:
                logging.getLogger(__name__).exception("The warm-up failed")
            self._send(Ready(time.monotonic() - started))
        else:
            self._send(Ready(0.0))
        while True:
            job = self._backlog.pop(0) if self._backlog else self._connection.recv()
            try:
                self._do(job)
            except PhotoregError as error:
                self._send(Failed(type(job).__name__, str(error)))
            except (EOFError, OSError, MemoryError) as error:
                if isinstance(error, MemoryError):
                    text = "There is not enough memory for that."
                    self._send(Failed(type(job).__name__, text, traceback.format_exc()))
                else:
                    raise
            except Exception:  # noqa: BLE001 - the border of the process: report.
                text = "That crashed; the terminal has the details."
                self._send(Failed(type(job).__name__, text, traceback.format_exc()))

    def _send(self, event: Event) -> None:
        with self._send_lock:
            self._connection.send(event)

    def _do(self, job: Job) -> None:
        match job:
            case SetScene():
                self._mesh, self._photos = job.mesh, job.photos
                self._overlay = None
            case LoadMesh():
                mesh = load_mesh(job.path)
                self._send(Working(f"Reading {mesh.name}", 0.6))
                self._send(MeshLoaded(mesh, mesh.decimated(DISPLAY_FACES)))
            case LoadPhoto():
                self._send(PhotoLoaded(load_photo(job.path)))
            case DrawOverlay():
                newer = self._newer_overlay(job)
                self._send(self._draw(newer.cameras, newer.view, newer.truth))
            case Refine():
                self._refine(job)
            case Bake():
                self._bake(job)
            case OverlayView() | Stop():
                pass  # Meant for a refinement that has just ended.

    def _newer_overlay(self, job: DrawOverlay) -> DrawOverlay:
        """Skips overlays that are already overtaken by the next one in the pipe."""
        while not self._backlog and self._connection.poll(0):
            following = self._connection.recv()
            if isinstance(following, DrawOverlay):
                job = following
            else:
                self._backlog.append(following)
        return job

    def _draw(
        self,
        cameras: tuple[Camera, ...],
        view: OverlayView,
        truth: tuple[Camera, ...] | None,
    ) -> Picture:
        mesh = self._scene_mesh()
        if self._overlay is None:
            self._overlay = LiveOverlay(mesh, self._photos, PICTURE_SIDE_PX)
        onto = view.onto % len(cameras)
        carried = (onto + 1) % len(cameras)
        picture = self._overlay.picture(cameras, onto, carried, view.style)
        return Picture(encode_jpeg(picture), true_error(mesh, truth, cameras))

    def _scene_mesh(self) -> Mesh:
        if self._mesh is None:
            raise PhotoregError("There is no mesh yet. Load one in the Data tab.")
        return self._mesh

    def _refine(self, job: Refine) -> None:
        mesh = self._scene_mesh()
        start_error = true_error(mesh, job.truth, job.cameras)
        best, finished, last = job.cameras, None, None
        sent_at, curve, costs = -np.inf, [], CostCurve()
        with LivePainter(self, job) as painter:
            config = RegistrationConfig.preset(job.preset)
            for event in refine(mesh, self._photos, job.cameras, config):
                best = tuple(event.cameras)
                if isinstance(event, Finished):
                    finished = event
                    break
                last = event
                painter.offer(best)
                now = time.monotonic()
                curve.extend(costs.points(event))
                if now - sent_at >= LIVE_PERIOD_S:
                    self._send(Live(event, tuple(curve)))
                    sent_at = now
                    curve.clear()
                if self._must_stop(painter):
                    break
        if last is not None:
            self._send(Live(last, tuple(curve)))
        self._send(self._draw(best, painter.view, job.truth))
        error = true_error(mesh, job.truth, best)
        self._send(Refined(best, finished, start_error, error))

    def _must_stop(self, painter: "LivePainter") -> bool:
        while self._connection.poll(0):
            message = self._connection.recv()
            if isinstance(message, Stop):
                return True
            if isinstance(message, OverlayView):
                painter.view = message
            else:
                self._backlog.append(message)
        return False

    def _bake(self, job: Bake) -> None:
        mesh = self._scene_mesh()
        for step in self._baker.bake(mesh, self._photos, job.cameras):
            self._send(step)

    def _warm_up(self) -> None:
        """Compiles every kernel on a toy, and drops it when real work comes."""
        for _ in warm_up_steps():
            if self._connection.poll(0):
                return


class LivePainter:
    """Draws overlays of the newest cameras on its own thread while the search runs.

    The overlay's kernels are not parallel and hold no lock, so they run beside the
    search on another core; the search never waits for a picture.
    """

    def __init__(self, process: WorkerProcess, job: Refine) -> None:
        self.view = job.view
        self._process = process
        self._truth = job.truth
        self._newest: tuple[Camera, ...] | None = None
        self._wake = threading.Event()
        self._done = False
        self._thread = threading.Thread(target=self._paint, daemon=True)

    def __enter__(self) -> "LivePainter":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done = True
        self._wake.set()
        self._thread.join()

    def offer(self, cameras: tuple[Camera, ...]) -> None:
        """The cameras to draw next, unless newer ones come first."""
        self._newest = cameras
        self._wake.set()

    def _paint(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._done:
                return
            cameras, started = self._newest, time.monotonic()
            if cameras is None:
                continue
            try:
                self._process._send(
                    self._process._draw(cameras, self.view, self._truth)
                )
            except (PhotoregError, OSError):
                # A pose from which nothing is seen has no picture; the run goes on.
                continue
            # Never more than two fifths of a core, however slow this machine is.
            spent = time.monotonic() - started
            time.sleep(max(PICTURE_PERIOD_S - spent, 1.5 * spent, 0.0))


class CostCurve:
    """The cost relative to the first one, as one curve over all phases.

    Costs compare only while they are measured the same way: search and polish, and
    the polish's levels, have measures of their own. Where the measure changes, which
    shows as a rise of the best, the curve goes on from where it was.
    """

    def __init__(self) -> None:
        self._cost: float | None = None
        self._level = 1.0
        self._step = -1

    def points(self, event: Progress) -> list[CurvePoint]:
        """The event's point; none before there is a cost."""
        best, median = event.best_cost, event.median_cost
        if not 0.0 < best < np.inf:
            return []
        if self._cost is not None:
            self._level *= min(1.0, best / self._cost)
        self._cost = best
        self._step += 1
        spread = median / best if best <= median < np.inf else 1.0
        return [CurvePoint(self._step, self._level, self._level * spread)]


def encode_jpeg(picture: np.ndarray) -> bytes:
    """A picture (h, w, 3) in sRGB bytes as a JPEG file."""
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert done
    return data.tobytes()


def true_error(
    mesh: Mesh, truth: tuple[Camera, ...] | None, cameras: tuple[Camera, ...]
) -> float | None:
    """Mean projection error in pixels (eq. 5), None where the truth is not known."""
    if truth is None:
        return None
    return projection_error(mesh, truth, cameras, n_samples=ERROR_SAMPLES).mean
