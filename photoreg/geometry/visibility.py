"""Which surface points a camera sees: by normals, by rays, by a depth buffer."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import TOLERANCE, Mesh, VisibilityMethod
from photoreg.geometry.rasteriser import render_geometry
from photoreg.geometry.ray_hits import surface_hits
from photoreg.geometry.sampling import SurfaceSamples, sample_surface

DEPTH_WIDTH_PX = 1024
"""Width of the depth buffer: about as many pixels as a photo of the search has."""

N_SAMPLES = 2_000
"""Shares of the surface are then right to 1 % (one standard error, at a half)."""
LEAST_SEEN = 0.02
"""Cameras that see less than this share of a surface show a detail of it: points spread
over all of it would miss what they see."""
PARTS = 10
"""A tenth of the points mostly tells that cameras do not show a detail."""
STEEP_COSINE = 0.25
"""A ground that runs to the horizon fills much of the area and little of a photo: what is
seen flatter than this does not count for that."""


def samples_for(
    mesh: Mesh, cameras: Sequence[Camera], n_samples: int, seed: int
) -> SurfaceSamples:
    """Points of a mesh by which to tell what cameras see.

    Spread over its area; or, where cameras show but a detail of it, as of a site or of a
    room, over their photos.

    Args:
        mesh: The surface.
        cameras: The cameras.
        n_samples: How many points, at least 1; over photos fewer, if these show background.
        seed: Same seed, same points.

    Raises:
        InputError: if fewer than one point is asked for.
    """
    samples = sample_surface(mesh, n_samples, seed)
    if not _show_a_detail(mesh, cameras, samples):
        return samples
    return _samples_of_detail(mesh, cameras, samples, seed)


def middle_for(mesh: Mesh, cameras: Sequence[Camera]) -> Float[np.ndarray, "3"]:
    """The middle of what cameras look at: the mesh's centroid, or that of a detail."""
    samples = sample_surface(mesh, N_SAMPLES, 0)
    if not _show_a_detail(mesh, cameras, samples):
        return mesh.centroid
    return _samples_of_detail(mesh, cameras, samples, 0).points.mean(axis=0)


def _show_a_detail(
    mesh: Mesh, cameras: Sequence[Camera], samples: SurfaceSamples
) -> bool:
    """Whether cameras see less than ``LEAST_SEEN`` of a mesh, as points on it tell."""
    if not cameras:
        return False
    n_seen = 0
    for first in range(PARTS):
        part = samples.subset(np.arange(first, len(samples), PARTS))
        seen = np.zeros(len(part), dtype=bool)
        for camera in cameras:
            is_steep = _faces(part, camera, STEEP_COSINE)
            is_steep |= ~_faces(part, camera, -STEEP_COSINE)
            seen |= is_steep & seen_points(mesh, camera, part.points)
        n_seen += int(seen.sum())
        if n_seen / len(samples) >= LEAST_SEEN:
            return (
                False  # Whatever the rest of them is, as a rule after the first part.
            )
    return True


def _samples_of_detail(
    mesh: Mesh, cameras: Sequence[Camera], samples: SurfaceSamples, seed: int
) -> SurfaceSamples:
    """As many points over the cameras' photos; ``samples`` if these show background."""
    rng = np.random.default_rng(seed)
    n_rays = -(-len(samples) // len(cameras))
    found = [_samples_of_photo(mesh, camera, n_rays, rng) for camera in cameras]
    detail = SurfaceSamples(
        *(
            np.concatenate([getattr(one, field.name) for one in found])
            for field in dataclasses.fields(SurfaceSamples)
        )
    )
    return detail if len(detail) else samples


def _samples_of_photo(
    mesh: Mesh, camera: Camera, n_rays: int, rng: np.random.Generator
) -> SurfaceSamples:
    """Where rays through places drawn evenly from the photo meet a mesh."""
    pixels = rng.random((n_rays, 2)) * [camera.width, camera.height] - 0.5
    _, hits = surface_hits(mesh, *camera.rays(pixels))
    return SurfaceSamples(hits.points, hits.normals, hits.face)


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
        facing = _faces(samples, camera, min_cosine)
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


def _faces(
    samples: SurfaceSamples, camera: Camera, min_cosine: float
) -> Bool[np.ndarray, "n"]:
    """Whether normals are within ``acos(min_cosine)`` of the direction to a camera."""
    to_camera = camera.center - samples.points
    cosine = np.einsum("nd,nd->n", samples.normals, to_camera)
    return cosine >= min_cosine * np.linalg.norm(to_camera, axis=1)


def share_seen_twice(
    samples: SurfaceSamples, mesh: Mesh, cameras: Sequence[Camera], min_cosine: float
) -> float:
    """Of points on a mesh: the share that two cameras or more see, by rays."""
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
