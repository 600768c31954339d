"""Triangles as a lens shows them: with bent edges, in pieces so small that none shows.

A rasteriser draws straight edges. Where a corner's pixel is bent by the lens, the edges
between corners are chords of bent lines, which matters where a triangle is large: such
ones are halved until it does not. Of a scan's small triangles hardly any is.
"""

import numba as nb
import numpy as np

from photoreg.geometry.projection import pixel_of

MAX_SAG_PX = 0.02
"""How far the middle of an edge may be drawn from where it is, in pixels."""
SHORT_PX = 4.0
"""Shorter edges are straight: a tenth of the photo's width bends by far less than itself."""
MAX_EDGE_PX = 128.0
"""Longer edges are halved in any case: an edge bent like an S has no sag in its middle."""
MAX_HALVINGS = 40
"""Of one triangle, one after the other: to a millionth of its size."""
BORDER_HALVINGS = 18
BORDER_SHARE = 2e-3
"""Pieces that reach behind the camera or beyond the lens are halved so often, down to
this size relative to how far away they are: about a pixel is lost at that border."""


@nb.njit(cache=True, nogil=True)
def bent_faces(vertices, faces, camera, near, width, height):  # noqa: ANN001, ANN201
    """The triangles that a camera with a lens may show, in homogeneous pixels.

    A triangle that reaches behind the camera or beyond the lens is halved too, and only
    those pieces are left out that do so themselves.

    Args:
        vertices: (n, 3) float64, world axes.
        faces: (m, 3) int32.
        camera: record of ``projection.CAMERA``.
        near: Depth in model units below which nothing is drawn.
        width: Picture width in pixels.
        height: Picture height in pixels.

    Returns:
        Homogeneous pixels (k, 3), depth last; triangles (j, 3) of them; and the face
        (j,) that each is a piece of.
    """
    # Corners in camera axes, and where they appear.
    corners = np.zeros((len(vertices), 3))
    R, pivot, pivot_cam = camera.R, camera.pivot, camera.pivot_cam
    pixels = np.zeros((len(vertices), 3))
    seen = np.zeros(len(vertices), np.bool_)
    for i in range(len(vertices)):
        X = vertices[i, 0] - pivot[0]
        Y = vertices[i, 1] - pivot[1]
        Z = vertices[i, 2] - pivot[2]
        for k in range(3):
            corners[i, k] = R[k, 0] * X + R[k, 1] * Y + R[k, 2] * Z + pivot_cam[k]
        seen[i] = _appears(camera, corners[i], near, pixels[i])

    more = [np.zeros(3)]
    pieces = [(0, 0, 0, 0)]
    more.pop()
    pieces.pop()
    whole = np.zeros(len(faces), np.bool_)
    stack = np.zeros((MAX_HALVINGS + 2, 3, 3))
    depth = np.zeros(MAX_HALVINGS + 2, np.int64)
    triangle, own = np.zeros((3, 3)), np.zeros((3, 3))
    n_corners = len(vertices)
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        n_seen = int(seen[i]) + int(seen[j]) + int(seen[k])
        if n_seen == 3 and _is_outside(pixels[i], pixels[j], pixels[k], width, height):
            continue
        if (
            n_seen == 3
            and _is_straight(camera, corners[i], corners[j], pixels[i], pixels[j])
            and _is_straight(camera, corners[j], corners[k], pixels[j], pixels[k])
            and _is_straight(camera, corners[k], corners[i], pixels[k], pixels[i])
        ):
            whole[f] = True
            continue
        stack[0, 0], stack[0, 1], stack[0, 2] = corners[i], corners[j], corners[k]
        depth[0] = 0
        top = 1
        while top > 0:
            top -= 1
            triangle[:], level = stack[top], depth[top]
            if _is_hidden(camera, triangle, near):
                continue
            shown = True
            for m in range(3):
                if not _appears(camera, triangle[m], near, own[m]):
                    shown = False
            longest, most = -1, 0.0
            for m in range(3):
                n = (m + 1) % 3
                if shown and _is_straight(
                    camera, triangle[m], triangle[n], own[m], own[n]
                ):
                    continue
                length = np.sum((triangle[m] - triangle[n]) ** 2)
                if length > most:
                    longest, most = m, length
            if shown and (longest < 0 or level >= MAX_HALVINGS):
                if not _is_outside(own[0], own[1], own[2], width, height):
                    at = n_corners + len(more)
                    for m in range(3):
                        more.append(own[m].copy())
                    pieces.append((f, at, at + 1, at + 2))
                continue
            if longest < 0:
                continue
            if not shown and (
                level >= BORDER_HALVINGS
                or most < BORDER_SHARE**2 * np.sum(triangle[longest] ** 2)
            ):
                continue
            if shown and _is_outside(own[0], own[1], own[2], width, height, 64.0):
                continue
            m, n, o = longest, (longest + 1) % 3, (longest + 2) % 3
            middle = 0.5 * (triangle[m] + triangle[n])
            for half in range(2):
                stack[top, 0] = triangle[m] if half == 0 else middle
                stack[top, 1] = middle if half == 0 else triangle[n]
                stack[top, 2] = triangle[o]
                depth[top] = level + 1
                top += 1

    n_whole = int(whole.sum())
    out_pixels = np.zeros((n_corners + len(more), 3))
    out_pixels[:n_corners] = pixels
    for i in range(len(more)):
        out_pixels[n_corners + i] = more[i]
    out_faces = np.zeros((n_whole + len(pieces), 3), np.int32)
    source = np.zeros(n_whole + len(pieces), np.int32)
    at = 0
    for f in range(len(faces)):
        if whole[f]:
            out_faces[at] = faces[f]
            source[at] = f
            at += 1
    for f, i, j, k in pieces:
        out_faces[at, 0], out_faces[at, 1], out_faces[at, 2] = i, j, k
        source[at] = f
        at += 1
    return out_pixels, out_faces, source


@nb.njit(cache=True, nogil=True)
def _appears(camera, corner, near, pixel):  # noqa: ANN001, ANN202
    """Writes the homogeneous pixel of a corner in camera axes; False if there is none."""
    z = corner[2]
    if z < near:
        return False
    pivot_cam = camera.pivot_cam
    seen, u, v = pixel_of(
        camera, corner[0] - pivot_cam[0], corner[1] - pivot_cam[1], z - pivot_cam[2]
    )
    pixel[0], pixel[1], pixel[2] = u * z, v * z, z
    return seen


@nb.njit(cache=True, nogil=True)
def _is_outside(a, b, c, width, height, margin=1.0):  # noqa: ANN001, ANN202
    """Whether a triangle lies beyond one side of the picture by ``margin`` pixels."""
    for axis, side in ((0, width), (1, height)):
        low = min(a[axis] / a[2], b[axis] / b[2], c[axis] / c[2])
        high = max(a[axis] / a[2], b[axis] / b[2], c[axis] / c[2])
        if high < -margin or low > side - 1 + margin:
            return True
    return False


@nb.njit(cache=True, nogil=True)
def _is_hidden(camera, triangle, near):  # noqa: ANN001, ANN202
    """Whether a triangle is all behind the camera, or beyond the lens on one side."""
    if triangle[0, 2] < near and triangle[1, 2] < near and triangle[2, 2] < near:
        return True
    reach = np.sqrt(camera.max_radius2)
    if not reach < np.inf:
        return False
    for axis in range(2):
        for sign in (-1.0, 1.0):
            beyond = True
            for m in range(3):
                if sign * triangle[m, axis] <= reach * triangle[m, 2]:
                    beyond = False
            if beyond:
                return True
    return False


@nb.njit(cache=True, nogil=True)
def _is_straight(camera, a, b, pixel_a, pixel_b):  # noqa: ANN001, ANN202
    """Whether an edge looks like its chord; the same whichever end comes first."""
    ax, ay = pixel_a[0] / pixel_a[2], pixel_a[1] / pixel_a[2]
    bx, by = pixel_b[0] / pixel_b[2], pixel_b[1] / pixel_b[2]
    across, down = bx - ax, by - ay
    length = np.sqrt(across * across + down * down)
    if length < SHORT_PX:
        return True
    if length > MAX_EDGE_PX:
        return False
    pivot_cam = camera.pivot_cam
    seen, u, v = pixel_of(
        camera,
        0.5 * (a[0] + b[0]) - pivot_cam[0],
        0.5 * (a[1] + b[1]) - pivot_cam[1],
        0.5 * (a[2] + b[2]) - pivot_cam[2],
    )
    if not seen:
        return False
    # Where a drawer of straight edges would put the middle, depths considered.
    z = pixel_a[2] + pixel_b[2]
    x = (pixel_a[0] + pixel_b[0]) / z - u
    y = (pixel_a[1] + pixel_b[1]) / z - v
    return x * x + y * y <= MAX_SAG_PX * MAX_SAG_PX
