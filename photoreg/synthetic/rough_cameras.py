"""Rough cameras, wrong in everything at once, as a person's alignment by eye is."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface
from photoreg.geometry.visibility import seen_points

FOCAL_SIGMA = 0.012
"""Relative error of the focal length at unit scale."""
DISTANCE_SIGMA = 0.012
"""Relative error of the distance to the object."""
ROTATION_SIGMA_DEG = 1.4
"""Error of the rotation about the object, each axis."""
AIM_SHARE = 0.006
"""Error of the aim in the photo, each axis, over the photo's longer side."""
PRINCIPAL_POINT_SHARE = 0.004
"""Largest error of the principal point over the photo's longer side: within the
interval that a search gives it by default."""
N_POINTS = 2_000
"""Surface points that measure the error."""


def rough_start(
    mesh: Mesh,
    cameras: Sequence[Camera],
    error_px: tuple[float, float] = (15.0, 25.0),
    seed: int = 0,
) -> list[Camera]:
    """Rough cameras whose mean projection errors lie within ``error_px``.

    Each camera gets a wrong focal length, principal point, rotation about the object
    and distance, and is then aimed at the object again by eye, not quite well. All
    errors but the principal point's grow together until the mean error is the one
    drawn from the band.

    Args:
        mesh: the surface.
        cameras: the true cameras.
        error_px: lowest and highest mean projection error, pixels of the photo.
        seed: same seed, same cameras.

    Raises:
        InputError: if the band is empty or not positive, or a camera sees nothing.
    """
    low, high = error_px
    if not 0.0 < low <= high:
        raise InputError(
            f"The band of errors is {low:g} to {high:g} px; give two positive numbers, "
            "the lower one first."
        )
    points = sample_surface(mesh, N_POINTS, seed=1).points
    rng = np.random.default_rng([seed, 0x2064])
    # Drawn off the borders, as other points on the surface measure a little otherwise.
    margin = 0.1 * (high - low)
    return [
        _rough_camera(
            mesh, camera, points, rng.uniform(low + margin, high - margin), rng
        )
        for camera in cameras
    ]


def _rough_camera(
    mesh: Mesh,
    camera: Camera,
    points: np.ndarray,
    target_px: float,
    rng: np.random.Generator,
) -> Camera:
    seen = points[seen_points(mesh, camera, points)]
    if len(seen) == 0:
        raise InputError(f"A true camera sees nothing of {mesh.name}.")
    direction = rng.normal(size=7)
    shift = rng.uniform(-1.0, 1.0, 2)

    def moved(scale: float) -> Camera:
        return _moved(camera, mesh.centroid, scale * direction, min(scale, 1.0) * shift)

    def error_px(scale: float) -> float:
        offsets = moved(scale).project(seen) - camera.project(seen)
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        return float(np.mean(np.where(np.isnan(distances), np.inf, distances)))

    # The error is zero at scale zero and passes every value on its way up.
    inside, outside = 0.0, 0.25
    while error_px(outside) < target_px:
        inside, outside = outside, 1.5 * outside
    for _ in range(40):
        middle = 0.5 * (inside + outside)
        if error_px(middle) < target_px:
            inside = middle
        else:
            outside = middle
    return moved(inside)


def _moved(
    camera: Camera, pivot: np.ndarray, direction: np.ndarray, shift: np.ndarray
) -> Camera:
    """The camera with errors of ``direction`` sigmas, turned about ``pivot``."""
    turn = Rotation.from_rotvec(np.radians(ROTATION_SIGMA_DEG) * direction[:3])
    pivot_cam = camera.to_camera(pivot[None])[0]
    depth, side_px = pivot_cam[2], max(camera.width, camera.height)
    K = camera.K.copy()
    K[:2, :2] *= np.exp(FOCAL_SIGMA * direction[3])
    K[:2, 2] += PRINCIPAL_POINT_SHARE * side_px * shift
    # Aimed by eye: the object is back where the photo shows it, but for the aim's error.
    new_depth = depth * np.exp(DISTANCE_SIGMA * direction[4])
    pixel = camera.project(pivot[None])[0] + AIM_SHARE * side_px * direction[5:7]
    aimed = dataclasses.replace(camera, K=K).undistort(pixel[None])[0]
    ray = np.linalg.solve(K, np.array([aimed[0], aimed[1], 1.0]))
    target = new_depth * ray
    R = turn.as_matrix() @ camera.R_cam_world
    return dataclasses.replace(
        camera, K=K, R_cam_world=R, t_cam_world=target - R @ pivot
    )
