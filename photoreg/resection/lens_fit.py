"""The first radial term of a lens, from pairs that an ideal lens has explained roughly."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import leastsq

from photoreg.resection import pinhole_model
from photoreg.resection.pinhole_model import N_PARAMETERS, Models, Pairs

K1_SIGMA = 0.1
"""Standard deviation of k1 among the lenses of phones and cameras."""
UNTRUSTED = 1e-9
"""What is left of the prior where the pairs are exact without it."""
DERIVATIVE_STEP = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class LensFit:
    """A pinhole with one radial term, and how sure it is."""

    model: Models
    k1: float
    covariance: Float[np.ndarray, "10 10"]
    """Of the model's parameters and k1."""
    offsets_px: Float[np.ndarray, "n 2"]
    """Of all pairs, those left out too."""

    @property
    def k1_error(self) -> float:
        """Standard error of k1."""
        return float(np.sqrt(self.covariance[-1, -1]))


def fit_k1(
    start: Models,
    pairs: Pairs,
    sigma_px: float,
    inliers: Bool[np.ndarray, "n"],
    trust: float = 1.0,
) -> LensFit:
    """Least squares (MINPACK) over all the pinhole's parameters and k1.

    Args:
        start: One model, near the solution.
        pairs: Points, pixels and expectations; k1 is expected to be 0.
        sigma_px: Standard error of a pixel, each axis.
        inliers: The pairs that count.
        trust: How much of the prior counts, from 0 to 1.
    """
    weights = np.append(pairs.prior_weights, K1_SIGMA**-2)[6:]
    roots = trust * np.sqrt(weights)

    def residuals(step: np.ndarray) -> np.ndarray:
        moved = start.moved(step[None, :-1], pairs.unit_px)
        offsets = pixels_of(moved, step[-1], pairs.X, pairs.A) - pairs.pixels
        off = np.append(pairs.prior_steps(moved)[0, 6:], step[-1])
        return np.concatenate([offsets[inliers].ravel() / sigma_px, roots * off])

    step, covariance, *_ = leastsq(
        residuals,
        np.zeros(N_PARAMETERS + 1),
        xtol=1e-14,
        ftol=1e-15,
        gtol=0.0,
        maxfev=2000,
        full_output=True,
    )
    if covariance is None:
        # Nothing is known of some direction.
        covariance = np.full((N_PARAMETERS + 1,) * 2, np.inf)
    model, k1 = start.moved(step[None, :-1], pairs.unit_px), float(step[-1])
    offsets = pixels_of(model, k1, pairs.X, pairs.A) - pairs.pixels
    return LensFit(model, k1, covariance, offsets)


def pixels_of(
    model: Models, k1: float, X: Float[np.ndarray, "n 3"], A: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "n 2"]:
    """Where one model shows points through a lens of one radial term."""
    outward = pinhole_model.project(model, X, A)[0] - model.c
    ideal = np.linalg.solve(A, outward.T).T / np.exp(model.log_f)
    return model.c + outward * (1.0 + k1 * (ideal**2).sum(axis=1))[:, None]


def expected_errors(
    fit: LensFit, pairs: Pairs, where: Float[np.ndarray, "m 3"]
) -> tuple[float, float]:
    """Root mean square error over points in pixels; relative error of the focal length."""
    where = where[pinhole_model.depths(fit.model, where)[0] > 0.1]
    columns = []
    for k in range(N_PARAMETERS + 1):
        ends = []
        for side in (DERIVATIVE_STEP, -DERIVATIVE_STEP):
            step = np.zeros((1, N_PARAMETERS + 1))
            step[0, k] = side
            moved = fit.model.moved(step[:, :-1], pairs.unit_px)
            ends.append(pixels_of(moved, fit.k1 + step[0, -1], where, pairs.A))
        columns.append((ends[0] - ends[1]) / (2.0 * DERIVATIVE_STEP))
    J = np.stack(columns, axis=-1)
    variance = np.einsum("nij,jk,nik->n", J, fit.covariance, J)
    return float(np.sqrt(variance.mean())), float(np.sqrt(fit.covariance[6, 6]))
