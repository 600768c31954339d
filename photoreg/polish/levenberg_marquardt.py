"""Levenberg-Marquardt over a sum of robust terms; knows residuals, no cameras.

A term gives its cost at x and the normal equations there: the gradient and the
Gauss-Newton approximation of the second derivative, with robust weights. How they come
about (photos, rims, priors) is the term's own affair.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int


@dataclasses.dataclass(frozen=True, eq=False)
class Quadratic:
    """A cost's local model: cost + gradient . dx + dx . normal . dx / 2."""

    cost: float
    """Value of the cost: half the sum of squared weighted residuals, robustly."""
    gradient: Float[np.ndarray, "p"]
    """First derivative of the cost."""
    normal: Float[np.ndarray, "p p"]
    """Gauss-Newton second derivative: symmetric, not negative."""

    @property
    def is_finite(self) -> bool:
        """Whether all of it can be reckoned with."""
        return bool(
            np.isfinite(self.cost)
            and np.isfinite(self.gradient).all()
            and np.isfinite(self.normal).all()
        )

    def along(self, directions: Float[np.ndarray, "p q"]) -> "Quadratic":
        """The same model for dx = directions . dy, in dy."""
        return Quadratic(
            self.cost,
            directions.T @ self.gradient,
            directions.T @ self.normal @ directions,
        )


class Term(Protocol):
    """One part of the cost."""

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and its local model at ``x``."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Prior:
    """Half the squared distance from ``mean``, each direction in its own sigma."""

    mean: Float[np.ndarray, "p"]
    precision: Float[np.ndarray, "p p"]
    """Inverse covariance."""

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and its (exact) local model at ``x``."""
        d = x - self.mean
        gradient = self.precision @ d
        return Quadratic(float(0.5 * d @ gradient), gradient, self.precision)


@dataclasses.dataclass(frozen=True)
class Damping:
    """When the minimisation steps, and when it ends."""

    max_iterations: int = 20
    """Accepted or refused steps, at most."""
    step_tolerance: float = 1e-3
    """End when the longest component of an accepted step is below this, in units of
    the parameters."""
    cost_tolerance: float = 1e-6
    """End when an accepted step lowers the cost by less than this share of it."""
    initial: float = 1e-6
    """First damping, as a share of the normal matrix's diagonal."""


@dataclasses.dataclass(frozen=True, eq=False)
class Iterate:
    """One accepted step; the first is the start."""

    iteration: int
    x: Float[np.ndarray, "p"]
    model: Quadratic
    """The whole cost's local model at ``x``."""


def total(terms: Sequence[Term], x: Float[np.ndarray, "p"]) -> Quadratic:
    """The local model of the sum of ``terms``."""
    parts = [term.linearise(x) for term in terms]
    return Quadratic(
        sum(part.cost for part in parts),
        np.sum([part.gradient for part in parts], axis=0),
        np.sum([part.normal for part in parts], axis=0),
    )


def minimise(
    terms: Sequence[Term],
    x: Float[np.ndarray, "p"],
    damping: Damping,
    directions: Float[np.ndarray, "p q"] | None = None,
    limits: Float[np.ndarray, "p"] | None = None,
) -> Iterator[Iterate]:
    """Damped Gauss-Newton from ``x``; yields the start and every accepted step.

    The cost of what is yielded never rises. The damping follows the ratio of actual
    to predicted gain. With ``directions``, x moves along their columns only. With
    ``limits``, a step that takes a number beyond its limit on either side of 0, and not
    nearer than it was, is refused like one that raises the cost.

    References:
        H. B. Nielsen, "Damping Parameter in Marquardt's Method", 1999.
    """
    x = np.array(x, dtype=np.float64)
    if directions is None:
        directions = np.eye(len(x))
    limits = np.full(len(x), np.inf) if limits is None else np.maximum(limits, abs(x))
    model = total(terms, x)
    yield Iterate(0, x, model)
    share, growth = damping.initial, 2.0
    for iteration in range(1, damping.max_iterations + 1):
        inner = model.along(directions)
        diagonal = np.diag(inner.normal)
        # A parameter that nothing sees has a zero diagonal: keep the matrix regular.
        floor = max(float(diagonal.max()), 1e-300) * 1e-12
        step = -np.linalg.solve(
            inner.normal + np.diag(share * diagonal + floor), inner.gradient
        )
        predicted = -float(inner.gradient @ step + 0.5 * step @ inner.normal @ step)
        if not predicted > 0.0:
            return
        # With its derivatives at once: three steps of four are accepted.
        candidate = x + directions @ step
        there, gained = model, -np.inf
        if (np.abs(candidate) <= limits).all():
            there = total(terms, candidate)
            gained = model.cost - there.cost
        if not (gained > 0.0 and there.is_finite):
            share, growth = share * growth, growth * 2.0
            if np.abs(step).max() < damping.step_tolerance:
                return
            continue
        ratio = gained / predicted
        share *= max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        share, growth = max(share, 1e-7), 2.0
        x = candidate
        before, model = model.cost, there
        yield Iterate(iteration, x, model)
        if np.abs(
            step
        ).max() < damping.step_tolerance or gained < damping.cost_tolerance * abs(
            before
        ):
            return


def own_end(
    model: Quadratic, x: Float[np.ndarray, "p"], limits: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """Where one term alone would go from ``x``, held by one unit of every parameter.

    No number goes beyond its limit on either side of 0, if it was not there before.

    A term's noise is measured there: where terms pull against each other, the pull
    would else pass for noise, and the term that gives way would give way for ever.
    """
    step = -np.linalg.solve(model.normal + np.eye(len(x)), model.gradient)
    limits = np.maximum(limits, np.abs(x))
    return np.clip(x + step, -limits, limits)


MIN_GROUPS = 20
"""Fewer groups than this say too little about their own spread."""


def overdispersion(
    scores: Float[np.ndarray, "cells p"],
    normal: Float[np.ndarray, "p p"],
    groupings: Sequence[Int[np.ndarray, "cells"]],
) -> float:
    """How much less the data knows than its normal matrix says, at least 1.

    Were all residuals independent, the gradient's spread over groups of residuals would
    add up to the normal matrix. Errors that neighbours share (of the mesh, of the
    light) make it larger; dividing the term's weight by the ratio restores the balance.

    The weight stands for what a term knows, so it takes the share of the precision that
    holds, averaged over directions: the harmonic mean of their ratios. The plain mean is
    that of the worst directions, a thousand times as noisy where both cameras slide
    together; weighted by it, colours that were right to 0.2 px gave way to an outline.

    Args:
        scores: The gradient's part of each cell, at ``own_end``.
        normal: The term's normal matrix.
        groupings: Group of each cell; the grouping with the largest ratio counts.
    """
    ratios = [
        1.0 / float(np.mean(1.0 / np.maximum(spread, 1e-9)))
        for _, spread in _scatters(scores, normal, groupings, lost=0.0)
    ]
    return max([1.0, *ratios])


def scatter(
    scores: Float[np.ndarray, "cells p"],
    normal: Float[np.ndarray, "p p"],
    groupings: Sequence[Int[np.ndarray, "cells"]],
) -> Float[np.ndarray, "p p"]:
    """Covariance of the term's gradient, as its spread over groups of residuals tells.

    The arguments are those of ``overdispersion``; the spread is that of each direction,
    and never below the normal matrix on the whole. One factor for all directions would
    not do: of 13 made scenes three ended 1.5 to 1.8 times as far off as expected then,
    and like this none more than 1.4 times.

    References:
        The sandwich estimator over clusters: K.-Y. Liang and S. Zeger, "Longitudinal
        data analysis using generalized linear models", 1986, doi:10.1093/biomet/73.1.13.
    """
    # The step before fitted so many numbers to the same scores, held by one unit.
    values = np.maximum(np.linalg.eigvalsh(normal), 0.0)
    lost = float((values / (values + 1.0)).sum())
    largest, ratio = normal, 1.0
    for covariance, spread in _scatters(scores, normal, groupings, lost):
        if float(np.mean(spread)) > ratio:
            largest, ratio = covariance, float(np.mean(spread))
    return largest


def _scatters(
    scores: np.ndarray,
    normal: np.ndarray,
    groupings: Sequence[np.ndarray],
    lost: float,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The scores' covariance over each grouping that has enough groups.

    With it goes its ratio to the normal matrix along each direction that this knows.
    """
    values, vectors = np.linalg.eigh(normal)
    known = values > 1e-9 * values.max(initial=1e-300)
    for grouping in groupings:
        _, index = np.unique(grouping, return_inverse=True)
        n = int(index.max(initial=-1)) + 1
        if not known.any() or n < max(MIN_GROUPS, 1.5 * lost):
            continue
        sums = np.zeros((n, scores.shape[1]))
        np.add.at(sums, index, scores)
        sums -= sums.mean(axis=0)
        along = sums @ vectors[:, known]
        scale = n / (n - lost)
        yield sums.T @ sums * scale, (along**2).sum(axis=0) / values[known] * scale
