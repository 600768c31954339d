"""A pinhole model to fit to points: projection, derivatives, batched robust fit.

It works on arrays and many models at once, and knows no cameras. The points are centred
near the origin with size about 1. A model puts point X, turned to Y = R X, at the pixel

    p = c + (s A Y_xy + a - c) / (1 + s Y_z / f)

with the pixel a of the points' centre, its scale s in pixels per unit, the focal length
f, the principal point c, and A = [[1, skew], [0, aspect]]. It is the usual pinhole:
the distance is f / s. But where the points are far away for their size, a and s
stay well determined and only f is not, so that steps and priors act on what they name.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from photoreg.geometry.rotations import rotation_matrices

N_PARAMETERS = 9
"""Turn (3), a / unit (2), log s, log f, c / unit (2): pose first, then what a few pairs
leave open."""
_LEAST_DEPTH = 1e-3
"""Depths, as shares of the centre's, are cut off here: behind the camera counts as very
far off in the photo, never as a mirror image."""


@dataclasses.dataclass(frozen=True, eq=False)
class Models:
    """Pinhole models, any number at once."""

    R: Float[np.ndarray, "m 3 3"]
    """Rotations taking the points' axes to camera axes."""
    a: Float[np.ndarray, "m 2"]
    """Pixels of the points' centre."""
    log_s: Float[np.ndarray, "m"]
    """Logarithms of the scale at that centre, pixels per unit of the points."""
    log_f: Float[np.ndarray, "m"]
    """Logarithms of the horizontal focal lengths in pixels."""
    c: Float[np.ndarray, "m 2"]
    """Principal points in pixels."""

    def __len__(self) -> int:
        return len(self.R)

    def __getitem__(self, index: np.ndarray | slice) -> "Models":
        return Models(
            *(getattr(self, field.name)[index] for field in dataclasses.fields(self))
        )

    def moved(self, steps: Float[np.ndarray, "m k"], unit_px: float) -> "Models":
        """The models after steps in the first k parameters."""
        full = np.zeros((len(self), N_PARAMETERS))
        full[:, : steps.shape[1]] = steps
        return Models(
            rotation_matrices(full[:, :3]) @ self.R,
            self.a + unit_px * full[:, 3:5],
            self.log_s + full[:, 5],
            self.log_f + full[:, 6],
            self.c + unit_px * full[:, 7:9],
        )

    def where(self, chosen: np.ndarray, other: "Models") -> "Models":
        """These models where ``chosen``, else the other ones."""
        return Models(
            *(
                np.where(
                    chosen.reshape(-1, *[1] * (getattr(self, field.name).ndim - 1)),
                    getattr(self, field.name),
                    getattr(other, field.name),
                )
                for field in dataclasses.fields(self)
            )
        )


def joined(parts: list[Models]) -> Models:
    """All models of several batches in one."""
    return Models(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in dataclasses.fields(Models)
        )
    )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Pairs:
    """What the models are fitted to: points, pixels, and what is known beforehand."""

    X: Float[np.ndarray, "n 3"]
    """Points, centred, of size about 1."""
    pixels: Float[np.ndarray, "n 2"]
    A: Float[np.ndarray, "2 2"]
    """[[1, skew], [0, aspect]]."""
    log_f: float
    """Logarithm of the focal length that is expected."""
    log_f_sigma: float
    """Its standard error."""
    c: Float[np.ndarray, "2"]
    """The principal point that is expected, in pixels."""
    c_sigma_px: float
    """Its standard error, each axis."""
    unit_px: float
    """Unit of a and c among the parameters: about the photo's size."""

    @property
    def prior_weights(self) -> Float[np.ndarray, "9"]:
        """Inverse squared standard errors of the parameters; zero where unknown."""
        c_weight = (self.unit_px / self.c_sigma_px) ** 2
        return np.array([0.0] * 6 + [self.log_f_sigma**-2, c_weight, c_weight])

    def prior_steps(self, models: Models) -> Float[np.ndarray, "m 9"]:
        """How far each model lies from what is expected, in parameters."""
        steps = np.zeros((len(models), N_PARAMETERS))
        steps[:, 6] = models.log_f - self.log_f
        steps[:, 7:] = (models.c - self.c) / self.unit_px
        return steps


def depths(models: Models, X: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m n"]:
    """Depths as shares of the depth of the points' centre; positive is in front."""
    return 1.0 + np.exp(models.log_s - models.log_f)[:, None] * (X @ _rows(models, 2)).T


def project(models: Models, X: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Pixels (m, n, 2)."""
    return _project(models, X, A)[0]


def project_with_derivatives(
    models: Models, X: np.ndarray, A: np.ndarray, unit_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (m, n, 2) and their derivatives by the nine parameters (m, n, 2, 9)."""
    pixels, Y, flat, numerator, depth = _project(models, X, A)
    s = np.exp(models.log_s)[:, None]
    by_plane = (s / depth)[:, :, None, None] * A
    # How a pixel moves when its depth grows by what one unit of Y_z adds.
    by_z = -numerator * (s * np.exp(-models.log_f)[:, None] / depth**2)[:, :, None]
    x, y, z = (Y[:, :, axis, None] for axis in range(3))
    derivatives = np.zeros((*pixels.shape, N_PARAMETERS))
    # A turn w moves Y by w x Y.
    derivatives[..., 0] = -z * by_plane[..., 1] + y * by_z
    derivatives[..., 1] = z * by_plane[..., 0] - x * by_z
    derivatives[..., 2] = x * by_plane[..., 1] - y * by_plane[..., 0]
    derivatives[..., 5] = flat / depth[:, :, None] + z * by_z
    derivatives[..., 6] = -z * by_z
    for axis in range(2):
        derivatives[:, :, axis, 3 + axis] = unit_px / depth
        derivatives[:, :, axis, 7 + axis] = unit_px * (1.0 - 1.0 / depth)
    return pixels, derivatives


def fit(
    models: Models,
    pairs: Pairs,
    n_free: int,
    sigma_px: float,
    weights: np.ndarray | None = None,
    robust_px: float = np.inf,
    n_steps: int = 10,
) -> tuple[Models, Float[np.ndarray, "m"]]:
    """Levenberg-Marquardt on all models at once; returns them with their costs.

    The cost is the sum of squared residuals over ``sigma_px`` squared, and of squared
    deviations from what is expected over their standard errors.

    Args:
        models: Where to start.
        pairs: Points, pixels and expectations.
        n_free: How many of the parameters may move: 6, 7 or 9.
        sigma_px: Standard error of a pixel, each axis.
        weights: (m, n) of each pair in each model; None: all one.
        robust_px: Residuals beyond it count less and less (Geman-McClure).
        n_steps: Steps tried.
    """
    if weights is None:
        weights = np.ones((len(models), len(pairs.X)))
    prior = pairs.prior_weights[:n_free]
    damping = np.full(len(models), 1e-3)
    diagonal = np.arange(n_free)

    def at(of: Models) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pixels, J = project_with_derivatives(of, pairs.X, pairs.A, pairs.unit_px)
        offsets = pixels - pairs.pixels
        squared = (offsets**2).sum(axis=2)
        pull = weights / sigma_px**2
        if np.isfinite(robust_px):
            less = 1.0 / (1.0 + squared / robust_px**2)
            squared, pull = squared * less, pull * less**2
        off = pairs.prior_steps(of)[:, :n_free]
        cost = np.sum(weights * squared, axis=1) / sigma_px**2 + off**2 @ prior
        J = J[..., :n_free].reshape(len(of), 2 * len(pairs.X), n_free)
        Jt = (J * np.repeat(pull, 2, axis=1)[:, :, None]).transpose(0, 2, 1)
        normal = Jt @ J
        normal[:, diagonal, diagonal] += prior
        gradient = (Jt @ offsets.reshape(*J.shape[:2], 1))[:, :, 0] + off * prior
        return cost, gradient, normal

    cost, gradient, normal = at(models)
    for _ in range(n_steps):
        damped = normal.copy()
        damped[:, diagonal, diagonal] *= 1.0 + damping[:, None]
        damped[:, diagonal, diagonal] += 1e-9
        steps = -np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
        # Derivatives predict nothing of a step of a radian or a doubling.
        steps /= np.maximum(1.0, np.abs(steps).max(axis=1) / 0.7)[:, None]
        tried = models.moved(steps, pairs.unit_px)
        tried_cost, tried_gradient, tried_normal = at(tried)
        better = tried_cost < cost
        models = tried.where(better, models)
        cost = np.where(better, tried_cost, cost)
        gradient = np.where(better[:, None], tried_gradient, gradient)
        normal = np.where(better[:, None, None], tried_normal, normal)
        damping = np.clip(np.where(better, 0.1 * damping, 10.0 * damping), 1e-9, 1e6)
    return models, cost


def _rows(models: Models, row: int) -> np.ndarray:
    return models.R[:, row, :].T


def _project(
    models: Models, X: np.ndarray, A: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    Y = X @ models.R.transpose(0, 2, 1)
    s = np.exp(models.log_s)[:, None]
    depth = 1.0 + s * np.exp(-models.log_f)[:, None] * Y[:, :, 2]
    depth = np.maximum(depth, _LEAST_DEPTH)
    flat = s[:, :, None] * (Y[:, :, :2] @ A.T)
    numerator = flat + (models.a - models.c)[:, None, :]
    pixels = models.c[:, None, :] + numerator / depth[:, :, None]
    return pixels, Y, flat, numerator, depth
