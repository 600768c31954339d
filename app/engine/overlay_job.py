"""Pictures of a scene, drawn in the worker: overlays, comparisons, the live surface."""

import dataclasses
import functools

import numpy as np

from app.engine.surface_job import LiveSurface
from app.model.camera_moves import DisplayFrame
from app.model.messages import SurfaceDrawn
from app.model.pictures import Compare, Compared, OverlayView, Picture, Surface
from photoreg.geometry.camera import Camera, same_camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import Truth
from photoreg.imaging.photo import Photo
from photoreg.overlay.pictures import AlignedPair, LiveOverlay, compose, swipe
from photoreg.overlay.surface_lines import SurfaceLines, shaded_normals
from photoreg.report.comparison import (
    PICTURE_SIDE_PX,
    aligned_pair,
    draw_comparison,
    jpeg,
)

ERROR_SAMPLES = 2_000


@dataclasses.dataclass(frozen=True, eq=False)
class _Drawn:
    """The pair drawn last, and what it was drawn for."""

    onto: int
    quick: bool
    cameras: tuple[Camera, ...]
    pair: AlignedPair

    def is_of(self, onto: int, quick: bool, cameras: tuple[Camera, ...]) -> bool:
        return (self.onto, self.quick) == (onto, quick) and all(
            map(same_camera, self.cameras, cameras)
        )


class Drawing:
    """Pictures of one scene; what does not change is prepared once."""

    def __init__(
        self, mesh: Mesh, photos: tuple[Photo, ...], addresses: tuple[str, ...] = ()
    ) -> None:
        """Makes ready; ``addresses`` as `app.model.messages.SetScene` has them."""
        self._mesh = mesh
        self._photos, self._addresses = photos, addresses
        self._overlay = LiveOverlay(mesh, photos, PICTURE_SIDE_PX)
        self._lines: SurfaceLines | None = None
        self._pair: _Drawn | None = None
        self._start: tuple[object, np.ndarray] | None = None
        self._truth: Truth | None = None
        self._surface: tuple[tuple[Camera, ...], Surface] | None = None

    def true_error(
        self, truth: tuple[Camera, ...] | None, cameras: tuple[Camera, ...]
    ) -> float | None:
        """Mean projection error in pixels (eq. 5).

        None where the truth is not known, or the surface is behind a camera.
        """
        if truth is None:
            return None
        known = self._truth
        if known is None or not all(map(same_camera, known.cameras, truth)):
            # What the true cameras see is nine tenths of the work.
            self._truth = known = Truth(self._mesh, truth, ERROR_SAMPLES)
        error = known.projection_error(cameras).mean
        return error if np.isfinite(error) else None

    def picture(
        self,
        cameras: tuple[Camera, ...],
        view: OverlayView,
        truth: tuple[Camera, ...] | None,
        start: tuple[Camera, ...] | None = None,
        is_passing: bool = False,
    ) -> Picture:
        """The overlay, and what a view through the photo needs beside it.

        Args:
            cameras: One a photo.
            view: What to draw.
            truth: The true cameras, where they are known.
            start: The cameras before, for a line between before and now.
            is_passing: Whether the next picture is on its way, so that a quick one will
                do where it looks like a sharp one: 18 ms instead of 46.
        """
        overlay, onto = self._overlay, view.onto % len(cameras)
        quick = is_passing and view.style not in ("difference", "edges")
        if self._pair is None or not self._pair.is_of(onto, quick, cameras):
            # A slider of the overlay's asks for the same pair again and again; of a
            # search the best stays for one generation in two, or three.
            self._pair = _Drawn(
                onto, quick, cameras, aligned_pair(overlay, cameras, onto, quick)
            )
        pair = self._pair.pair
        other = normals = lines = None
        if view.style == "blink":
            drawn = jpeg(pair.base)
            other = jpeg(compose(pair, "carried"))
        else:
            picture = compose(pair, view.style, view.share)
            if start is not None and view.start_line is not None:
                before = self._start_picture(start, view, onto)
                picture = swipe(before, picture, view.start_line)
            drawn = jpeg(picture)
        if view.through == "normals":
            normals = jpeg(
                shaded_normals(
                    overlay.mesh, overlay.photos[onto], cameras[onto], view.mesh_opacity
                )
            )
        if view.through == "lines":
            if self._lines is None:
                self._lines = SurfaceLines(overlay.mesh)
            lines = self._lines.seen_from(cameras[onto])
        return Picture(
            drawn,
            self.true_error(truth, cameras),
            other,
            self._photos[onto].name,
            normals,
            lines,
        )

    def _start_picture(
        self, start: tuple[Camera, ...], view: OverlayView, onto: int
    ) -> np.ndarray:
        key = (onto, view.style, view.share, tuple(map(id, start)))
        if self._start is None or self._start[0] != key:
            pair = aligned_pair(self._overlay, start, onto)
            picture = compose(pair, "blend" if view.style == "blink" else view.style)
            self._start = (key, picture)
            self._start_cameras = start  # Ids of living objects do not repeat.
        return self._start[1]

    def surface(self, cameras: tuple[Camera, ...], surface: Surface) -> SurfaceDrawn:
        """The object with photos or heat map laid on."""
        self._surface = cameras, surface
        return SurfaceDrawn(self.live_surface.glb(cameras, surface))

    def is_newest_surface(self, cameras: tuple[Camera, ...], surface: Surface) -> bool:
        """Whether the surface drawn last was this one."""
        if self._surface is None:
            return False
        known, what = self._surface
        return what == surface and all(map(same_camera, known, cameras))

    @functools.cached_property
    def live_surface(self) -> LiveSurface:
        """What draws the object; made in spare time, or when it is first shown."""
        return LiveSurface(
            self._overlay.quick_mesh,
            self._photos,
            self._addresses,
            DisplayFrame.of(self._mesh),
        )

    def comparison(self, job: Compare) -> Compared:
        """Two sets of cameras beside each other, in every photo."""
        mode = "carried" if job.style in ("blink", "swipe") else job.style
        return Compared(
            job, draw_comparison(self._overlay, job.before, job.after, mode)
        )
