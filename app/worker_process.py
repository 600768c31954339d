"""What runs inside the worker process: warm up, then one job after the other."""

import dataclasses
import logging
import signal
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection

import cv2
import numpy as np

from app.baking import Baker
from app.judge import Judge
from app.masks import decode_mask
from app.messages import (
    Bake,
    DrawOverlay,
    Event,
    Failed,
    Job,
    Live,
    LoadMesh,
    LoadPhoto,
    Measured,
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
from photoreg.overlay import AlignedPair, LiveOverlay, compose
from photoreg.photo import Photo, load_photo
from photoreg.registration import Finished, Progress, RegistrationConfig, refine
from photoreg.surface_lines import SurfaceLines, shaded_normals

PICTURE_PERIOD_S = 0.18
"""Time between overlay pictures during a refinement: five and a half a second."""

PICTURE_SIDE_PX = 1024
LIVE_PERIOD_S = 0.08
JUDGE_PERIOD_S = 0.3
"""Time between measurements during a refinement: 2 ms each, under a hundredth of it."""

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
        self._drawing: Drawing | None = None
        self._judge: Judge | None = None
        self._painter = Painter(self._send)
        self._baker = Baker()
        self._view = OverlayView("blend", 0)
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
                self._mesh, self._photos = job.mesh, masked_photos(job)
                self._drawing = self._judge = None
            case LoadMesh():
                mesh = load_mesh(job.path)
                self._send(Working(f"Reading {mesh.name}", 0.6))
                self._send(MeshLoaded(mesh, mesh.decimated(DISPLAY_FACES)))
            case LoadPhoto():
                self._send(PhotoLoaded(load_photo(job.path)))
            case DrawOverlay():
                newer = self._newer_overlay(job)
                # The number first, it is there in no time; the picture on its thread,
                # so that the next number need not wait for it.
                self._measure(newer.cameras)
                self._painter.offer(
                    self._its_drawing(), newer.cameras, newer.view, newer.truth
                )
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

    def _its_drawing(self) -> "Drawing":
        if self._drawing is None:
            self._drawing = Drawing(self._scene_mesh(), self._photos)
        return self._drawing

    def _measure(self, cameras: tuple[Camera, ...]) -> None:
        if self._judge is None:
            self._judge = Judge(self._scene_mesh(), self._photos)
        self._send(Measured(self._judge.agreement(cameras)))

    def _scene_mesh(self) -> Mesh:
        if self._mesh is None:
            raise PhotoregError("There is no mesh yet. Load one in the Data tab.")
        return self._mesh

    def _refine(self, job: Refine) -> None:
        mesh = self._scene_mesh()
        start_error = true_error(mesh, job.truth, job.cameras)
        best, finished, last = job.cameras, None, None
        sent_at, judged_at, curve, costs = -np.inf, -np.inf, [], CostCurve()
        drawing, self._view = self._its_drawing(), job.view
        config = RegistrationConfig.preset(job.preset)
        for event in refine(mesh, self._photos, job.cameras, config):
            best = tuple(event.cameras)
            if isinstance(event, Finished):
                finished = event
                break
            last = event
            self._painter.offer(drawing, best, self._view, job.truth, PICTURE_PERIOD_S)
            now = time.monotonic()
            curve.extend(costs.points(event))
            if now - sent_at >= LIVE_PERIOD_S:
                self._send(Live(event, tuple(curve)))
                sent_at = now
                curve.clear()
            if now - judged_at >= JUDGE_PERIOD_S:
                self._measure(best)
                judged_at = now
            if self._must_stop():
                break
        if last is not None:
            self._send(Live(last, tuple(curve)))
        self._measure(best)
        self._painter.finish()
        self._send(drawing.picture(best, self._view, job.truth))
        error = true_error(mesh, job.truth, best)
        self._send(Refined(best, finished, start_error, error))

    def _must_stop(self) -> bool:
        while self._connection.poll(0):
            message = self._connection.recv()
            if isinstance(message, Stop):
                return True
            if isinstance(message, OverlayView):
                self._view = message
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


class Drawing:
    """Pictures of one scene; what does not change is prepared once."""

    def __init__(self, mesh: Mesh, photos: tuple[Photo, ...]) -> None:
        self._mesh = mesh
        self._photos = photos
        self._overlay = LiveOverlay(mesh, photos, PICTURE_SIDE_PX)
        self._lines: SurfaceLines | None = None
        self._pair: tuple[object, AlignedPair] | None = None

    def picture(
        self,
        cameras: tuple[Camera, ...],
        view: OverlayView,
        truth: tuple[Camera, ...] | None,
    ) -> Picture:
        """The overlay, and what a view through the photo needs beside it."""
        overlay, onto = self._overlay, view.onto % len(cameras)
        key = (onto, tuple(map(id, cameras)))
        if self._pair is None or self._pair[0] != key:
            # A slider of the overlay's asks for the same pair again and again. The
            # cameras are kept with it: ids of living objects do not repeat.
            carried = (onto + 1) % len(cameras)
            self._pair = (key, overlay.pair(cameras, onto, carried))
            self._cameras = cameras
        pair = self._pair[1]
        other = normals = lines = None
        if view.style == "blink":
            jpeg = encode_jpeg(pair.base)
            other = encode_jpeg(compose(pair, "carried"))
        else:
            jpeg = encode_jpeg(compose(pair, view.style, view.share))
        if view.through == "normals":
            normals = encode_jpeg(
                shaded_normals(
                    overlay.mesh, overlay.photos[onto], cameras[onto], view.mesh_opacity
                )
            )
        if view.through == "lines":
            if self._lines is None:
                self._lines = SurfaceLines(overlay.mesh)
            lines = self._lines.seen_from(cameras[onto])
        return Picture(
            jpeg,
            true_error(self._mesh, truth, cameras),
            other,
            self._photos[onto].name,
            normals,
            lines,
        )


class Painter:
    """Draws the newest cameras on its own thread, and skips what is overtaken.

    The overlay's kernels are not parallel and hold no lock, so they run beside a
    search on another core; neither search nor measurement waits for a picture.
    """

    def __init__(self, send: Callable[[Event], None]) -> None:
        self._send = send
        self._newest: Callable[[], Picture] | None = None
        self._period_s = 0.0
        self._changed = threading.Condition()
        self._is_busy = False
        threading.Thread(target=self._paint, daemon=True, name="painter").start()

    def offer(
        self,
        drawing: Drawing,
        cameras: tuple[Camera, ...],
        view: OverlayView,
        truth: tuple[Camera, ...] | None,
        period_s: float = 0.0,
    ) -> None:
        """What to draw next, unless something newer comes first."""
        with self._changed:
            self._newest = lambda: drawing.picture(cameras, view, truth)
            self._period_s = period_s
            self._changed.notify_all()

    def finish(self) -> None:
        """Drops what waits, and waits until nothing is being drawn."""
        with self._changed:
            self._newest = None
            self._changed.wait_for(lambda: not self._is_busy)

    def _paint(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None)
                draw, period_s = self._newest, self._period_s
                assert draw is not None
                self._newest, self._is_busy = None, True
            started = time.monotonic()
            try:
                self._send(draw())
            except PhotoregError as error:
                # A pose from which nothing is seen has no picture.
                self._send(Failed(DrawOverlay.__name__, str(error)))
            except (EOFError, OSError):
                return  # The app is gone.
            except Exception:  # noqa: BLE001 - the border of a thread: report.
                self._send(
                    Failed(DrawOverlay.__name__, "No picture.", traceback.format_exc())
                )
            with self._changed:
                self._is_busy = False
                self._changed.notify_all()
            if period_s > 0.0:
                # Never more than two fifths of a core, however slow this machine is.
                spent = time.monotonic() - started
                time.sleep(max(period_s - spent, 1.5 * spent, 0.0))


def masked_photos(scene: SetScene) -> tuple[Photo, ...]:
    """The scene's photos with their masks."""
    if not scene.mask_pngs:
        return scene.photos
    return tuple(
        photo if png is None else dataclasses.replace(photo, mask=decode_mask(png))
        for photo, png in zip(scene.photos, scene.mask_pngs, strict=True)
    )


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
