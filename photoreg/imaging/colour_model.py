"""Which colours are the object's, and which its surroundings'."""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import correlate1d


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


def colour_model(
    pixels: Float[np.ndarray, "h w 3"],
    covered: Bool[np.ndarray, "h w"],
    reach_px: float,
    counts: Bool[np.ndarray, "h w"] | None = None,
) -> ColourModel:
    """Colours inside the object and in a band of ``reach_px`` around it.

    The cover may be off by some pixels: the mistake is in both histograms and only
    makes them more alike. Only pixels that ``counts`` has are looked at.
    """
    bins = 24
    gap = cv2.distanceTransform((~covered).astype(np.uint8), cv2.DIST_L2, 5)
    around = ~covered & (gap <= max(2, round(reach_px)))
    values = np.ascontiguousarray(pixels, dtype=np.float32)
    histograms = []
    for region in (covered, around):
        region = region if counts is None else region & counts
        smooth = cv2.calcHist(
            [values], [0, 1, 2], region.astype(np.uint8), [bins] * 3, [0.0, 256.0] * 3
        ).astype(np.float64)
        for axis in range(3):
            smooth = correlate1d(smooth, [0.25, 0.5, 0.25], axis, mode="nearest")
        histograms.append((smooth + 0.02) / (smooth + 0.02).sum())
    ratio = np.log(histograms[0] / histograms[1])
    return ColourModel(np.clip(ratio, -3.0, 3.0))
