"""A camera in numbers a person can type: lens, place, direction; and back.

Directions are relative to the world's upwards: *turn* about it, *tilt* above the
horizon, *roll* about the line of sight. *Around the object* tells where the camera
stands as seen from the object: azimuth, elevation, distance. Pure geometry.
"""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from app.model.camera_moves import STEP_ASIDE_DEG, orbit_axes, orbited, with_focal
from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.words import number

FILM_DIAGONAL_MM = 43.27
"""Of 35 mm film: 36 x 24 mm."""

FOCAL_RANGE = (0.1, 30.0)
"""Focal lengths that are taken, in longer sides of the photo."""

ANGLE_RANGE_DEG = (2.0, 160.0)
_FROM_LENS = np.diag([1.0, -1.0, -1.0])
"""Camera axes (x right, y down, z ahead) from those of the angles (y up, z back)."""


def film_mm(camera: Camera) -> float:
    """Focal length on 35 mm film that has the same field of view."""
    return camera.focal_px * FILM_DIAGONAL_MM / _diagonal(camera)


def view_angle_deg(camera: Camera) -> float:
    """Field of view over the photo's longer side."""
    side = max(camera.width, camera.height)
    return float(np.degrees(2.0 * np.arctan(0.5 * side / camera.focal_px)))


def focal_of_film(camera: Camera, mm: float) -> float:
    """Focal length in pixels of one on 35 mm film.

    Raises:
        InputError: for one that no photo has.
    """
    per_px = FILM_DIAGONAL_MM / _diagonal(camera)
    low, high = (
        share * max(camera.width, camera.height) * per_px for share in FOCAL_RANGE
    )
    if not low <= mm <= high:
        raise InputError(
            f"A focal length on 35 mm film should be {low:.1f} to {high:,.0f} mm for this "
            f"photo, but is {mm:g}."
        )
    return mm / per_px


def focal_of_angle(camera: Camera, degrees: float) -> float:
    """Focal length in pixels of a field of view over the longer side.

    Raises:
        InputError: for an angle that no photo has.
    """
    low, high = ANGLE_RANGE_DEG
    if not low <= degrees <= high:
        raise InputError(
            f"A field of view should be {low:g} to {high:g} degrees, but is {degrees:g}."
        )
    side = max(camera.width, camera.height)
    return float(0.5 * side / np.tan(np.radians(0.5 * degrees)))


def with_checked_focal(
    camera: Camera, focal_px: float, keep_size_at: np.ndarray | None
) -> Camera:
    """As `placement.with_focal`, for focal lengths that a photo can have.

    Raises:
        InputError: if it is out of the range.
    """
    side = max(camera.width, camera.height)
    low, high = (share * side for share in FOCAL_RANGE)
    if not low <= focal_px <= high:
        raise InputError(
            f"A focal length for this photo should be {low:.0f} to {high:.0f} px, "
            f"but is {focal_px:g}."
        )
    return with_focal(camera, focal_px, keep_size_at)


def with_principal_point(camera: Camera, x: float, y: float) -> Camera:
    """The camera with another principal point, in pixels.

    Raises:
        InputError: if it is farther outside of the photo than the photo is large.
    """
    for name, value, side in (("x", x, camera.width), ("y", y, camera.height)):
        if not -side <= value <= 2 * side:
            raise InputError(
                f"The principal point's {name} should be {-side} to {2 * side} px for "
                f"this photo, but is {value:g}."
            )
    K = camera.K.copy()
    K[:2, 2] = x, y
    return dataclasses.replace(camera, K=K)


def with_center(camera: Camera, center: np.ndarray, reach: float) -> Camera:
    """The camera moved to ``center``, a world point; it keeps its direction.

    Args:
        camera: The camera.
        center: Where to.
        reach: How far from the world's origin is believable, in model units.

    Raises:
        InputError: if ``center`` is farther than that.
    """
    if not np.abs(center).max() <= reach:
        raise InputError(
            f"A position should be within {number(reach, 4)} of the model's origin, but is "
            f"{', '.join(f'{v:.10g}' for v in center)}."
        )
    return dataclasses.replace(camera, t_cam_world=-camera.R_cam_world @ center)


def direction_deg(camera: Camera, up: np.ndarray) -> np.ndarray:
    """Turn, tilt and roll of a camera, (3,) degrees."""
    axes = _level_axes(up)
    R = axes.T @ camera.R_cam_world.T @ _FROM_LENS
    # At a tilt of 90 degrees turn and roll are one; scipy then warns and picks.
    return Rotation.from_matrix(R).as_euler("YXZ", degrees=True)


def with_direction(camera: Camera, up: np.ndarray, degrees: np.ndarray) -> Camera:
    """The camera turned, about its own centre, to turn, tilt and roll."""
    _check_angles(degrees, ("turn", "tilt", "roll"), (360.0, 90.0, 360.0))
    turned = Rotation.from_euler("YXZ", degrees, degrees=True).as_matrix()
    R = (_level_axes(up) @ turned @ _FROM_LENS).T
    return dataclasses.replace(camera, R_cam_world=R, t_cam_world=-R @ camera.center)


def around(camera: Camera, anchor: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Azimuth and elevation in degrees, and distance, of a camera about ``anchor``."""
    x, y, z = _level_axes(up).T @ (camera.center - anchor)
    distance = float(np.sqrt(x * x + y * y + z * z))
    level = float(np.hypot(x, z))
    return np.array(
        [np.degrees(np.arctan2(x, z)), np.degrees(np.arctan2(y, level)), distance]
    )


def with_around(
    camera: Camera, anchor: np.ndarray, up: np.ndarray, values: np.ndarray
) -> Camera:
    """The camera carried about ``anchor`` to an azimuth, elevation and distance.

    It turns along, so what it looks at stays where it is in the photo.

    Raises:
        InputError: if an angle is out of its range or the distance is not positive.
    """
    _check_angles(values[:2], ("azimuth", "elevation"), (360.0, 89.9))
    if not 0.0 < values[2] < np.inf:
        raise InputError(
            f"The distance from the object should be positive, but is {values[2]:g}."
        )
    axes, before = _level_axes(up), around(camera, anchor, up)

    def standing(azimuth: float, elevation: float) -> np.ndarray:
        angles = Rotation.from_euler("YX", (azimuth, -elevation), degrees=True)
        return axes @ angles.as_matrix()

    turn = standing(values[0], values[1]) @ standing(before[0], before[1]).T
    carried = orbited(camera, anchor, turn)
    centre = anchor + (carried.center - anchor) * (values[2] / before[2])
    return dataclasses.replace(carried, t_cam_world=-carried.R_cam_world @ centre)


def stepped_aside(
    first: Camera, camera: Camera, anchor: np.ndarray, up: np.ndarray, steps: int
) -> Camera:
    """Where ``first`` stands, ``steps`` times 20 degrees around ``anchor``.

    The photo's own size and principal point stay; its field of view and lens become the
    first's if it is as large.
    """
    axis = np.asarray(up, dtype=np.float64) / np.linalg.norm(up)
    turn = Rotation.from_rotvec(np.radians(STEP_ASIDE_DEG * steps) * axis).as_matrix()
    stands = orbited(first, anchor, turn)
    same = (first.width, first.height) == (camera.width, camera.height)
    return dataclasses.replace(
        camera,
        K=first.K if same else camera.K,
        R_cam_world=stands.R_cam_world,
        t_cam_world=stands.t_cam_world,
        lens=first.lens if same else camera.lens,
    )


def _level_axes(up: np.ndarray) -> np.ndarray:
    up = np.asarray(up, dtype=np.float64)
    return orbit_axes(np.array([0.0, 0.0, 1.0]), up)


def _check_angles(
    degrees: np.ndarray, names: tuple[str, ...], limits: tuple[float, ...]
) -> None:
    for value, name, limit in zip(degrees, names, limits, strict=True):
        if not -limit <= value <= limit:
            raise InputError(
                f"The {name} should be {-limit:g} to {limit:g} degrees, but is "
                f"{value:g}."
            )


def _diagonal(camera: Camera) -> float:
    return float(np.hypot(camera.width, camera.height))
