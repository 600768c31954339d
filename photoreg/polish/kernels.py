"""Compiled loops of the polish: projection with derivatives, photo comparison.

Bare arrays only. A camera comes as the vector of ``Increments.geometry``; photos as
(h, w, 3) float32 with pixel (0, 0) at the centre of the first pixel. Parallel over
chunks whose number does not depend on the number of threads; each writes its own sums.
"""

import numba as nb
import numpy as np

N = 9
"""Increments of a camera."""
CHANNELS = 3
CELL_PASSES = 4
"""Reweighting passes for a cell's offset; the cost moves by less than 1e-3 after three."""


@nb.njit(inline="always", cache=True, nogil=True)
def project_point(geometry, X, Y, Z, uv):
    """Writes the pixel and the point in camera axes into ``uv``; False if behind."""
    X -= geometry[30]
    Y -= geometry[31]
    Z -= geometry[32]
    a = geometry[0] * X + geometry[1] * Y + geometry[2] * Z
    b = geometry[3] * X + geometry[4] * Y + geometry[5] * Z
    c = geometry[6] * X + geometry[7] * Y + geometry[8] * Z
    x = a + geometry[9]
    y = b + geometry[10]
    z = c + geometry[11]
    if not z > 0.0:
        return False
    uv[0] = (geometry[12] * x + geometry[13] * y) / z + geometry[15]
    uv[1] = geometry[14] * y / z + geometry[16]
    uv[2] = a
    uv[3] = b
    uv[4] = c
    return True


@nb.njit(inline="always", cache=True, nogil=True)
def projection_rows(geometry, uv, rows):
    """Writes the derivative of the pixel by the nine increments into ``rows`` (2, 9)."""
    a, b, c = uv[2], uv[3], uv[4]
    inverse = 1.0 / (c + geometry[11])
    x = (a + geometry[9]) * inverse
    y = (b + geometry[10]) * inverse
    ux = geometry[12] * inverse
    uy = geometry[13] * inverse
    uz = -(geometry[12] * x + geometry[13] * y) * inverse
    vy = geometry[14] * inverse
    vz = -geometry[14] * y * inverse
    # d(turned point)/d(turn) = -[point]x, as three columns.
    u0 = -uy * c + uz * b
    u1 = ux * c - uz * a
    u2 = -ux * b + uy * a
    v0 = -vy * c + vz * b
    v1 = -vz * a
    v2 = vy * a
    for k in range(3):
        j0 = geometry[17 + k]
        j1 = geometry[20 + k]
        j2 = geometry[23 + k]
        rows[0, k] = u0 * j0 + u1 * j1 + u2 * j2
        rows[1, k] = v0 * j0 + v1 * j1 + v2 * j2
    shift = geometry[26]
    rows[0, 3] = ux * shift
    rows[0, 4] = uy * shift
    rows[0, 5] = uz * shift
    rows[1, 3] = 0.0
    rows[1, 4] = vy * shift
    rows[1, 5] = vz * shift
    rows[0, 6] = (uv[0] - geometry[15]) * geometry[27]
    rows[1, 6] = (uv[1] - geometry[16]) * geometry[27]
    rows[0, 7] = geometry[28]
    rows[1, 7] = 0.0
    rows[0, 8] = 0.0
    rows[1, 8] = geometry[29]


@nb.njit(inline="always", cache=True, nogil=True)
def tangent_map(geometry, uv, normal, out):
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
    inverse = 1.0 / (uv[4] + geometry[11])
    x = (uv[2] + geometry[9]) * inverse
    y = (uv[3] + geometry[10]) * inverse
    ux = geometry[12] * inverse
    uy = geometry[13] * inverse
    uz = -(geometry[12] * x + geometry[13] * y) * inverse
    vy = geometry[14] * inverse
    vz = -geometry[14] * y * inverse
    for m in range(2):
        if m == 0:
            tx, ty, tz = ax, ay, az
        else:
            tx, ty, tz = bx, by, bz
        cx = geometry[0] * tx + geometry[1] * ty + geometry[2] * tz
        cy = geometry[3] * tx + geometry[4] * ty + geometry[5] * tz
        cz = geometry[6] * tx + geometry[7] * ty + geometry[8] * tz
        out[0, m] = ux * cx + uy * cy + uz * cz
        out[1, m] = vy * cy + vz * cz


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
def rim_rows(geometry, points):
    """Pixels (n, 2) and their derivatives by the increments (n, 2, 9); NaN behind."""
    pixels = np.full((len(points), 2), np.nan)
    rows = np.zeros((len(points), 2, N))
    uv = np.zeros(5)
    for i in range(len(points)):
        if project_point(geometry, points[i, 0], points[i, 1], points[i, 2], uv):
            pixels[i, 0] = uv[0]
            pixels[i, 1] = uv[1]
            projection_rows(geometry, uv, rows[i])
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
def pair_values(points, photo_a, photo_b, geometry_a, geometry_b):
    """Colours (n, 2, 3) of points in both photos; NaN behind a camera."""
    n = len(points)
    out = np.full((n, 2, CHANNELS), np.nan)
    n_chunks = 64
    for chunk in nb.prange(n_chunks):
        uv = np.zeros(5)
        colour = np.zeros((CHANNELS, 3))
        for i in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            if project_point(geometry_a, x, y, z, uv):
                sample_cubic(photo_a, uv[0], uv[1], colour)
                for k in range(CHANNELS):
                    out[i, 0, k] = colour[k, 0]
            if project_point(geometry_b, x, y, z, uv):
                sample_cubic(photo_b, uv[0], uv[1], colour)
                for k in range(CHANNELS):
                    out[i, 1, k] = colour[k, 0]
    return out


@nb.njit(cache=True, nogil=True)
def slope_energy(points, normals_world, photo_a, photo_b, geometry_a, geometry_b, gain):
    """Energy of the colours' slopes on the surface, (3, 2): a channel.

    First the product of the two photos' slopes, in which their noise does not meet,
    then the square of the slopes' mean, in which it does.
    """
    out = np.zeros((CHANNELS, 2))
    uv = np.zeros(5)
    colour_a = np.zeros((CHANNELS, 3))
    colour_b = np.zeros((CHANNELS, 3))
    map_a = np.zeros((2, 2))
    map_b = np.zeros((2, 2))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not project_point(geometry_a, x, y, z, uv):
            continue
        sample_cubic(photo_a, uv[0], uv[1], colour_a)
        tangent_map(geometry_a, uv, normals_world[i], map_a)
        # Slopes in pixels of photo a: lengths along the surface cancel in the ratio.
        scale = (uv[4] + geometry_a[11]) / geometry_a[12]
        if not project_point(geometry_b, x, y, z, uv):
            continue
        sample_cubic(photo_b, uv[0], uv[1], colour_b)
        tangent_map(geometry_b, uv, normals_world[i], map_b)
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
    geometry_a,
    geometry_b,
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
    uv_a = np.zeros(5)
    uv_b = np.zeros(5)
    mean_J = np.zeros(2 * N)
    for cell in range(first_cell, end_cell):
        n = 0
        for i in range(cell_starts[cell], cell_starts[cell + 1]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            if not project_point(geometry_a, x, y, z, uv_a):
                continue
            if not project_point(geometry_b, x, y, z, uv_b):
                continue
            sample_cubic(photo_a, uv_a[0], uv_a[1], colour_a)
            sample_cubic(photo_b, uv_b[0], uv_b[1], colour_b)
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
            projection_rows(geometry_a, uv_a, own_rows[:2])
            projection_rows(geometry_b, uv_b, own_rows[2:])
            for m in range(4):
                for j in range(N):
                    rows[m, j, n] = own_rows[m, j]
            tangent_map(geometry_a, uv_a, normals_world[i], map_a)
            tangent_map(geometry_b, uv_b, normals_world[i], map_b)
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
    geometry_a,
    geometry_b,
    gain,
    offsets,
    inverse_sigma,
    cell_precision,
    cut,
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
        geometry_a: camera of photo a.
        geometry_b: camera of photo b.
        gain: (3,) square root of the gain between the photos, a channel.
        offsets: (n, 3) difference of the photos after the gain, that of light included.
        inverse_sigma: (3,) inverse residual scale.
        cell_precision: (3,) sigma^2 / tau^2 of the cells' offsets.
        cut: scale of the Cauchy cost, in sigmas.

    Returns:
        Costs (chunks, 3), gradients (cells, 3, 18), normal matrices
        (chunks, 3, 18, 18), the channels apart.
    """
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
            geometry_a,
            geometry_b,
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
