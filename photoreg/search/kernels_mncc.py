"""The MNCC cost of a whole population of cameras, compiled.

Like ``kernels.population_costs``, but each sample is a small patch of surface points,
and what is compared is the pattern of colours, not the colours.
"""

import numba as nb
import numpy as np

from photoreg.geometry.projection import homogeneous
from photoreg.imaging.exposure import FASTMATH
from photoreg.search.kernels import project_all

FLAT = np.float32(1e-6)
"""Variance in squared colour units below which a patch has no pattern at all."""


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def sample_patch(patch, P, pixels, offset, width, height, colours):
    """Bilinear colours of one patch in one photo, less their mean.

    Args:
        patch: (q, 3) float32 points.
        P: (3, 4) float32, depth positive in front.
        pixels: (total, 4) float32: three colour channels and validity.
        offset: The photo's first row in ``pixels``.
        width: Photo width in pixels.
        height: Photo height in pixels.
        colours: (q, 3) float32, written.

    Returns:
        The sum of squares of what is written, or -1 where the patch leaves the photo
        or its mask.
    """
    n = len(patch)
    mean_0, mean_1, mean_2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(n):
        x, y, z = patch[k, 0], patch[k, 1], patch[k, 2]
        u, v, depth = homogeneous(P, x, y, z)
        u, v = u / depth, v / depth
        inside = (
            (depth > 0) & (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
        )
        if not inside:
            return np.float32(-1.0)
        column = min(np.int64(u), width - 2)
        row = min(np.int64(v), height - 2)
        fx, fy = u - np.float32(column), v - np.float32(row)
        at = np.uint64(offset + row * width + column)
        below = at + np.uint64(width)
        one = np.uint64(1)
        w11 = fx * fy
        w01, w10 = fx - w11, fy - w11
        w00 = np.float32(1.0) - fx - w10
        validity = (
            w00 * pixels[at, 3]
            + w01 * pixels[at + one, 3]
            + w10 * pixels[below, 3]
            + w11 * pixels[below + one, 3]
        )
        if validity < np.float32(0.999):
            return np.float32(-1.0)
        for c in range(3):
            colours[k, c] = (
                w00 * pixels[at, c]
                + w01 * pixels[at + one, c]
                + w10 * pixels[below, c]
                + w11 * pixels[below + one, c]
            )
        mean_0 += colours[k, 0]
        mean_1 += colours[k, 1]
        mean_2 += colours[k, 2]
    share = np.float32(1.0) / np.float32(n)
    mean_0, mean_1, mean_2 = mean_0 * share, mean_1 * share, mean_2 * share
    squares = np.float32(0.0)
    for k in range(n):
        colours[k, 0] -= mean_0
        colours[k, 1] -= mean_1
        colours[k, 2] -= mean_2
        squares += colours[k, 0] ** 2 + colours[k, 1] ** 2 + colours[k, 2] ** 2
    return squares


@nb.njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def population_mncc(
    points,
    patches,
    projections,
    centers,
    allowed,
    pixels,
    layouts,
    min_cosine,
    min_samples,
    n_chunks,
):
    """1 - MNCC per individual, in [0, 2], and how many patches it was made from.

    MNCC of two photos is 2 cov / (var + var) [1]; of m photos the sum of the
    covariances of all pairs over that of their mean variances, which is linear in m:
    the covariances of all ordered pairs sum to the squares of the summed patches less
    the squares of each. The population's cost is the mean over its patches.

    Args:
        points: (7, n) float32 rows of the patches' middles, as in ``project``.
        patches: (n, q, 3) float32 points of each patch.
        projections: (p, m, 3, 4) float32.
        centers: (p, m, 3) float32.
        allowed: (m, n) uint8, 0 where a photo is known not to show the sample.
        pixels: (total, 4) float32: colours and validity of all photos, in a row.
        layouts: (m, 3) int64: first row in ``pixels``, width, height of each photo.
        min_cosine: Least cosine between normal and direction to the camera.
        min_samples: With fewer patches, the cost is +inf.
        n_chunks: Into how many parts the population is split for the threads.

    References:
        [1] R. Sara, "Finding the largest unambiguous component of stereo matching",
        ECCV 2002.
    """
    n_individuals, n_photos = projections.shape[0], projections.shape[1]
    n, n_patch = points.shape[1], patches.shape[1]
    costs = np.full(n_individuals, np.inf)
    kept = np.zeros(n_individuals, np.int64)
    for chunk in nb.prange(n_chunks):
        u = np.zeros((n_photos, n), np.float32)
        v = np.zeros((n_photos, n), np.float32)
        seen = np.zeros((n_photos, n), np.uint8)
        index = np.zeros(n + 1, np.int32)
        colours = np.zeros((n_patch, 3), np.float32)
        summed = np.zeros((n_patch, 3), np.float32)
        for individual in range(chunk, n_individuals, n_chunks):
            n_seen = project_all(
                points,
                projections[individual],
                centers[individual],
                layouts,
                min_cosine,
                allowed,
                u,
                v,
                seen,
                index,
            )
            total, count = 0.0, 0
            for k in range(n_seen):
                j = index[k]
                summed[:, :] = np.float32(0.0)
                squares, n_seeing = np.float32(0.0), 0
                for i in range(n_photos):
                    if seen[i, j] == 0:
                        continue
                    own = sample_patch(
                        patches[j],
                        projections[individual, i],
                        pixels,
                        layouts[i, 0],
                        layouts[i, 1],
                        layouts[i, 2],
                        colours,
                    )
                    if own < np.float32(0.0):
                        continue
                    squares += own
                    n_seeing += 1
                    for q in range(n_patch):
                        for c in range(3):
                            summed[q, c] += colours[q, c]
                if n_seeing < 2:
                    continue
                together = np.float32(0.0)
                for q in range(n_patch):
                    for c in range(3):
                        together += summed[q, c] * summed[q, c]
                flat = FLAT * np.float32(n_patch)
                covariance = (together - squares) / np.float32(n_seeing - 1)
                total += 1.0 - covariance / (squares + flat)
                count += 1
            kept[individual] = count
            if count >= max(min_samples, 1):
                costs[individual] = total / count
    return costs, kept
