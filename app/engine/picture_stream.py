"""The pictures that stream from a run to the page: always the newest, none twice."""

import contextlib
import threading
import time
import traceback
from collections.abc import Callable, Iterator

import numpy as np

from app.engine.overlay_job import Drawing
from app.model.messages import DrawOverlay, Event, Failed
from app.model.pictures import OverlayView
from photoreg.errors import PhotoregError
from photoreg.geometry.camera import Camera

SURFACE_PERIOD_S = 0.5
"""Time between two states of the surface during a refinement."""


class PictureStream:
    """Draws the newest cameras on its own thread, and skips what is overtaken.

    The overlay's kernels are not parallel and hold no lock, so they run beside a
    search on another core; neither search nor measurement waits for a picture.
    """

    def __init__(self, send: Callable[[Event], None]) -> None:
        self.is_watched = True
        """Whether anybody is watching the pictures of the running refinement."""
        self._send = send
        self._newest: Callable[[], Iterator[Event]] | None = None
        self._surface_at = -np.inf
        self._is_passing = False
        self._changed = threading.Condition()
        self._is_busy = False
        threading.Thread(target=self._paint, daemon=True, name="picture stream").start()

    def offer(
        self,
        drawing: Drawing,
        cameras: tuple[Camera, ...],
        view: OverlayView,
        truth: tuple[Camera, ...] | None,
        start: tuple[Camera, ...] | None = None,
    ) -> None:
        """What to draw next, unless something newer comes first.

        With ``start``, a refinement is going on: the surface is drawn now and then, nothing
        if nobody looks, and pauses leave most of a core to the search.
        """
        if start is not None and not self.is_watched:
            return

        def draw() -> Iterator[Event]:
            is_passing = start is not None
            yield drawing.picture(cameras, view, truth, start, is_passing)
            now = time.monotonic()
            if is_passing:
                is_due = now - self._surface_at >= SURFACE_PERIOD_S
            else:
                is_due = not drawing.is_newest_surface(cameras, view.surface)
            if view.surface != "clay" and is_due:
                self._surface_at = now
                yield drawing.surface(cameras, view.surface)

        with self._changed:
            self._newest, self._is_passing = draw, start is not None
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
                draw, is_passing = self._newest, self._is_passing
                assert draw is not None
                self._newest, self._is_busy = None, True
            worked = time.thread_time()
            try:
                for event in draw():
                    self._send(event)
            except PhotoregError as error:
                # A pose from which nothing is seen has no picture.
                self._send(Failed(DrawOverlay.__name__, str(error)))
            except (EOFError, OSError):
                return  # The app is gone.
            except Exception:  # noqa: BLE001 - the border of a thread: report.
                # Without memory there may be none to tell so; the next one is tried.
                with contextlib.suppress(MemoryError):
                    self._send(
                        Failed(
                            DrawOverlay.__name__, "No picture.", traceback.format_exc()
                        )
                    )
            finally:
                # Whatever becomes of a picture, nobody waits for it in vain.
                with self._changed:
                    self._is_busy = False
                    self._changed.notify_all()
            if is_passing:
                # Never more than two fifths of a core, however large the scene is. Time
                # that others had the core does not count: it slows the search already.
                time.sleep(1.5 * (time.thread_time() - worked))
