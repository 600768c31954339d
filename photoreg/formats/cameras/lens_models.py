"""The lens models of other programs, as Brown's terms."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.formats.cameras.lens_terms import refuse_distortion
from photoreg.formats.parsing import lens_of
from photoreg.geometry.lens import Lens

MAX_FIT_PX = 0.05
"""How far, within the photo, the terms fitted to a rational model may be off it."""


def opencv_lens(
    coefficients: Sequence[float],
    K: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
    where: str,
) -> Lens:
    """The lens of OpenCV's vector k1 k2 p1 p2 [k3 [k4 k5 k6 [thin prism, tilt ...]]].

    The rational model, k4 to k6, has no place in Brown's: three radial terms are fitted
    to it over the photo, by least squares.

    Raises:
        InputError: if the fit is not good enough, or there is more that is not zero.
    """
    values = [*map(float, coefficients), *[0.0] * 14]
    k1, k2, p1, p2, k3, k4, k5, k6 = values[:8]
    refuse_distortion(values[8:], where)
    lens = lens_of(where, k1, k2, p1, p2, k3)
    if k4 == k5 == k6 == 0.0:
        return lens
    corners = np.array(
        [[x, y, 1.0] for x in (0, size[0] - 1) for y in (0, size[1] - 1)]
    )
    ideal = np.linalg.solve(K, corners.T)[:2]
    # Ideal radii up to a quarter beyond the corner: they may appear within the photo.
    s = np.linspace(0.0, 1.25 * np.hypot(*ideal).max(), 200)[1:] ** 2
    wanted = (1.0 + s * (k1 + s * (k2 + s * k3))) / (1.0 + s * (k4 + s * (k5 + s * k6)))
    powers = np.stack([s, s**2, s**3], axis=1)
    radius = np.sqrt(s)
    fitted = np.linalg.lstsq(
        powers * radius[:, None], (wanted - 1.0) * radius, rcond=None
    )[0]
    off_px = np.abs(powers @ fitted + 1.0 - wanted) * radius * K[0, 0]
    if not off_px.max() <= MAX_FIT_PX:
        raise InputError(
            f"{where} has a rational lens distortion (k4, k5, k6), which photoreg's terms "
            f"meet to {off_px.max():.2g} px only; undistort the photos in the program "
            "that made this file and export again."
        )
    return Lens(float(fitted[0]), float(fitted[1]), p1, p2, float(fitted[2]))
