"""The cost of a whole population of cameras, compiled.

One call projects the samples by every individual's cameras, tests visibility, samples
the photos, compares and trims. Individuals run in parallel, each one serially, so a
cost is the same to the last bit whatever the number of threads.

What made it fast, in nanoseconds a point and photo pair (1,000 points, two 1024x768
photos, one thread): see the notes in the functions.
"""

import os

import numba as nb
import numpy as np

from photoreg.geometry.projection import homogeneous
from photoreg.imaging.exposure import FASTMATH, group_exposure, pair_exposure
from photoreg.search.trimmed_mean import N_BUCKETS, trimmed_mean

# A generation takes about a millisecond. GNU OpenMP's threads spin between two calls,
# and where another program wants the processor they spin away whole time slices of
# it: 14 ms a call were measured in place of 2.7. It reads this when numba first
# starts it, after this module is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

LEAST_SPREAD = 1e-3
"""Least variance of colours that a cost is divided by, relative to the reference."""


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def project(points, P, center, width, height, min_cosine, allowed, u, v, seen):
    """Projects samples by one camera and marks those it sees.

    Args:
        points: (7, n) float32 rows: x, y, z, normal x, y, z, and normal . position.
        P: (3, 4) float32, depth positive in front.
        center: (3,) float32 camera centre.
        width: Photo width in pixels.
        height: Photo height in pixels.
        min_cosine: Least cosine between normal and direction to the camera, >= 0.
        allowed: (n,) uint8, 0 where the sample is known to be hidden.
        u: (n,) float32, written: pixel columns (anything where unseen).
        v: (n,) float32, written: pixel rows.
        seen: (n,) uint8, written.
    """
    n = points.shape[1]
    right = np.float32(width - 1)
    bottom = np.float32(height - 1)
    zero = np.float32(0.0)
    squared_cosine = np.float32(min_cosine * min_cosine)
    cx, cy, cz = center[0], center[1], center[2]
    xs, ys, zs = points[0], points[1], points[2]
    nxs, nys, nzs, nds = points[3], points[4], points[5], points[6]
    for k in range(n):
        x, y, z = xs[k], ys[k], zs[k]
        pixel_x, pixel_y, depth = homogeneous(P, x, y, z)
        inverse = np.float32(1.0) / depth
        pixel_x *= inverse
        pixel_y *= inverse
        # cos >= c, without the root: d >= 0 and d^2 >= c^2 |C - X|^2.
        d = nxs[k] * cx + nys[k] * cy + nzs[k] * cz - nds[k]
        dx, dy, dz = cx - x, cy - y, cz - z
        u[k] = pixel_x
        v[k] = pixel_y
        seen[k] = (
            (depth > zero)
            & (d >= zero)
            & (d * d >= squared_cosine * (dx * dx + dy * dy + dz * dz))
            & (pixel_x >= zero)
            & (pixel_x <= right)
            & (pixel_y >= zero)
            & (pixel_y <= bottom)
            & (allowed[k] != 0)
        )


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def pixel_cell(offset, width, height, x, y):
    """Row of the pixel above and left of (x, y) in ``pixels``, and (x, y) from there."""
    column = min(np.int32(x), np.int32(width - 2))
    row = min(np.int32(y), np.int32(height - 2))
    at = np.uint64(offset + np.int64(row) * width + column)
    return at, x - np.float32(column), y - np.float32(row)


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def sample(pixels, layout, u, v, seen, index, n, colours):
    """Bilinear colours of the listed samples.

    All is read before anything is written: the compiler cannot know that ``colours``
    is not ``pixels``, and would read again after each store. With that, and with the
    validity left to ``sample_validity``, 2.5 ns in place of 3.4.

    Args:
        pixels: (total, 4) float32: three colour channels and validity, row by row.
        layout: (3,) int64: the photo's first row in ``pixels``, its width and height.
        u: (n_all,) float32 pixel columns, inside the photo where seen.
        v: (n_all,) float32 pixel rows.
        seen: (n_all,) uint8; what is not seen is left as it is.
        index: (n_all,) int32; the first ``n`` are the samples wanted.
        n: How many.
        colours: (n_all, 4) float32; three channels of the first ``n`` are written.
    """
    offset, width, height = layout[0], layout[1], layout[2]
    one, down = np.uint64(1), np.uint64(width)
    for k in range(n):
        # Unsigned, a number needs no test for counting from the end.
        j = np.uint64(index[k])
        if seen[j] == 0:
            continue
        at, fx, fy = pixel_cell(offset, width, height, u[j], v[j])
        p00, p01 = pixels[at], pixels[at + one]
        p10, p11 = pixels[at + down], pixels[at + down + one]
        w11 = fx * fy
        w01 = fx - w11
        w10 = fy - w11
        w00 = np.float32(1.0) - fx - w10
        first = w00 * p00[0] + w01 * p01[0] + w10 * p10[0] + w11 * p11[0]
        second = w00 * p00[1] + w01 * p01[1] + w10 * p10[1] + w11 * p11[1]
        third = w00 * p00[2] + w01 * p01[2] + w10 * p10[2] + w11 * p11[2]
        colours[k, 0], colours[k, 1], colours[k, 2] = first, second, third


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def sample_validity(pixels, layout, u, v, seen, index, n, colours):
    """Bilinear validity of the listed samples, into the fourth channel of ``colours``.

    The arguments are those of ``sample``.
    """
    offset, width, height = layout[0], layout[1], layout[2]
    one, down = np.uint64(1), np.uint64(width)
    for k in range(n):
        j = np.uint64(index[k])
        if seen[j] == 0:
            continue
        at, fx, fy = pixel_cell(offset, width, height, u[j], v[j])
        above = pixels[at, 3] + fx * (pixels[at + one, 3] - pixels[at, 3])
        at += down
        below = pixels[at, 3] + fx * (pixels[at + one, 3] - pixels[at, 3])
        colours[k, 3] = above + fy * (below - above)


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def pair_differences(colours, n, gains, offsets, values):
    """Squared colour difference of each sample in two photos; ``values`` is written."""
    a0, a1, a2 = gains[0, 0], gains[0, 1], gains[0, 2]
    b0, b1, b2 = gains[1, 0], gains[1, 1], gains[1, 2]
    c0 = offsets[0, 0] - offsets[1, 0]
    c1 = offsets[0, 1] - offsets[1, 1]
    c2 = offsets[0, 2] - offsets[1, 2]
    for k in range(n):
        x = a0 * colours[0, k, 0] - b0 * colours[1, k, 0] + c0
        y = a1 * colours[0, k, 1] - b1 * colours[1, k, 1] + c1
        z = a2 * colours[0, k, 2] - b2 * colours[1, k, 2] + c2
        values[k] = x * x + y * y + z * z


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def group_differences(colours, seen, index, n, gains, offsets, population, values):
    """Colour spread of each sample over the photos that see it; writes ``values``.

    ``population`` false: the mean squared difference over the photo pairs that see
    the sample; true: the variance of its colours. Both linear in the photos: over m
    colours the squared differences of all pairs sum to m times the squares about
    their mean.
    """
    n_photos = colours.shape[0]
    for k in range(n):
        j = index[k]
        x, y, z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        n_seeing = 0
        for i in range(n_photos):
            if seen[i, j] != 0:
                x += gains[i, 0] * colours[i, k, 0] + offsets[i, 0]
                y += gains[i, 1] * colours[i, k, 1] + offsets[i, 1]
                z += gains[i, 2] * colours[i, k, 2] + offsets[i, 2]
                n_seeing += 1
        x, y, z = x / n_seeing, y / n_seeing, z / n_seeing
        spread = np.float32(0.0)
        for i in range(n_photos):
            if seen[i, j] != 0:
                dx = gains[i, 0] * colours[i, k, 0] + offsets[i, 0] - x
                dy = gains[i, 1] * colours[i, k, 1] + offsets[i, 1] - y
                dz = gains[i, 2] * colours[i, k, 2] + offsets[i, 2] - z
                spread += dx * dx + dy * dy + dz * dz
        scale = 1.0 / n_seeing if population else 2.0 / (n_seeing - 1)
        values[k] = spread * np.float32(scale)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def list_seen(seen, index):
    """Lists the samples that two photos or more see; returns how many."""
    n_photos, n = seen.shape
    found = 0
    if n_photos == 2:
        for k in range(n):
            index[found] = k
            found += seen[0, k] & seen[1, k]
        return found
    for k in range(n):
        n_seeing = 0
        for i in range(n_photos):
            n_seeing += seen[i, k]
        index[found] = k
        found += n_seeing >= 2
    return found


@nb.njit(cache=True, nogil=True, error_model="numpy")
def project_all(
    points, projections, centers, layouts, min_cosine, allowed, u, v, seen, index
):
    """Projects samples by all cameras of an individual and lists what two see.

    Arguments are those of ``project``, one row a photo; ``index`` is written too.
    Returns how many samples are listed.
    """
    for i in range(len(projections)):
        project(
            points,
            projections[i],
            centers[i],
            layouts[i, 1],
            layouts[i, 2],
            min_cosine,
            allowed[i],
            u[i],
            v[i],
            seen[i],
        )
    return list_seen(seen, index)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def drop_masked(seen, index, n, colours):
    """Takes out what fell outside a photo's mask; returns how many samples are left."""
    n_photos = seen.shape[0]
    kept = 0
    for k in range(n):
        j = index[k]
        n_seeing = 0
        for i in range(n_photos):
            # A sample counts when all four pixels around it are inside the mask.
            if seen[i, j] != 0 and colours[i, k, 3] < np.float32(0.999):
                seen[i, j] = 0
            n_seeing += seen[i, j]
        if n_seeing >= 2:
            index[kept] = j
            for i in range(n_photos):
                for c in range(3):
                    colours[i, kept, c] = colours[i, k, c]
            kept += 1
    return kept


@nb.njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def population_costs(
    points,
    projections,
    centers,
    allowed,
    pixels,
    layouts,
    has_mask,
    min_cosine,
    low_share,
    high_share,
    is_variance,
    with_exposure,
    reference_spread,
    min_samples,
    n_chunks,
):
    """One cost per individual, and how many samples it was made from.

    Args:
        points: (7, n) float32 rows: x, y, z, normal x, y, z, normal . position.
        projections: (p, m, 3, 4) float32, depth positive in front.
        centers: (p, m, 3) float32 camera centres.
        allowed: (m, n) uint8, 0 where a photo is known not to show the sample.
        pixels: (total, 4) float32: colours and validity of all photos, in a row.
        layouts: (m, 3) int64: first row in ``pixels``, width, height of each photo.
        has_mask: Whether any validity is not 1.
        min_cosine: Least cosine between normal and direction to the camera.
        low_share: Share of the smallest values trimmed.
        high_share: Share of the largest.
        is_variance: Variance of the colours in place of squared pair differences.
        with_exposure: Whether to equalise gain and offset between photos.
        reference_spread: If above 0, the cost is multiplied by this over the variance
            of the colours seen: looking at something plain is no agreement.
        min_samples: With fewer, the cost is +inf.
        n_chunks: Into how many parts the population is split for the threads.

    Returns:
        costs (p,) float64, counts (p,) int64, and the variance of the colours seen
        (p,) float64; 0 where it was not asked for.
    """
    n_individuals, n_photos = projections.shape[0], projections.shape[1]
    n = points.shape[1]
    costs = np.full(n_individuals, np.inf)
    kept = np.zeros(n_individuals, np.int64)
    spreads = np.zeros(n_individuals)
    for chunk in nb.prange(n_chunks):
        u = np.empty((n_photos, n), np.float32)
        v = np.empty((n_photos, n), np.float32)
        seen = np.empty((n_photos, n), np.uint8)
        index = np.empty(n + 1, np.int32)
        colours = np.empty((n_photos, n, 4), np.float32)
        values = np.empty(n, np.float32)
        border = np.empty(n + 1, np.float32)
        counts = np.empty(N_BUCKETS, np.int32)
        gains = np.ones((n_photos, 4), np.float32)
        offsets = np.zeros((n_photos, 4), np.float32)
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
            for i in range(n_photos):
                at = pixels, layouts[i], u[i], v[i], seen[i], index, n_seen, colours[i]
                sample(*at)
                if has_mask:
                    sample_validity(*at)
            if has_mask:
                n_seen = drop_masked(seen, index, n_seen, colours)
            kept[individual] = n_seen
            if n_seen < min_samples:
                continue
            spread = 0.0
            if with_exposure or reference_spread > 0.0:
                if n_photos == 2:
                    spread = pair_exposure(colours, n_seen, gains, offsets)
                else:
                    spread = group_exposure(
                        colours, seen, index, n_seen, gains, offsets
                    )
                spreads[individual] = spread
                if not with_exposure:
                    gains[:, :] = np.float32(1.0)
                    offsets[:, :] = np.float32(0.0)
            if n_photos == 2 and not is_variance:
                pair_differences(colours, n_seen, gains, offsets, values)
            else:
                group_differences(
                    colours, seen, index, n_seen, gains, offsets, is_variance, values
                )
            costs[individual] = trimmed_mean(
                values,
                n_seen,
                int(low_share * n_seen),
                int(high_share * n_seen),
                counts,
                border,
            )
            if reference_spread > 0.0:
                least = LEAST_SPREAD * reference_spread
                costs[individual] *= reference_spread / max(spread, least)
    return costs, kept, spreads
