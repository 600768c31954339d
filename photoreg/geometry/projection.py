"""From points to pixels and back, compiled: the one place where a camera projects.

A camera goes to compiled code as a record (``CAMERA``). A parallel function cannot take
one record: it gets an array of them.
"""

import numba as nb
import numpy as np

from photoreg.geometry.lens import (
    TERMS,
    Lens,
    distorted,
    distortion_slopes,
    undistorted,
)

CAMERA = np.dtype(
    [
        ("R", np.float64, (3, 3)),  # R_cam_world
        ("pivot", np.float64, (3,)),  # A point in world axes, near what is projected,
        ("pivot_cam", np.float64, (3,)),  # and where it is in camera axes.
        ("fx", np.float64),
        ("skew", np.float64),
        ("fy", np.float64),
        ("cx", np.float64),
        ("cy", np.float64),
        ("has_lens", np.bool_),
        *((term, np.float64) for term in TERMS),
        ("max_radius2", np.float64),  # Square of ``Lens.max_radius``.
        # What one unit of each parameter does, where the camera moves:
        ("turn", np.float64, (3, 3)),  # the turn by each rotation,
        ("shift", np.float64),  # the position, in model units,
        ("zoom", np.float64),  # the focal length, as a logarithm,
        ("middle", np.float64, (2,)),  # the principal point, in pixels,
        ("bend", np.float64, (len(TERMS),)),  # the lens's terms.
    ],
    align=True,
)
"""The record of a camera: X_cam = R (X - pivot) + pivot_cam, its K and its lens."""


def fill_record(  # noqa: ANN201
    record,  # noqa: ANN001
    K: np.ndarray,
    R_cam_world: np.ndarray,
    pivot: np.ndarray,
    pivot_cam: np.ndarray,
    lens: Lens,
):
    """Writes a camera into a record of ``CAMERA``; returns it."""
    record["R"], record["pivot"], record["pivot_cam"] = R_cam_world, pivot, pivot_cam
    record["fx"], record["skew"], record["fy"] = K[0, 0], K[0, 1], K[1, 1]
    record["cx"], record["cy"] = K[0, 2], K[1, 2]
    record["has_lens"] = not lens.is_ideal
    for term, value in zip(TERMS, lens.terms, strict=True):
        record[term] = value
    record["max_radius2"] = lens.max_radius**2
    return record


@nb.njit(cache=True, nogil=True)
def turned(camera, X, Y, Z):  # noqa: ANN001, ANN201
    """A world point from the pivot, in camera axes."""
    R, pivot = camera.R, camera.pivot
    X -= pivot[0]
    Y -= pivot[1]
    Z -= pivot[2]
    return (
        R[0, 0] * X + R[0, 1] * Y + R[0, 2] * Z,
        R[1, 0] * X + R[1, 1] * Y + R[1, 2] * Z,
        R[2, 0] * X + R[2, 1] * Y + R[2, 2] * Z,
    )


@nb.njit(cache=True, nogil=True)
def pixel_of(camera, a, b, c):  # noqa: ANN001, ANN201
    """Whether a ``turned`` point is before the camera and within its lens, and its pixel."""
    x = a + camera.pivot_cam[0]
    y = b + camera.pivot_cam[1]
    z = c + camera.pivot_cam[2]
    if not z > 0.0:
        return False, np.nan, np.nan
    if camera.has_lens:
        x, y = x / z, y / z
        if x * x + y * y > camera.max_radius2:
            return False, np.nan, np.nan
        x, y = distorted(camera, x, y)
        z = 1.0
    return (
        True,
        (camera.fx * x + camera.skew * y) / z + camera.cx,
        camera.fy * y / z + camera.cy,
    )


@nb.njit(cache=True, nogil=True, inline="always")
def homogeneous(P, x, y, z):  # noqa: ANN001, ANN201
    """A pixel times its depth, and the depth, by a projection (3, 4) without a lens.

    For what works on photos undistorted once; in the precision of what it is given.
    """
    return (
        P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3],
        P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3],
        P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3],
    )


@nb.njit(cache=True, nogil=True)
def pixel_slopes(camera, a, b, c):  # noqa: ANN001, ANN201
    """Derivative of the pixel (u, v) by the point in camera axes.

    As u by x, y, z, then v by x, y, z, at a ``turned`` point.
    """
    inverse = 1.0 / (c + camera.pivot_cam[2])
    x = (a + camera.pivot_cam[0]) * inverse
    y = (b + camera.pivot_cam[1]) * inverse
    u_x, u_y, v_x, v_y = camera.fx, camera.skew, 0.0, camera.fy
    if camera.has_lens:
        xx, xy, yy = distortion_slopes(camera, x, y)
        u_x, u_y, v_x, v_y = (
            u_x * xx + u_y * xy,
            u_x * xy + u_y * yy,
            v_y * xy,
            v_y * yy,
        )
    return (
        u_x * inverse,
        u_y * inverse,
        -(u_x * x + u_y * y) * inverse,
        v_x * inverse,
        v_y * inverse,
        -(v_x * x + v_y * y) * inverse,
    )


@nb.njit(cache=True, nogil=True)
def lens_slopes(camera, a, b, c):  # noqa: ANN001, ANN201
    """Derivative of the pixel by the lens terms, at a ``turned`` point.

    As pairs (u, v), in the order of ``TERMS``.
    """
    z = c + camera.pivot_cam[2]
    x, y = (a + camera.pivot_cam[0]) / z, (b + camera.pivot_cam[1]) / z
    s = x * x + y * y
    fx, skew, fy = camera.fx, camera.skew, camera.fy
    radial_u, radial_v = (fx * x + skew * y) * s, fy * y * s
    cross, down, across = 2.0 * x * y, s + 2.0 * y * y, s + 2.0 * x * x
    return (
        (radial_u, radial_v),
        (radial_u * s, radial_v * s),
        (fx * cross + skew * down, fy * down),
        (fx * across + skew * cross, fy * cross),
        (radial_u * s * s, radial_v * s * s),
    )


@nb.njit(cache=True, nogil=True)
def project(camera, X, Y, Z):  # noqa: ANN001, ANN201
    """Whether the camera has a world point before it, and its pixel (u, v)."""
    a, b, c = turned(camera, X, Y, Z)
    return pixel_of(camera, a, b, c)


@nb.njit(cache=True, nogil=True)
def unproject(camera, u, v):  # noqa: ANN001, ANN201
    """Ideal coordinates (x, y) of a pixel: its ray is (x, y, 1) in camera axes.

    NaN where the lens shows nothing there.
    """
    y = (v - camera.cy) / camera.fy
    x = (u - camera.cx - camera.skew * y) / camera.fx
    if camera.has_lens:
        x, y = undistorted(camera, x, y)
    return x, y


@nb.njit(cache=True, nogil=True)
def project_points(camera, points):  # noqa: ANN001, ANN201
    """Pixels (n, 2) of world points (n, 3); NaN where the camera has none."""
    pixels = np.zeros((len(points), 2))
    for i in range(len(points)):
        _, pixels[i, 0], pixels[i, 1] = project(
            camera, points[i, 0], points[i, 1], points[i, 2]
        )
    return pixels


@nb.njit(cache=True, nogil=True)
def unproject_pixels(camera, pixels):  # noqa: ANN001, ANN201
    """Ideal coordinates (n, 2) of pixels (n, 2)."""
    ideal = np.zeros((len(pixels), 2))
    for i in range(len(pixels)):
        ideal[i, 0], ideal[i, 1] = unproject(camera, pixels[i, 0], pixels[i, 1])
    return ideal


@nb.njit(cache=True, nogil=True)
def pixel_rays(camera, pixels):  # noqa: ANN001, ANN201
    """Directions (n, 3) in world axes of pixels (n, 2), with depth 1 along z.

    Not parallel: helper threads call it, and only one thread may call what is.
    """
    R = camera.R
    out = np.zeros((len(pixels), 3))
    for i in range(len(pixels)):
        x, y = unproject(camera, pixels[i, 0], pixels[i, 1])
        for k in range(3):
            out[i, k] = R[0, k] * x + R[1, k] * y + R[2, k]
    return out


@nb.njit(cache=True, nogil=True)
def distort_grid(camera, width, height):  # noqa: ANN001, ANN201
    """Where in the photo each pixel of the undistorted photo is: for ``cv2.remap``.

    Columns and rows (h, w) float32; -10 where the lens shows nothing.
    """
    columns = np.full((height, width), np.float32(-10.0))
    rows = np.full((height, width), np.float32(-10.0))
    for v in range(height):
        y = (v - camera.cy) / camera.fy
        for u in range(width):
            x = (u - camera.cx - camera.skew * y) / camera.fx
            if x * x + y * y <= camera.max_radius2:
                bent_x, bent_y = distorted(camera, x, y)
                columns[v, u] = camera.fx * bent_x + camera.skew * bent_y + camera.cx
                rows[v, u] = camera.fy * bent_y + camera.cy
    return columns, rows
