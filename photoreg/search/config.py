"""How the search compares photos."""

import dataclasses
from typing import Literal

import numpy as np

from photoreg.errors import InputError
from photoreg.imaging.colour import ColourSpace

CostName = Literal["ssd", "trimmed_squares", "alpha_trimmed", "variance", "mncc"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ConsistencyConfig:
    """How two or more photos of a surface are compared."""

    colour: ColourSpace = "luv"
    """Colour space of the differences: rgb, xyz, hsi, luv or lab; each on a scale of
    about 100."""
    cost: CostName = "alpha_trimmed"
    """ssd: mean of squared differences (the paper's eq. 1). trimmed_squares: without
    the largest share alpha. alpha_trimmed: without the share alpha at either end.
    variance: mean variance of a point's colours. mncc: 1 - modified normalised
    cross-correlation of small patches carried over the surface."""
    alpha: float = 0.2
    """Share of the points trimmed, in [0, 0.5). 0.2 tolerates a highlight over a fifth
    of what is seen."""
    exposure: bool = True
    """Whether gain and offset of each colour channel may differ between photos; solved
    in closed form for each individual."""
    relative: bool = False
    """Whether the cost is relative to the variance of the colours seen, so that cameras
    that look at something plain gain nothing. Not for mncc, which is so already."""
    min_cosine: float = 0.5
    """A camera sees a point if the cosine between its normal and the direction to the
    camera is at least this, in [0, 1). 0.5 is 60 degrees."""
    min_share: float = 0.5
    """Cameras that see fewer points in common than this share of what the start sees
    get an infinite cost, in [0, 1]. 0: no limit."""
    max_side_px: int = 1600
    """Photos are reduced to this longer side, in pixels, at least 16."""
    blur_px: float = 0.0
    """Sigma of a Gaussian blur of the reduced photos, in their pixels, 0 or more."""

    patch_side: int = 5
    """Points along a side of an mncc patch, odd, 3 to 99."""
    patch_step_px: float = 2.0
    """Distance between the points of an mncc patch, in pixels of the reduced photos,
    above 0."""

    def __post_init__(self) -> None:
        if not 3 <= self.patch_side <= 99 or self.patch_side % 2 == 0:
            raise InputError(
                f"patch_side is {self.patch_side}; give an odd number from 3 to 99."
            )
        if not 0.0 < self.patch_step_px < np.inf:
            raise InputError(
                f"patch_step_px is {self.patch_step_px}; give a number above 0."
            )
        if not 0.0 <= self.alpha < 0.5:
            raise InputError(f"alpha is {self.alpha}; give a share in [0, 0.5).")
        if not 0.0 <= self.min_cosine < 1.0:
            raise InputError(
                f"min_cosine is {self.min_cosine}; give a cosine in [0, 1)."
            )
        if not 0.0 <= self.min_share <= 1.0:
            raise InputError(f"min_share is {self.min_share}; give a share in [0, 1].")
        if self.max_side_px < 16:
            raise InputError(f"max_side_px is {self.max_side_px}; give at least 16.")
        if not 0.0 <= self.blur_px < np.inf:
            raise InputError(f"blur_px is {self.blur_px}; give 0 or more.")

    @property
    def trimmed_shares(self) -> tuple[float, float]:
        """Shares dropped at the low and at the high end."""
        high = self.alpha if self.cost in ("trimmed_squares", "alpha_trimmed") else 0.0
        return (self.alpha if self.cost == "alpha_trimmed" else 0.0), high
