"""A scan's own error as a field over the surface: its size and correlation length.

The errors of neighbouring places of a scan are correlated, so many matches do not average
them out, and the cameras follow their slowest part, which is in no residual. The residuals
still show size and length, if it is taken into account what the cameras can follow.
"""

import dataclasses

import numpy as np
import scipy.spatial.distance
from jaxtyping import Float
from scipy.linalg import solve_triangular

LENGTHS = (0.0, 1.0, 2.0, 4.0)
"""Correlation lengths that are tried, in distances of neighbouring cells. Longer ones are
changes of the whole, which look like other cameras."""
SIGMAS = np.geomspace(0.05, 1000.0, 60)
"""Its size, over the noise of the typical cell."""
OUTLIER = 3.0
"""Robust standard deviations beyond which a cell counts as if it were there."""


@dataclasses.dataclass(frozen=True)
class MeshField:
    """A Gaussian field of zero mean over the surface."""

    sigma: float
    """Standard deviation, in model units along the normal."""
    length: float
    """Its correlation over a distance d is exp(-d^2 / 2 length^2); 0: none."""

    def covariance(self, places: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m m"]:
        """Of its values at places of the surface."""
        return self.sigma**2 * _correlation(places, self.length)

    def scatter(
        self, places: Float[np.ndarray, "m 3"], slopes: Float[np.ndarray, "m p"]
    ) -> Float[np.ndarray, "p p"]:
        """Covariance of the sum over places of ``slopes`` times the field there."""
        # By numpy's own loops, not BLAS: the same bits on any number of threads.
        return np.einsum("cp,cd,dq->pq", slopes, self.covariance(places), slopes)


def fit_mesh_field(
    errors: Float[np.ndarray, "m"],
    variances: Float[np.ndarray, "m"],
    design: Float[np.ndarray, "m p"],
    places: Float[np.ndarray, "m 3"],
) -> MeshField:
    """The field under which the errors left where the cameras ended are the most likely.

    Args:
        errors: Of places of the scan, along its normal, in model units.
        variances: Of these by the matches' noise.
        design: What each unit of the cameras' numbers, one sigma of their prior, changes
            of them.
        places: Where, in world axes; three or more.

    Returns:
        The field of the greatest evidence: that of errors = design . b + field + noise,
        over all b of the prior.

    References:
        D. A. Harville, "Maximum likelihood approaches to variance component estimation",
        JASA 72(358), 1977, doi:10.1080/01621459.1977.10480998.
    """
    spread = 1.4826 * float(np.median(np.abs(errors)))
    errors = np.clip(errors, -OUTLIER * spread, OUTLIER * spread)
    unit = _neighbours_apart(places)
    noise_sigma = float(np.sqrt(np.median(variances)))
    # In units of what is known, so that one decomposition a length serves all sizes.
    factor = np.linalg.cholesky(design @ design.T + np.diag(variances))
    white = solve_triangular(factor, errors, lower=True)
    best, most = MeshField(0.0, 0.0), -0.5 * float(white @ white)
    for length in LENGTHS:
        half = solve_triangular(factor, _correlation(places, length * unit), lower=True)
        values, vectors = np.linalg.eigh(solve_triangular(factor, half.T, lower=True))
        squares = (vectors.T @ white) ** 2
        for sigma in (SIGMAS * noise_sigma).tolist():
            spread = 1.0 + sigma**2 * np.maximum(values, 0.0)
            found = -0.5 * float((squares / spread + np.log(spread)).sum())
            if found > most:
                best, most = MeshField(sigma, length * unit), found
    return best


def _neighbours_apart(places: Float[np.ndarray, "m 3"]) -> float:
    """The median distance from a place to the next."""
    apart = scipy.spatial.distance.squareform(scipy.spatial.distance.pdist(places))
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(axis=1)))


def _correlation(
    places: Float[np.ndarray, "m 3"], length: float
) -> Float[np.ndarray, "m m"]:
    if length == 0.0:
        return np.eye(len(places))
    squares = scipy.spatial.distance.cdist(places, places, "sqeuclidean")
    return np.exp(-0.5 * squares / length**2)
