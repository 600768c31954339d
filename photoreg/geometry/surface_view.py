"""What a camera sees of a mesh: cover, faces, depth, and the rays of pixels."""

import concurrent.futures
import dataclasses
import functools
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection import pixel_rays
from photoreg.geometry.rasteriser import render_geometry

JUMP_SLOPE = 12.0
"""A jump is where the depth over three pixels changes by this many times the pixel's
size: the steepest points that count, 75 degrees, reach 11."""


@dataclasses.dataclass(frozen=True, eq=False)
class SurfaceView:
    """What a camera sees of the mesh."""

    camera: Camera
    covered: Bool[np.ndarray, "h w"]
    """Whether the pixel's centre shows the mesh."""
    face_index: Int[np.ndarray, "h w"]
    """Face that each pixel's centre shows, -1 where none."""
    depth: Float[np.ndarray, "h w"]
    """Depth along the camera's z axis in model units; infinity where nothing is seen."""

    @functools.cached_property
    def inner(self) -> Float[np.ndarray, "h w"]:
        """Distance in pixels to the nearest jump of depth, the rim included."""
        depth = np.where(self.covered, self.depth, 0.0)
        kernel = np.ones((3, 3), np.uint8)
        change = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel)
        smooth = self.covered & (change * self.camera.focal_px < JUMP_SLOPE * depth)
        return cv2.distanceTransform(smooth.astype(np.uint8), cv2.DIST_L2, 3)


def surface_view(mesh: Mesh, camera: Camera) -> SurfaceView:
    """Draws the mesh at the camera's size."""
    buffer = render_geometry(mesh, camera)
    return SurfaceView(camera, buffer.face_index >= 0, buffer.face_index, buffer.depth)


def surface_views(mesh: Mesh, cameras: Sequence[Camera]) -> list[SurfaceView]:
    """``surface_view`` of several cameras, each drawn on its own thread."""
    with concurrent.futures.ThreadPoolExecutor() as threads:
        return list(threads.map(lambda camera: surface_view(mesh, camera), cameras))


def camera_rays(
    camera: Camera, pixels: Float[np.ndarray, "n 2"]
) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (n, 3), in world axes, of pixels; depth 1 along z."""
    directions = pixel_rays(camera.record, np.asarray(pixels, dtype=np.float64))
    return np.broadcast_to(camera.center, directions.shape), directions
