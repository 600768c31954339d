"""A z-buffer rasteriser: which face each pixel of a camera sees, and how far it is.

One thread, without the interpreter lock: it may be called from anywhere. Triangles are
rasterised in homogeneous coordinates, so one that reaches behind the camera needs no
clipping and cannot explode.

References:
    M. Olano and T. Greer, "Triangle Scan Conversion using 2D Homogeneous
    Coordinates", Graphics Hardware, 1997.
"""

import dataclasses
import functools

import numba as nb
import numpy as np
from jaxtyping import Bool, Float, Int

from photoreg.geometry.bent_faces import bent_faces
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection import unproject

NEAR = 1e-6
"""Nearest depth drawn, relative to the mesh's diagonal."""


@dataclasses.dataclass(frozen=True, eq=False)
class GeometryBuffer:
    """What a camera sees of a mesh, pixel by pixel; both sides of a face are drawn."""

    camera: Camera
    """The camera of exactly this picture size."""
    face_index: Int[np.ndarray, "h w"]
    """Face seen at each pixel centre, int32; -1 where there is none."""
    depth: Float[np.ndarray, "h w"]
    """Depth along the camera's z axis, float32, model units; infinity where none."""

    @functools.cached_property
    def covered(self) -> Bool[np.ndarray, "h w"]:
        """Whether the mesh is seen at each pixel."""
        return self.face_index >= 0

    @functools.cached_property
    def points(self) -> Float[np.ndarray, "h w 3"]:
        """Surface point at each pixel in world axes, float64; NaN where there is none."""
        return _points_at_pixels(self.depth, self.camera.record, self.camera.center)


def scaled_camera(camera: Camera, width: int | None) -> Camera:
    """The camera of its photo resampled to ``width`` pixels, aspect ratio kept."""
    if width is None or width == camera.width:
        return camera
    height = max(1, round(camera.height * width / camera.width))
    return camera.resized(width, height)


def render_geometry(
    mesh: Mesh, camera: Camera, width: int | None = None
) -> GeometryBuffer:
    """Draws ``mesh`` as ``camera`` sees it, with hidden surfaces removed.

    Args:
        mesh: The surface.
        camera: Where it is seen from.
        width: Picture width in pixels; None: the camera's own. The height follows.

    Returns:
        Face and depth at each pixel centre. A pixel centre exactly on an edge belongs
        to one of the edge's faces, so closed surfaces have no cracks.
    """
    camera = scaled_camera(camera, width)
    near, size = NEAR * mesh.diagonal, (camera.width, camera.height)
    if camera.lens.is_ideal:
        face_index, depth = rasterise(mesh.vertices, mesh.faces, camera.P, near, *size)
    else:
        pixels, pieces, source = bent_faces(
            mesh.vertices, mesh.faces, camera.record, near, *size
        )
        piece, depth = rasterise_pixels(pixels, pieces, near, *size)
        face_index = np.append(source, np.int32(-1))[piece]
    return GeometryBuffer(camera, face_index, depth)


# No contraction either: an edge shared by two faces is evaluated by both, and only
# exactly opposite values leave neither a crack nor a hole.
@nb.njit(nogil=True, cache=True)
def rasterise(  # noqa: ANN201 - numba infers the types.
    vertices: np.ndarray,
    faces: np.ndarray,
    P: np.ndarray,
    near: float,
    width: int,
    height: int,
):
    """Face index (h, w) int32 and depth (h, w) float32 of the nearest surface.

    With homogeneous pixels v = P X of a triangle's corners as columns of M, a pixel
    p = (x, y, 1) meets its plane at barycentrics b = z M^-1 p, with 1 / z the sum of
    M^-1 p. Inside is where all three are positive.

    Args:
        vertices: (n, 3) float64, world axes.
        faces: (m, 3) int32.
        P: (3, 4) projection matrix; its third row gives the depth.
        near: Depth in model units below which nothing is drawn.
        width: Picture width in pixels.
        height: Picture height in pixels.
    """
    pixels = np.zeros((len(vertices), 3))
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for row in range(3):
            pixels[i, row] = P[row, 0] * x + P[row, 1] * y + P[row, 2] * z + P[row, 3]
    return rasterise_pixels(pixels, faces, near, width, height)


@nb.njit(nogil=True, cache=True)
def rasterise_pixels(pixels, faces, near, width, height):  # noqa: ANN001, ANN201
    """As ``rasterise``, of vertices that are homogeneous pixels (n, 3), depth last."""
    face_index = np.full((height, width), -1, dtype=np.int32)
    # Nearest so far as inverse depth, which is linear in the picture; 0 is nowhere.
    nearness = np.zeros((height, width), dtype=np.float32)
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        a = (pixels[i, 0], pixels[i, 1], pixels[i, 2])
        b = (pixels[j, 0], pixels[j, 1], pixels[j, 2])
        c = (pixels[k, 0], pixels[k, 1], pixels[k, 2])
        if a[2] < near and b[2] < near and c[2] < near:
            continue
        low_x, high_x, low_y, high_y = _bounds(a, b, c, near)
        # As floats first: pixels far outside would overflow an integer.
        if not (
            low_x <= width - 1 and high_x >= 0 and low_y <= height - 1 and high_y >= 0
        ):
            continue
        first_x, last_x = int(np.ceil(max(low_x, 0.0))), int(min(high_x, width - 1.0))
        first_y, last_y = int(np.ceil(max(low_y, 0.0))), int(min(high_y, height - 1.0))
        if first_x > last_x or first_y > last_y:
            continue
        # Rows of M^-1, up to the determinant: cross products of the corners.
        ax, ay, aw = _cross(b, c)
        bx, by, bw = _cross(c, a)
        cx, cy, cw = _cross(a, b)
        det = a[0] * ax + a[1] * ay + a[2] * aw
        if det == 0.0:
            continue
        if det < 0.0:
            ax, ay, aw, bx, by, bw = -ax, -ay, -aw, -bx, -by, -bw
            cx, cy, cw, det = -cx, -cy, -cw, -det
        zx, zy, zw = (ax + bx + cx) / det, (ay + by + cy) / det, (aw + bw + cw) / det
        for y in range(first_y, last_y + 1):
            row_a, row_b, row_c = ay * y + aw, by * y + bw, cy * y + cw
            row_z = zy * y + zw
            left, right = _inside(ax, row_a, float(first_x), float(last_x))
            left, right = _inside(bx, row_b, left, right)
            left, right = _inside(cx, row_c, left, right)
            if not left <= right:
                continue
            for x in range(int(np.ceil(left)), int(right) + 1):
                if (
                    ax * x + row_a >= 0.0
                    and bx * x + row_b >= 0.0
                    and cx * x + row_c >= 0.0
                ):
                    inverse = np.float32(zx * x + row_z)
                    if inverse > nearness[y, x] and inverse * near < 1.0:
                        nearness[y, x] = inverse
                        face_index[y, x] = f

    depth = np.full((height, width), np.inf, dtype=np.float32)
    for y in range(height):
        for x in range(width):
            if face_index[y, x] >= 0:
                depth[y, x] = np.float32(1.0) / nearness[y, x]
    return face_index, depth


@nb.njit(nogil=True, cache=True, inline="always")
def _cross(u, v):  # noqa: ANN001, ANN202
    return (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )


@nb.njit(nogil=True, cache=True, inline="always")
def _inside(slope, start, left, right):  # noqa: ANN001, ANN202
    """Shrinks a row to where slope * x + start >= 0, but for a hundredth of a pixel.

    What is left is tested exactly; this only saves the time for the rest.
    """
    if slope > 0.0:
        left = max(left, -start / slope - 0.01)
    elif slope < 0.0:
        right = min(right, -start / slope + 0.01)
    return left, right


@nb.njit(nogil=True, cache=True, inline="always")
def _bounds(a, b, c, near):  # noqa: ANN001, ANN202
    """Box of the part of a triangle beyond ``near``, in pixels: x, x, y, y."""
    if a[2] >= near and b[2] >= near and c[2] >= near:
        ax, ay = a[0] / a[2], a[1] / a[2]
        bx, by = b[0] / b[2], b[1] / b[2]
        cx, cy = c[0] / c[2], c[1] / c[2]
        return (
            min(ax, bx, cx),
            max(ax, bx, cx),
            min(ay, by, cy),
            max(ay, by, cy),
        )
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    u = c
    for v in (a, b, c):
        if v[2] >= near:
            x, y = v[0] / v[2], v[1] / v[2]
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
        if (u[2] < near) != (v[2] < near):
            share = (near - u[2]) / (v[2] - u[2])
            x = (u[0] + share * (v[0] - u[0])) / near
            y = (u[1] + share * (v[1] - u[1])) / near
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
        u = v
    return low_x, high_x, low_y, high_y


@nb.njit(nogil=True, cache=True)
def _points_at_pixels(depth, camera, center):  # noqa: ANN001, ANN202
    """X = C + z R^T (x, y, 1) at each pixel; NaN where depth is infinite."""
    height, width = depth.shape
    R = camera.R
    points = np.full((height, width, 3), np.nan)
    for row in range(height):
        for column in range(width):
            z = depth[row, column]
            if z < np.inf:
                x, y = unproject(camera, float(column), float(row))
                for k in range(3):
                    points[row, column, k] = center[k] + z * (
                        R[0, k] * x + R[1, k] * y + R[2, k]
                    )
    return points
