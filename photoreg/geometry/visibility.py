"""Which surface points a camera sees: by normals, by rays, by a depth buffer."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.geometry.sampling import SurfaceSamples

VisibilityMethod = Literal["normals", "rays", "depth"]

TOLERANCE = 1e-3
"""How far behind what hides it a point may lie and still be seen, relative to the
mesh's diagonal: its own face must not hide it."""

DEPTH_WIDTH_PX = 1024
"""Width of the depth buffer: finer only resolves what the tolerance forgives."""


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
            test = _free_of_rays if method == "rays" else _free_in_depth
            free = test(samples.points[seen], camera, mesh)
            seen[np.flatnonzero(seen)[~free]] = False
        rows.append(seen)
    return np.array(rows)


def _free_of_rays(points: np.ndarray, camera: Camera, mesh: Mesh) -> np.ndarray:
    return mesh.is_unoccluded(points, camera.center, TOLERANCE)


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
