"""Compiled loops of the polish: projection with derivatives, photo comparison.

Bare arrays only. A camera comes as the record of ``Increments.record``; photos as
(h, w, 3) float32 with pixel (0, 0) at the centre of the first pixel. Parallel over
chunks whose number does not depend on the number of threads; each writes its own sums.
"""

import numba as nb
import numpy as np

from photoreg.geometry.projection import (
    lens_slopes,
    pixel_of,
    pixel_slopes,
    project,
    turned,
)
from photoreg.parameters.camera_parameters import (
    FOCAL,
    N_PINHOLE,
    POSITION,
    PRINCIPAL,
)

CHANNELS = 3
CELL_PASSES = 4
"""Reweighting passes for a cell's offset; the cost moves by less than 1e-3 after three."""

SHIFT_AT = POSITION.start
MIDDLE_AT = PRINCIPAL.start


@nb.njit(inline="always", cache=True, nogil=True)
def projection_rows(camera, a, b, c, u, v, rows):
    """Writes the derivative of the pixel by the increments into ``rows`` (2, n).

    Args:
        camera: Record of ``CAMERA``.
        a: The point, ``turned``, along x,
        b: along y,
        c: along z.
        u: Its pixel's column.
        v: Its pixel's row.
        rows: Written; n says how many terms of the lens move.
    """
    ux, uy, uz, vx, vy, vz = pixel_slopes(camera, a, b, c)
    # d(turned point)/d(turn) = -[point]x, as three columns.
    u0 = -uy * c + uz * b
    u1 = ux * c - uz * a
    u2 = -ux * b + uy * a
    v0 = -vy * c + vz * b
    v1 = vx * c - vz * a
    v2 = -vx * b + vy * a
    turn = camera.turn
    for k in range(3):
        j0, j1, j2 = turn[0, k], turn[1, k], turn[2, k]
        rows[0, k] = u0 * j0 + u1 * j1 + u2 * j2
        rows[1, k] = v0 * j0 + v1 * j1 + v2 * j2
    shift = camera.shift
    rows[0, SHIFT_AT] = ux * shift
    rows[0, SHIFT_AT + 1] = uy * shift
    rows[0, SHIFT_AT + 2] = uz * shift
    rows[1, SHIFT_AT] = vx * shift
    rows[1, SHIFT_AT + 1] = vy * shift
    rows[1, SHIFT_AT + 2] = vz * shift
    rows[0, FOCAL] = (u - camera.cx) * camera.zoom
    rows[1, FOCAL] = (v - camera.cy) * camera.zoom
    rows[0, MIDDLE_AT] = camera.middle[0]
    rows[1, MIDDLE_AT] = 0.0
    rows[0, MIDDLE_AT + 1] = 0.0
    rows[1, MIDDLE_AT + 1] = camera.middle[1]
    if rows.shape[1] > N_PINHOLE:
        slopes = lens_slopes(camera, a, b, c)
        for k in range(rows.shape[1] - N_PINHOLE):
            by_u, by_v = slopes[k]
            rows[0, N_PINHOLE + k] = by_u * camera.bend[k]
            rows[1, N_PINHOLE + k] = by_v * camera.bend[k]


@nb.njit(inline="always", cache=True, nogil=True)
def tangent_map(camera, a, b, c, normal, out):
    """Writes the derivative of the pixel along two tangents of the surface: (2, 2)."""
    # Any two directions across the normal do, the same in both photos.
    nx, ny, nz = normal[0], normal[1], normal[2]
    if abs(nx) > 0.6:
        ax, ay, az = -ny, nx, 0.0
    else:
        ax, ay, az = 0.0, -nz, ny
    bx = ny * az - nz * ay
    by = nz * ax - nx * az
    bz = nx * ay - ny * ax
    ux, uy, uz, vx, vy, vz = pixel_slopes(camera, a, b, c)
    R = camera.R
    for m in range(2):
        if m == 0:
            tx, ty, tz = ax, ay, az
        else:
            tx, ty, tz = bx, by, bz
        cx = R[0, 0] * tx + R[0, 1] * ty + R[0, 2] * tz
        cy = R[1, 0] * tx + R[1, 1] * ty + R[1, 2] * tz
        cz = R[2, 0] * tx + R[2, 1] * ty + R[2, 2] * tz
        out[0, m] = ux * cx + uy * cy + uz * cz
        out[1, m] = vx * cx + vy * cy + vz * cz


@nb.njit(inline="always", cache=True, nogil=True)
def share_slope(map_a, map_b, slope, shared):
    """Replaces both photos' colour slopes by their mean on the surface.

    What the photos see is one surface, so their slopes along it agree but for noise.
    """
    det_a = map_a[0, 0] * map_a[1, 1] - map_a[0, 1] * map_a[1, 0]
    det_b = map_b[0, 0] * map_b[1, 1] - map_b[0, 1] * map_b[1, 0]
    size_a = map_a[0, 0] ** 2 + map_a[0, 1] ** 2 + map_a[1, 0] ** 2 + map_a[1, 1] ** 2
    size_b = map_b[0, 0] ** 2 + map_b[0, 1] ** 2 + map_b[1, 0] ** 2 + map_b[1, 1] ** 2
    if abs(det_a) < 0.05 * size_a or abs(det_b) < 0.05 * size_b:
        for m in range(4):
            shared[m] = slope[m]
        return
    g0 = 0.5 * (
        map_a[0, 0] * slope[0]
        + map_a[1, 0] * slope[1]
        - map_b[0, 0] * slope[2]
        - map_b[1, 0] * slope[3]
    )
    g1 = 0.5 * (
        map_a[0, 1] * slope[0]
        + map_a[1, 1] * slope[1]
        - map_b[0, 1] * slope[2]
        - map_b[1, 1] * slope[3]
    )
    shared[0] = (map_a[1, 1] * g0 - map_a[1, 0] * g1) / det_a
    shared[1] = (map_a[0, 0] * g1 - map_a[0, 1] * g0) / det_a
    shared[2] = -(map_b[1, 1] * g0 - map_b[1, 0] * g1) / det_b
    shared[3] = -(map_b[0, 0] * g1 - map_b[0, 1] * g0) / det_b


@nb.njit(inline="always", cache=True, nogil=True)
def sample_cubic(photo, u, v, out):
    """Catmull-Rom value and its derivatives by u and v, a channel: ``out`` (3, 3).

    Within a pixel and a half of the border and outside it the position is clamped,
    which keeps a point that leaves the photo in the sum with a constant colour.
    """
    height, width = photo.shape[0], photo.shape[1]
    inside = 1.0
    if u < 1.0:
        u, inside = 1.0, 0.0
    elif u > width - 2.001:
        u, inside = width - 2.001, 0.0
    if v < 1.0:
        v, inside = 1.0, 0.0
    elif v > height - 2.001:
        v, inside = height - 2.001, 0.0
    i, j = int(u), int(v)
    s, t = u - i, v - j
    wx0 = s * (-0.5 + s * (1.0 - 0.5 * s))
    wx1 = 1.0 + s * s * (-2.5 + 1.5 * s)
    wx2 = s * (0.5 + s * (2.0 - 1.5 * s))
    wx3 = s * s * (-0.5 + 0.5 * s)
    dx0 = -0.5 + s * (2.0 - 1.5 * s)
    dx1 = s * (-5.0 + 4.5 * s)
    dx2 = 0.5 + s * (4.0 - 4.5 * s)
    dx3 = s * (-1.0 + 1.5 * s)
    wy0 = t * (-0.5 + t * (1.0 - 0.5 * t))
    wy1 = 1.0 + t * t * (-2.5 + 1.5 * t)
    wy2 = t * (0.5 + t * (2.0 - 1.5 * t))
    wy3 = t * t * (-0.5 + 0.5 * t)
    dy0 = -0.5 + t * (2.0 - 1.5 * t)
    dy1 = t * (-5.0 + 4.5 * t)
    dy2 = 0.5 + t * (4.0 - 4.5 * t)
    dy3 = t * (-1.0 + 1.5 * t)
    for k in range(CHANNELS):
        value, by_u, by_v = 0.0, 0.0, 0.0
        for row in range(4):
            y = j - 1 + row
            p0 = photo[y, i - 1, k]
            p1 = photo[y, i, k]
            p2 = photo[y, i + 1, k]
            p3 = photo[y, i + 2, k]
            across = wx0 * p0 + wx1 * p1 + wx2 * p2 + wx3 * p3
            slope = dx0 * p0 + dx1 * p1 + dx2 * p2 + dx3 * p3
            if row == 0:
                w, d = wy0, dy0
            elif row == 1:
                w, d = wy1, dy1
            elif row == 2:
                w, d = wy2, dy2
            else:
                w, d = wy3, dy3
            value += w * across
            by_u += w * slope
            by_v += d * across
        out[k, 0] = value
        out[k, 1] = by_u * inside
        out[k, 2] = by_v * inside


@nb.njit(cache=True, nogil=True)
def rim_rows(camera, points, n):
    """Pixels (m, 2) and their derivatives by n increments (m, 2, n); NaN behind."""
    pixels = np.full((len(points), 2), np.nan)
    rows = np.zeros((len(points), 2, n))
    for i in range(len(points)):
        a, b, c = turned(camera, points[i, 0], points[i, 1], points[i, 2])
        seen, u, v = pixel_of(camera, a, b, c)
        if seen:
            pixels[i, 0] = u
            pixels[i, 1] = v
            projection_rows(camera, a, b, c, u, v, rows[i])
    return pixels, rows


@nb.njit(cache=True, nogil=True)
def colours_at(photo, pixels):
    """Colours (n, 3) of a photo at pixels (n, 2)."""
    out = np.zeros((len(pixels), CHANNELS))
    colour = np.zeros((CHANNELS, 3))
    for i in range(len(pixels)):
        sample_cubic(photo, pixels[i, 0], pixels[i, 1], colour)
        for k in range(CHANNELS):
            out[i, k] = colour[k, 0]
    return out


@nb.njit(cache=True, nogil=True)
def bilinear_at(image, pixels):
    """Bilinear values (n, k, 3) of an image at pixels (n, k, 2), its border beyond it.

    Not by ``cv2.remap``, which rounds places to a 32nd of a pixel.
    """
    height, width = image.shape[0], image.shape[1]
    out = np.zeros((pixels.shape[0], pixels.shape[1], CHANNELS), np.float32)
    for i in range(pixels.shape[0]):
        for k in range(pixels.shape[1]):
            u = min(max(pixels[i, k, 0], 0.0), width - 1.0)
            v = min(max(pixels[i, k, 1], 0.0), height - 1.0)
            column, row = min(int(u), width - 2), min(int(v), height - 2)
            s, t = u - column, v - row
            for c in range(CHANNELS):
                above = image[row, column, c]
                above += s * (image[row, column + 1, c] - above)
                below = image[row + 1, column, c]
                below += s * (image[row + 1, column + 1, c] - below)
                out[i, k, c] = above + t * (below - above)
    return out


@nb.njit(cache=True, nogil=True)
def weighted_moments(rows, target, weights):
    """Normal equations of a weighted linear fit: (p, p) and (p,).

    Args:
        rows: (n, p) the fit's basis at each point.
        target: (n,) what it should give there.
        weights: (n,) of each point.
    """
    n, p = rows.shape
    normal = np.zeros((p, p))
    right = np.zeros(p)
    for i in range(n):
        for j in range(p):
            weighted = weights[i] * rows[i, j]
            right[j] += weighted * target[i]
            for k in range(j + 1):
                normal[j, k] += weighted * rows[i, k]
    for j in range(p):
        for k in range(j):
            normal[k, j] = normal[j, k]
    return normal, right


@nb.njit(parallel=True, cache=True, nogil=True)
def pair_values(points, photo_a, photo_b, cameras):
    """Colours (n, 2, 3) of points in both photos; NaN behind a camera."""
    n = len(points)
    out = np.full((n, 2, CHANNELS), np.nan)
    n_chunks = 64
    for chunk in nb.prange(n_chunks):
        colour = np.zeros((CHANNELS, 3))
        camera_a, camera_b = cameras[0], cameras[1]
        for i in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            seen, u, v = project(camera_a, x, y, z)
            if seen:
                sample_cubic(photo_a, u, v, colour)
                for k in range(CHANNELS):
                    out[i, 0, k] = colour[k, 0]
            seen, u, v = project(camera_b, x, y, z)
            if seen:
                sample_cubic(photo_b, u, v, colour)
                for k in range(CHANNELS):
                    out[i, 1, k] = colour[k, 0]
    return out


@nb.njit(cache=True, nogil=True)
def slope_energy(points, normals_world, photo_a, photo_b, cameras, gain):
    """Energy of the colours' slopes on the surface, (3, 2): a channel.

    First the product of the two photos' slopes, in which their noise does not meet,
    then the square of the slopes' mean, in which it does.
    """
    camera_a, camera_b = cameras[0], cameras[1]
    out = np.zeros((CHANNELS, 2))
    colour_a = np.zeros((CHANNELS, 3))
    colour_b = np.zeros((CHANNELS, 3))
    map_a = np.zeros((2, 2))
    map_b = np.zeros((2, 2))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a0, a1, a2 = turned(camera_a, x, y, z)
        seen, u, v = pixel_of(camera_a, a0, a1, a2)
        if not seen:
            continue
        sample_cubic(photo_a, u, v, colour_a)
        tangent_map(camera_a, a0, a1, a2, normals_world[i], map_a)
        # Slopes in pixels of photo a: lengths along the surface cancel in the ratio.
        scale = (a2 + camera_a.pivot_cam[2]) / camera_a.fx
        b0, b1, b2 = turned(camera_b, x, y, z)
        seen, u, v = pixel_of(camera_b, b0, b1, b2)
        if not seen:
            continue
        sample_cubic(photo_b, u, v, colour_b)
        tangent_map(camera_b, b0, b1, b2, normals_world[i], map_b)
        for k in range(CHANNELS):
            for m in range(2):
                a = map_a[0, m] * colour_a[k, 1] + map_a[1, m] * colour_a[k, 2]
                b = map_b[0, m] * colour_b[k, 1] + map_b[1, m] * colour_b[k, 2]
                a *= gain[k] * scale
                b *= scale / gain[k]
                out[k, 0] += a * b
                out[k, 1] += 0.25 * (a + b) * (a + b)
    return out


@nb.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def dot(a, b, n):
    """Sum of the products of the first n of each; in any order, so as vectors."""
    total = 0.0
    for i in range(n):
        total += a[i] * b[i]
    return total


@nb.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def cell_offset(residual, weight, n, precision, cut):
    """What the first n residuals have in common, robustly, with a prior around zero."""
    # Start between the wide and the robust mean: from zero a cell whose offset is
    # beyond the cut would never be found.
    top, total = 0.0, precision
    for i in range(n):
        top += weight[i] * residual[i]
        total += weight[i]
    offset = top / total if total > 0.0 else 0.0
    for _ in range(CELL_PASSES):
        top, total = 0.0, precision
        for i in range(n):
            e = (residual[i] - offset) / cut
            w = weight[i] / (1.0 + e * e)
            top += w * residual[i]
            total += w
        offset = top / total if total > 0.0 else 0.0
    return offset


@nb.njit(cache=True, nogil=True)
def chunk_equations(
    first_cell,
    end_cell,
    points,
    normals_world,
    weights,
    cell_starts,
    photo_a,
    photo_b,
    cameras,
    gain,
    offsets,
    inverse_sigma,
    cell_precision,
    cut,
    costs,
    gradients,
    normals,
):
    """Adds what the cells of one chunk bring to the outputs of its caller.

    Apart from the parallel loop: inside it the compiler took twice as long.
    """
    camera_a, camera_b = cameras[0], cameras[1]
    N = gradients.shape[2] // 2
    longest = 0
    for cell in range(first_cell, end_cell):
        longest = max(longest, cell_starts[cell + 1] - cell_starts[cell])
    # The points of a cell lie side by side, so that the sums over them are vectors'.
    residual = np.zeros((CHANNELS, longest))
    slope = np.zeros((CHANNELS, 4, longest))
    shared = np.zeros((CHANNELS, 4, longest))
    rows = np.zeros((4, N, longest))
    pull = np.zeros((4, longest))
    root_J = np.zeros((2 * N, longest))
    root = np.zeros(longest)
    weight = np.zeros(longest)
    map_a = np.zeros((2, 2))
    map_b = np.zeros((2, 2))
    own_rows = np.zeros((4, N))
    own_slope = np.zeros(4)
    own_shared = np.zeros(4)
    colour_a = np.zeros((CHANNELS, 3))
    colour_b = np.zeros((CHANNELS, 3))
    mean_J = np.zeros(2 * N)
    for cell in range(first_cell, end_cell):
        n = 0
        for i in range(cell_starts[cell], cell_starts[cell + 1]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            a0, a1, a2 = turned(camera_a, x, y, z)
            seen, u_a, v_a = pixel_of(camera_a, a0, a1, a2)
            if not seen:
                continue
            b0, b1, b2 = turned(camera_b, x, y, z)
            seen, u_b, v_b = pixel_of(camera_b, b0, b1, b2)
            if not seen:
                continue
            sample_cubic(photo_a, u_a, v_a, colour_a)
            sample_cubic(photo_b, u_b, v_b, colour_b)
            weight[n] = weights[i]
            for k in range(CHANNELS):
                scale_a = gain[k] * inverse_sigma[k]
                scale_b = inverse_sigma[k] / gain[k]
                residual[k, n] = (
                    colour_a[k, 0] * scale_a
                    - colour_b[k, 0] * scale_b
                    - offsets[i, k] * inverse_sigma[k]
                )
                slope[k, 0, n] = colour_a[k, 1] * scale_a
                slope[k, 1, n] = colour_a[k, 2] * scale_a
                slope[k, 2, n] = -colour_b[k, 1] * scale_b
                slope[k, 3, n] = -colour_b[k, 2] * scale_b
            projection_rows(camera_a, a0, a1, a2, u_a, v_a, own_rows[:2])
            projection_rows(camera_b, b0, b1, b2, u_b, v_b, own_rows[2:])
            for m in range(4):
                for j in range(N):
                    rows[m, j, n] = own_rows[m, j]
            tangent_map(camera_a, a0, a1, a2, normals_world[i], map_a)
            tangent_map(camera_b, b0, b1, b2, normals_world[i], map_b)
            for k in range(CHANNELS):
                for m in range(4):
                    own_slope[m] = slope[k, m, n]
                share_slope(map_a, map_b, own_slope, own_shared)
                for m in range(4):
                    shared[k, m, n] = own_shared[m]
            n += 1
        for k in range(CHANNELS):
            b = cell_offset(residual[k], weight, n, cell_precision[k], cut)
            cost = 0.5 * cell_precision[k] * b * b
            total = cell_precision[k]
            for i in range(n):
                e = (residual[k, i] - b) / cut
                cost += weight[i] * 0.5 * cut * cut * np.log(1.0 + e * e)
                w = weight[i] / (1.0 + e * e)
                total += w
                root[i] = np.sqrt(w)
                for m in range(4):
                    pull[m, i] = w * (residual[k, i] - b) * slope[k, m, i]
            costs[k] += cost
            if not total > 0.0:
                continue
            g = gradients[cell, k]
            H = normals[k]
            for half in range(2):
                s, t = shared[k, 2 * half], shared[k, 2 * half + 1]
                u, v = pull[2 * half], pull[2 * half + 1]
                for j in range(N):
                    row_u, row_v = rows[2 * half, j], rows[2 * half + 1, j]
                    out = root_J[half * N + j]
                    for i in range(n):
                        out[i] = root[i] * (s[i] * row_u[i] + t[i] * row_v[i])
                    g[half * N + j] += dot(u, row_u, n) + dot(v, row_v, n)
            for j in range(2 * N):
                mean_J[j] = dot(root, root_J[j], n)
                for m in range(j + 1):
                    H[j, m] += (
                        dot(root_J[j], root_J[m], n) - mean_J[j] * mean_J[m] / total
                    )
    for k in range(CHANNELS):
        for j in range(2 * N):
            for m in range(j):
                normals[k, m, j] = normals[k, j, m]


@nb.njit(parallel=True, cache=True, nogil=True)
def pair_normal_equations(
    points,
    normals_world,
    weights,
    cell_starts,
    chunk_starts,
    photo_a,
    photo_b,
    cameras,
    gain,
    offsets,
    inverse_sigma,
    cell_precision,
    cut,
    n_increments,
):
    """Cost and normal equations of one photo pair, one row a chunk of cells.

    The residual of a point and channel is
    (colour in a) gain - (colour in b) / gain - (offset of the point) - (of its cell),
    in units of sigma, under the Cauchy cost cut^2 / 2 log(1 + (r / cut)^2). The cell's
    offset is what minimises the cell's cost, with a prior of precision
    ``cell_precision`` around zero; it takes what slow changes of light do.

    The gradient is that of the cost. The normal matrix takes both photos' slopes as
    one, their mean on the surface: noise in the slopes would otherwise look like
    curvature along the direction in which both cameras slide together, where there is
    little, and every step would be too short (on the clean scene 0.8 of the error was
    left after a step; see Benhimane and Malis, "Real-time image-based tracking of
    planes using efficient second-order minimization", 2004).

    Args:
        points: (n, 3), those of a cell in a row.
        normals_world: (n, 3) unit normals of the surface, smooth.
        weights: (n,) of each point's cost.
        cell_starts: (cells + 1,) first point of each cell.
        chunk_starts: (chunks + 1,) first cell of each chunk.
        photo_a: (h, w, 3) float32.
        photo_b: (h, w, 3) float32.
        cameras: (2,) records of ``CAMERA``, of the two photos.
        gain: (3,) square root of the gain between the photos, a channel.
        offsets: (n, 3) difference of the photos after the gain, that of light included.
        inverse_sigma: (3,) inverse residual scale.
        cell_precision: (3,) sigma^2 / tau^2 of the cells' offsets.
        cut: scale of the Cauchy cost, in sigmas.
        n_increments: n, of each camera.

    Returns:
        Costs (chunks, 3), gradients (cells, 3, 2 n), normal matrices
        (chunks, 3, 2 n, 2 n), the channels apart.
    """
    N = n_increments
    n_chunks = len(chunk_starts) - 1
    costs = np.zeros((n_chunks, CHANNELS))
    gradients = np.zeros((len(cell_starts) - 1, CHANNELS, 2 * N))
    normals = np.zeros((n_chunks, CHANNELS, 2 * N, 2 * N))
    for chunk in nb.prange(n_chunks):
        chunk_equations(
            chunk_starts[chunk],
            chunk_starts[chunk + 1],
            points,
            normals_world,
            weights,
            cell_starts,
            photo_a,
            photo_b,
            cameras,
            gain,
            offsets,
            inverse_sigma,
            cell_precision,
            cut,
            costs[chunk],
            gradients,
            normals[chunk],
        )
    return costs, gradients, normals
