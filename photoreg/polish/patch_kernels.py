"""Compiled loops of the correspondences: patches matched to a fraction of a pixel.

Bare arrays only. Images come as (h, w) float32 with pixel (0, 0) at the centre
of the first pixel. Parallel over patches, each of which writes its own row.
"""

import numba as nb
import numpy as np

HALF = 7
"""Samples of a patch on each side of its centre."""
SIDE = 2 * HALF + 1
WINDOW_SIGMA = 4.2
"""Standard deviation of a patch's Gaussian window, in samples."""
MAX_SHIFT = 4.0
"""A patch found farther than this from where it was looked for is not it, in pixels."""
MIN_SHARE = 0.7
"""Least share of a patch's window that the surface fills."""
MIN_GAIN = 0.25
"""Least factor between the contrasts of a patch in both photos, either way."""
SETTLED = 0.01
"""A patch has settled when it moves by less than this, in pixels."""


@nb.njit(inline="always", cache=True, nogil=True)
def cubic_weights(s):
    """Catmull-Rom weights of four samples, at ``s`` between the second and third."""
    return (
        np.float32(s * (-0.5 + s * (1.0 - 0.5 * s))),
        np.float32(1.0 + s * s * (-2.5 + 1.5 * s)),
        np.float32(s * (0.5 + s * (2.0 - 1.5 * s))),
        np.float32(s * s * (-0.5 + 0.5 * s)),
    )


@nb.njit(cache=True, nogil=True)
def sampled(image, pixels):
    """Values (n,) of an image at pixels (n, 2), 1 to 2 px within its border."""
    out = np.zeros(len(pixels), np.float32)
    for i in range(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        column, row = int(u), int(v)
        across = cubic_weights(u - column)
        down = cubic_weights(v - row)
        for j in range(4):
            line = image[row - 1 + j]
            out[i] += down[j] * (
                across[0] * line[column - 1]
                + across[1] * line[column]
                + across[2] * line[column + 1]
                + across[3] * line[column + 2]
            )
    return out


@nb.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def shifted_window(image, row, column, x, y, lines, out):
    """Writes the (SIDE + 2)^2 samples about a pixel, shifted by (x, y), into ``out``.

    In two passes, as all samples of a window lie at one fraction of a pixel. False, and
    nothing written, where the window leaves the image.
    """
    left, top = int(np.floor(x)), int(np.floor(y))
    wx0, wx1, wx2, wx3 = cubic_weights(x - left)
    wy0, wy1, wy2, wy3 = cubic_weights(y - top)
    left += column - HALF - 2
    top += row - HALF - 2
    n = SIDE + 2
    height, width = image.shape
    if left < 0 or top < 0 or left + n + 3 > width or top + n + 3 > height:
        return False
    for j in range(n + 3):
        line = image[top + j, left : left + n + 3]
        for i in range(n):
            lines[j, i] = (
                wx0 * line[i]
                + wx1 * line[i + 1]
                + wx2 * line[i + 2]
                + wx3 * line[i + 3]
            )
    for j in range(n):
        for i in range(n):
            out[j, i] = (
                wy0 * lines[j, i]
                + wy1 * lines[j + 1, i]
                + wy2 * lines[j + 2, i]
                + wy3 * lines[j + 3, i]
            )
    return True


@nb.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def inner_product(a, b, weight):
    """Weighted sum of the products of two patches."""
    total = np.float32(0.0)
    for j in range(SIDE):
        for i in range(SIDE):
            total += weight[j, i] * a[j, i] * b[j, i]
    return float(total)


@nb.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def centred(window, weight, total, out):
    """Writes a window's inner samples less their weighted mean into ``out``."""
    mean = np.float32(0.0)
    for j in range(SIDE):
        for i in range(SIDE):
            mean += weight[j, i] * window[j + 1, i + 1]
    mean /= total
    for j in range(SIDE):
        for i in range(SIDE):
            out[j, i] = window[j + 1, i + 1] - mean


@nb.njit(cache=True, nogil=True)
def slopes(window, weight, total, patch, energy, out):
    """Writes both slopes of a window, without what gain and offset explain, into ``out``.

    ``patch`` is the window centred, ``energy`` its product with itself.
    """
    half = np.float32(0.5)
    for axis in range(2):
        mean = np.float32(0.0)
        for j in range(SIDE):
            for i in range(SIDE):
                if axis == 0:
                    value = half * (window[j + 1, i + 2] - window[j + 1, i])
                else:
                    value = half * (window[j + 2, i + 1] - window[j, i + 1])
                out[axis, j, i] = value
                mean += weight[j, i] * value
        mean /= total
        along = np.float32(inner_product(out[axis], patch, weight) / energy)
        for j in range(SIDE):
            for i in range(SIDE):
                out[axis, j, i] -= mean + along * patch[j, i]


@nb.njit(cache=True, nogil=True)
def match_patch(template, target, valid, row, column, gauss, iterations, found):
    """Finds one patch; see ``match_patches``. ``found`` (7,) is its row."""
    n = SIDE + 2
    lines = np.zeros((n + 3, n), np.float32)
    window = np.zeros((n, n), np.float32)
    weight = np.zeros((SIDE, SIDE), np.float32)
    patch = np.zeros((SIDE, SIDE), np.float32)
    there = np.zeros((SIDE, SIDE), np.float32)
    slope = np.zeros((2, SIDE, SIDE), np.float32)
    x0, y0 = found[0], found[1]
    found[2] = -1.0
    if not (np.isfinite(x0) and np.isfinite(y0)):
        return
    if not shifted_window(template, row, column, 0.0, 0.0, lines, window):
        return
    share, full = 0.0, 0.0
    for j in range(SIDE):
        for i in range(SIDE):
            full += gauss[j, i]
            if valid[row + j - HALF, column + i - HALF]:
                weight[j, i] = gauss[j, i]
                share += gauss[j, i]
    if share < MIN_SHARE * full:
        return
    total = np.float32(share)
    centred(window, weight, total, patch)
    energy = inner_product(patch, patch, weight)
    if not energy > 0.0:
        return
    slopes(window, weight, total, patch, energy, slope)
    xx = inner_product(slope[0], slope[0], weight)
    xy = inner_product(slope[0], slope[1], weight)
    yy = inner_product(slope[1], slope[1], weight)
    floor = 1e-6 * (xx + yy) + 1e-12
    xx += floor
    yy += floor
    det = xx * yy - xy * xy
    x, y = x0, y0
    for _ in range(iterations):
        if not shifted_window(target, row, column, x, y, lines, window):
            return
        centred(window, weight, total, there)
        gain = inner_product(there, patch, weight) / energy
        gain = min(max(gain, MIN_GAIN), 1.0 / MIN_GAIN)
        # Slopes know neither gain nor offset, so neither does what they find.
        right_x = inner_product(slope[0], there, weight) / gain
        right_y = inner_product(slope[1], there, weight) / gain
        step_x = -(yy * right_x - xy * right_y) / det
        step_y = -(xx * right_y - xy * right_x) / det
        size = np.sqrt(step_x * step_x + step_y * step_y)
        if not np.isfinite(size):
            return
        if size > 1.0:
            step_x /= size
            step_y /= size
        x += step_x
        y += step_y
        if (x - x0) ** 2 + (y - y0) ** 2 > MAX_SHIFT**2:
            return
        if size < SETTLED:
            break
    if not shifted_window(target, row, column, x, y, lines, window):
        return
    centred(window, weight, total, there)
    product = inner_product(there, patch, weight)
    here = inner_product(there, there, weight)
    if not here > 0.0:
        return
    gain = min(max(product / energy, MIN_GAIN), 1.0 / MIN_GAIN)
    # The products of one photo's slopes with the other's: their noise does not meet.
    other = np.zeros((2, SIDE, SIDE), np.float32)
    slopes(window, weight, total, there, here, other)
    found[0] = x
    found[1] = y
    found[2] = product / np.sqrt(energy * here)
    found[3] = gain * inner_product(slope[0], other[0], weight)
    found[4] = 0.5 * gain * inner_product(slope[0], other[1], weight)
    found[4] += 0.5 * gain * inner_product(slope[1], other[0], weight)
    found[5] = gain * inner_product(slope[1], other[1], weight)
    found[6] = max(here - 2.0 * gain * product + gain * gain * energy, 0.0) / share


@nb.njit(parallel=True, cache=True, nogil=True)
def match_patches(template, target, valid, centres, starts, iterations):
    """Finds patches of one image in another by Lucas and Kanade's iteration.

    The patches differ by a shift, a gain and an offset; the last two are projected out.

    Args:
        template: (h, w) float32, whose patches are looked for.
        target: (h, w) float32, where they are looked for.
        valid: (h, w) which pixels of the template show the surface.
        centres: (n, 2) column and row of each patch's centre.
        starts: (n, 2) shift to begin at; NaN: leave the patch out.
        iterations: Steps at most.

    Returns:
        (n, 7): shift (2), correlation (-1: not found), structure tensor xx, xy, yy, and
        residual variance.

    References:
        S. Baker and I. Matthews, "Lucas-Kanade 20 years on: a unifying framework",
        IJCV 56(3), 2004, doi:10.1023/B:VISI.0000011205.11775.fd.
    """
    gauss = np.zeros((SIDE, SIDE), np.float32)
    for j in range(SIDE):
        for i in range(SIDE):
            distance = float((j - HALF) ** 2 + (i - HALF) ** 2)
            gauss[j, i] = np.exp(-0.5 * distance / WINDOW_SIGMA**2)
    n = len(centres)
    out = np.zeros((n, 7))
    for i in nb.prange(n):
        out[i, 0] = starts[i, 0]
        out[i, 1] = starts[i, 1]
        match_patch(
            template,
            target,
            valid,
            centres[i, 1],
            centres[i, 0],
            gauss,
            iterations,
            out[i],
        )
    return out


@nb.njit(cache=True, nogil=True)
def transfer_equations(errors, J, whitening, weights, cell_starts, cut):
    """Cost, gradients by cell and normal matrix of whitened residuals of two numbers.

    Args:
        errors: (n, 2) residuals in pixels.
        J: (n, 2, p) their derivatives.
        whitening: (n, 2, 2) L^-1 of each covariance L L^T.
        weights: (n,) of each residual's cost.
        cell_starts: (cells + 1,) first residual of each cell.
        cut: scale of the Cauchy cost, in sigmas.
    """
    p = J.shape[2]
    n_cells = len(cell_starts) - 1
    gradients = np.zeros((n_cells, p))
    normal = np.zeros((p, p))
    row = np.zeros((2, p))
    cost = 0.0
    for cell in range(n_cells):
        for i in range(cell_starts[cell], cell_starts[cell + 1]):
            a, b, c = whitening[i, 0, 0], whitening[i, 1, 0], whitening[i, 1, 1]
            u = a * errors[i, 0]
            v = b * errors[i, 0] + c * errors[i, 1]
            for j in range(p):
                row[0, j] = a * J[i, 0, j]
                row[1, j] = b * J[i, 0, j] + c * J[i, 1, j]
            squared = (u * u + v * v) / (cut * cut)
            cost += weights[i] * 0.5 * cut * cut * np.log1p(squared)
            w = weights[i] / (1.0 + squared)
            for j in range(p):
                gradients[cell, j] += w * (u * row[0, j] + v * row[1, j])
                for k in range(j + 1):
                    normal[j, k] += w * (row[0, j] * row[0, k] + row[1, j] * row[1, k])
    for j in range(p):
        for k in range(j):
            normal[k, j] = normal[j, k]
    return cost, gradients, normal
