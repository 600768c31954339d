"""Which colours are the object's, and which its surroundings'."""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import correlate1d

BINS = 24
"""Bins of each channel."""

ELSEWHERE, INSIDE, AROUND = 0, 1, 2
"""The regions of a photo."""


@dataclasses.dataclass(frozen=True, eq=False)
class ColourModel:
    """How much likelier a colour is inside the object than around it."""

    log_ratio: Float[np.ndarray, "b b b"]
    """log p(inside) / p(outside) of each bin of red, green and blue, clipped."""

    def of(self, colours: Float[np.ndarray, "*n 3"]) -> np.ndarray:
        """The log ratio of each colour (0 to 255)."""
        b = self.log_ratio.shape[0]
        index = np.clip(colours * (b / 256.0), 0, b - 1).astype(np.int64)
        return self.log_ratio[index[..., 0], index[..., 1], index[..., 2]]


def colour_bins(pixels: Float[np.ndarray, "h w 3"]) -> Int[np.ndarray, "h w"]:
    """The number of the bin, all channels together, of each colour (0 to 255)."""
    steps = np.multiply(pixels, BINS / 256.0, dtype=np.float64)
    np.floor(steps, out=steps)
    weights = np.array([[BINS * BINS, BINS, 1.0]])
    return cv2.transform(steps, weights).astype(np.int32)


def object_regions(
    covered: Bool[np.ndarray, "h w"], reach_px: float
) -> UInt8[np.ndarray, "h w"]:
    """``INSIDE`` the object, ``AROUND`` it within ``reach_px``, or ``ELSEWHERE``."""
    gap = cv2.distanceTransform((~covered).astype(np.uint8), cv2.DIST_L2, 5)
    regions = np.where(gap <= max(2, round(reach_px)), AROUND, ELSEWHERE)
    return np.where(covered, INSIDE, regions).astype(np.uint8)


def colour_model(
    bins: Int[np.ndarray, "h w"],
    regions: UInt8[np.ndarray, "h w"],
    counts: Bool[np.ndarray, "h w"] | None = None,
) -> ColourModel:
    """Colours inside the object and around it.

    The cover may be off by some pixels: the mistake is in both histograms and only
    makes them more alike.

    Args:
        bins: ``colour_bins`` of the photo.
        regions: ``object_regions`` of the object.
        counts: Only these pixels are looked at; None: all are.
    """
    if counts is not None:
        regions = np.where(counts, regions, np.uint8(ELSEWHERE))
    x, y, width, height = cv2.boundingRect(regions)
    window = np.s_[y : y + height, x : x + width]
    numbers = bins[window] + BINS**3 * regions[window].astype(np.int32)
    histograms = np.bincount(numbers.ravel(), minlength=3 * BINS**3)
    shares = {}
    for region in (INSIDE, AROUND):
        smooth = histograms.reshape(3, BINS, BINS, BINS)[region].astype(np.float64)
        for axis in range(3):
            smooth = correlate1d(smooth, [0.25, 0.5, 0.25], axis, mode="nearest")
        shares[region] = (smooth + 0.02) / (smooth + 0.02).sum()
    ratio = np.log(shares[INSIDE] / shares[AROUND])
    return ColourModel(np.clip(ratio, -3.0, 3.0))
