"""Gain and offset between photos: how far they may go, and in closed form, compiled.

Each use has its own measure of the gain, for one cap: the search asks thousands of times
a second, of cameras that are wrong, and takes this one of means and variances; the polish
takes variances within cells (`photoreg.polish.photometric_term.exposure_gain`), as slow
light would pass for contrast; the texture takes medians of all photos together
(`photoreg.texture.blend.exposure_gains`); the picture of the disagreement takes medians
of brightness, without an offset.
"""

import numba as nb
import numpy as np

FASTMATH = {"reassoc", "contract", "arcp", "nsz"}
"""Not "nnan": a point in a camera's plane gives NaN, and must compare as unseen."""

MAX_GAIN = 2.0
"""Gains of a photo beyond this, or below its inverse, are clipped, so between two
photos beyond its square, two stops: the deviation of a channel without contrast is
noise, and its ratio between photos means nothing."""


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def pair_exposure(colours, n, gains, offsets):
    """Gain and offset a channel that bring two photos to their common mean and spread.

    Closed form and symmetric: both photos' colours of the samples get the mean of
    the two means and the mean of the two variances. Least squares of one photo on the
    other would shrink the gain of a misaligned individual towards 0, and so reward
    misalignment.

    Args:
        colours: (2, n_all, 4) float32; the first ``n`` samples count.
        n: How many samples.
        gains: (2, 4) float32, written: colour = gain colour + offset.
        offsets: (2, 4) float32, written.

    Returns:
        The photos' common variance, summed over the channels.
    """
    total = 0.0
    for c in range(3):
        sum_a, sum_b, square_a, square_b = 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            a, b = np.float64(colours[0, k, c]), np.float64(colours[1, k, c])
            sum_a += a
            sum_b += b
            square_a += a * a
            square_b += b * b
        mean_a, mean_b = sum_a / n, sum_b / n
        spread_a = max(square_a / n - mean_a * mean_a, 0.0)
        spread_b = max(square_b / n - mean_b * mean_b, 0.0)
        common = 0.5 * (spread_a + spread_b)
        total += common
        mean = 0.5 * (mean_a + mean_b)
        gain_a, gain_b = clipped_gain(common, spread_a), clipped_gain(common, spread_b)
        gains[0, c], offsets[0, c] = gain_a, mean - gain_a * mean_a
        gains[1, c], offsets[1, c] = gain_b, mean - gain_b * mean_b
    return total


@nb.njit(cache=True, nogil=True, error_model="numpy")
def clipped_gain(wanted, own):
    """The gain that takes variance ``own`` to ``wanted``, within ``MAX_GAIN``."""
    if own <= 0.0:
        return 1.0
    return min(max(np.sqrt(wanted / own), 1.0 / MAX_GAIN), MAX_GAIN)


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def group_exposure(colours, seen, index, n, gains, offsets):
    """``pair_exposure`` for any number of photos, in time linear in their number.

    Each photo's mean over the samples it sees is moved to the mean of all photos that
    see them, then its variance about that mean is brought to theirs. With two photos
    it is ``pair_exposure``.

    Args:
        colours: (m, n_all, 4) float32.
        seen: (m, n_all) uint8, by the samples' own numbers.
        index: (n_all,) int32: the sample's number of each of the first ``n`` rows.
        n: How many samples.
        gains: (m, 4) float32, written.
        offsets: (m, 4) float32, written.

    Returns:
        The photos' common variance, summed over the channels.
    """
    n_photos = colours.shape[0]
    total = 0.0
    shift = np.zeros(n_photos)
    own_sum = np.zeros(n_photos)
    count = np.zeros(n_photos)
    own = np.zeros(n_photos)
    theirs = np.zeros(n_photos)
    for c in range(3):
        shift[:], own_sum[:], count[:], own[:], theirs[:] = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            pooled, n_seeing = 0.0, 0
            for i in range(n_photos):
                if seen[i, index[k]] != 0:
                    pooled += colours[i, k, c]
                    n_seeing += 1
            pooled /= n_seeing
            for i in range(n_photos):
                if seen[i, index[k]] != 0:
                    shift[i] += pooled - colours[i, k, c]
                    own_sum[i] += colours[i, k, c]
                    count[i] += 1.0
        for i in range(n_photos):
            shift[i] /= max(count[i], 1.0)
            own_sum[i] = own_sum[i] / max(count[i], 1.0) + shift[i]
        for k in range(n):
            first, second, n_seeing = 0.0, 0.0, 0
            for i in range(n_photos):
                if seen[i, index[k]] != 0:
                    value = colours[i, k, c] + shift[i]
                    first += value
                    second += value * value
                    n_seeing += 1
            first /= n_seeing
            second /= n_seeing
            for i in range(n_photos):
                if seen[i, index[k]] != 0:
                    mean = own_sum[i]
                    own[i] += (colours[i, k, c] + shift[i] - mean) ** 2
                    theirs[i] += second - 2.0 * mean * first + mean * mean
        for i in range(n_photos):
            gain = clipped_gain(theirs[i], own[i])
            gains[i, c] = gain
            offsets[i, c] = gain * shift[i] + (1.0 - gain) * own_sum[i]
            total += theirs[i] / max(count[i], 1.0) / n_photos
    return total
