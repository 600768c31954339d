"""Which surface points a camera sees: by normals, by rays, by a depth buffer."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import TOLERANCE, Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.geometry.sampling import SurfaceSamples, sample_surface

VisibilityMethod = Literal["normals", "rays", "depth"]

DEPTH_WIDTH_PX = 1024
"""Width of the depth buffer: about as many pixels as a photo of the search has."""

N_SAMPLES = 2_000
"""Shares of the surface are then right to 1 % (one standard error, at a half)."""


def visible(
    samples: SurfaceSamples,
    cameras: Sequence[Camera],
    mesh: Mesh,
    method: VisibilityMethod = "normals",
    min_cosine: float = 0.5,
) -> Bool[np.ndarray, "n_cameras n"]:
    """Whether each camera sees each sample.

    Seen means: in front of the camera, inside its photo, the normal within
    ``acos(min_cosine)`` of the direction to the camera, and, for ``rays`` and
    ``depth``, nothing of the mesh in between.

    Args:
        samples: Points on ``mesh``.
        cameras: The cameras.
        mesh: What may occlude.
        method: ``normals``: the paper's test, blind to occlusion. ``rays``: exact,
            by embree. ``depth``: against a depth buffer of the camera's own view.
        min_cosine: Least cosine between the normal and the direction to the camera.
    """
    rows = []
    for camera in cameras:
        to_camera = camera.center - samples.points
        cosine = np.einsum("nd,nd->n", samples.normals, to_camera)
        facing = cosine >= min_cosine * np.linalg.norm(to_camera, axis=1)
        # NaN, behind the camera, compares as outside.
        seen = facing & camera.contains(camera.project(samples.points))
        if method != "normals" and seen.any():
            points = samples.points[seen]
            if method == "rays":
                free = mesh.is_unoccluded(points, camera.center)
            else:
                free = _free_in_depth(points, camera, mesh)
            seen[np.flatnonzero(seen)[~free]] = False
        rows.append(seen)
    return np.array(rows)


def share_seen_twice(mesh: Mesh, cameras: Sequence[Camera], min_cosine: float) -> float:
    """Of the mesh's surface: the share that two cameras or more see, by rays."""
    samples = sample_surface(mesh, N_SAMPLES, seed=0)
    seen = visible(samples, cameras, mesh, "rays", min_cosine)
    return float((seen.sum(axis=0) >= 2).mean())


def seen_points(
    mesh: Mesh, camera: Camera, points: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    """Whether surface points are in the camera's frame and not hidden, by rays.

    No normals are asked: the surface itself hides its back, and a scan whose faces
    are turned inside out is measured all the same.
    """
    seen = camera.contains(camera.project(points))
    seen[seen] = mesh.is_unoccluded(points[seen], camera.center)
    return seen


def _free_in_depth(points: np.ndarray, camera: Camera, mesh: Mesh) -> np.ndarray:
    """Whether points, all in frame, are no deeper than the four pixels around them.

    The farthest of the four counts: across a slanted face depth changes from pixel to
    pixel, and the point lies between.
    """
    buffer = render_geometry(mesh, camera, min(camera.width, DEPTH_WIDTH_PX))
    pixels = buffer.camera.project(points)
    height, width = buffer.depth.shape
    column = np.clip(np.floor(pixels[:, 0]).astype(int), 0, max(width - 2, 0))
    row = np.clip(np.floor(pixels[:, 1]).astype(int), 0, max(height - 2, 0))
    farthest = np.full(len(points), -np.inf)
    for down in (0, 1):
        for right in (0, 1):
            around = buffer.depth[
                np.minimum(row + down, height - 1),
                np.minimum(column + right, width - 1),
            ]
            farthest = np.maximum(farthest, around)
    depth = camera.to_camera(points)[:, 2]
    return depth <= farthest + TOLERANCE * mesh.diagonal
