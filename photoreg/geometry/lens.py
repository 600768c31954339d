"""How a real lens bends what an ideal one shows: Brown's model, as OpenCV writes it.

A point at ideal coordinates (x, y), depth 1, appears at

    x' = x q + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y q + p1 (r^2 + 2 y^2) + 2 p2 x y,    q = 1 + k1 r^2 + k2 r^4 + k3 r^6

and its pixel is K (x', y', 1). Beyond the radius where r q stops growing the polynomial
folds back, and would show what is far outside the photo inside it: what lies beyond
counts as not seen.

References:
    D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8),
    1971; OpenCV, "Camera Calibration and 3D Reconstruction".
"""

import dataclasses
import functools
from typing import Literal

import numba as nb
import numpy as np

from photoreg.errors import InputError

MAX_COEFFICIENT = 1e6
"""Largest coefficient that is accepted."""

NEWTON_STEPS = 50
NEWTON_TOLERANCE = 1e-13
"""When undistorting ends, in ideal coordinates: a ten-millionth of a pixel at most."""

Distortion = Literal["none", "auto", "k1", "k1k2", "full"]
"""Which terms of a lens are solved: none, k1 and as many more as the data decide, k1, k1
and k2, or all five."""

TERMS = ("k1", "k2", "p1", "p2", "k3")
"""The terms in OpenCV's order, each of less effect than those before."""

N_TERMS: dict[Distortion, int] = {
    "none": 0,
    "auto": 1,
    "k1": 1,
    "k1k2": 2,
    "full": 5,
}
"""How many of ``TERMS`` are solved; with "auto" to begin with."""


@dataclasses.dataclass(frozen=True)
class Lens:
    """The distortion of a lens; without arguments an ideal one.

    Raises:
        InputError: at construction, if a term is not finite or absurdly large.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __post_init__(self) -> None:
        for term in TERMS:
            value = float(getattr(self, term))
            if not abs(value) <= MAX_COEFFICIENT:
                raise InputError(
                    f"The lens term {term} is {value:g}; the largest possible is "
                    f"{MAX_COEFFICIENT:g}."
                )
            object.__setattr__(self, term, value)

    @property
    def terms(self) -> tuple[float, float, float, float, float]:
        """k1, k2, p1, p2, k3: OpenCV's order."""
        return self.k1, self.k2, self.p1, self.p2, self.k3

    @property
    def is_ideal(self) -> bool:
        """Whether it bends nothing."""
        return not any(self.terms)

    @functools.cached_property
    def max_radius(self) -> float:
        """Ideal radius up to which points are seen: where r q stops growing.

        Infinite where it grows for ever.
        """
        # By s = r^2: d(r q) / dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3.
        roots = np.roots([7.0 * self.k3, 5.0 * self.k2, 3.0 * self.k1, 1.0])
        real = roots[np.abs(roots.imag) <= 1e-9 * np.abs(roots.real)].real
        return float(np.sqrt(min(real[real > 0.0], default=np.inf)))

    def in_words(self) -> str:
        """The terms that are not 0, for people."""
        given = [
            f"{term} {value:.4g}"
            for term, value in zip(TERMS, self.terms, strict=True)
            if value
        ]
        return ", ".join(given) or "none"


IDEAL = Lens()
"""A lens that bends nothing."""


@nb.njit(cache=True, nogil=True)
def distorted(lens, x, y):  # noqa: ANN001, ANN201
    """Where ideal coordinates appear; ``lens`` has the fields k1 k2 p1 p2 k3."""
    s = x * x + y * y
    q = 1.0 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))
    return (
        x * q + 2.0 * lens.p1 * x * y + lens.p2 * (s + 2.0 * x * x),
        y * q + lens.p1 * (s + 2.0 * y * y) + 2.0 * lens.p2 * x * y,
    )


@nb.njit(cache=True, nogil=True)
def distortion_slopes(lens, x, y):  # noqa: ANN001, ANN201
    """Derivatives of ``distorted``: of x' by x, of x' by y (and y' by x), of y' by y."""
    s = x * x + y * y
    q = 1.0 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))
    # q by s.
    d = lens.k1 + s * (2.0 * lens.k2 + s * 3.0 * lens.k3)
    return (
        q + 2.0 * x * x * d + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x,
        2.0 * x * y * d + 2.0 * lens.p1 * x + 2.0 * lens.p2 * y,
        q + 2.0 * y * y * d + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x,
    )


@nb.njit(cache=True, nogil=True)
def undistorted(lens, x, y):  # noqa: ANN001, ANN201
    """Ideal coordinates of what appears at (x, y); NaN where nothing does.

    By Newton's method; ``lens`` has the fields of ``distorted`` and ``max_radius2``.
    """
    u, v = x, y
    # Start within the fold, where the steps lead to the inner solution.
    s = u * u + v * v
    if s > 0.8 * lens.max_radius2:
        shrink = np.sqrt(0.8 * lens.max_radius2 / s)
        u, v = u * shrink, v * shrink
    for _ in range(NEWTON_STEPS):
        du, dv = distorted(lens, u, v)
        du, dv = x - du, y - dv
        xx, xy, yy = distortion_slopes(lens, u, v)
        det = xx * yy - xy * xy
        if not det > 0.0:
            break
        step_u, step_v = (yy * du - xy * dv) / det, (xx * dv - xy * du) / det
        u += step_u
        v += step_v
        s = u * u + v * v
        if s > lens.max_radius2:
            shrink = np.sqrt(lens.max_radius2 / s)
            u, v = u * shrink, v * shrink
        if abs(step_u) + abs(step_v) < NEWTON_TOLERANCE * (1.0 + np.sqrt(s)):
            break
    du, dv = distorted(lens, u, v)
    if abs(x - du) + abs(y - dv) < 1e-9 * (1.0 + abs(x) + abs(y)):
        return u, v
    return np.nan, np.nan
