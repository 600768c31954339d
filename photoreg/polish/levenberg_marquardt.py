"""Levenberg-Marquardt over a sum of robust terms; knows residuals, no cameras.

A term gives its cost at x and the normal equations there: the gradient and the
Gauss-Newton approximation of the second derivative, with robust weights. How they come
about (photos, rims, priors) is up to the term.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float, Int

DENSE_UP_TO = 60
"""Up to so many numbers, those of four cameras, are handled all at once. With more, each
term is handled in its own, and the normal equations are solved as sparse ones."""


def among_all(
    matrix: Float[np.ndarray, "k k"], rows: Int[np.ndarray, "k"], n: int
) -> Float[np.ndarray, "n n"]:
    """A matrix of some of ``n`` numbers as one of all, 0 elsewhere."""
    whole = np.zeros((n, n))
    whole[np.ix_(rows, rows)] = matrix
    return whole


@dataclasses.dataclass(frozen=True, eq=False)
class Quadratic:
    """A cost's local model: cost + gradient . dx + dx . normal . dx / 2."""

    cost: float
    """Value of the cost: half the sum of squared weighted residuals, robustly."""
    gradient: Float[np.ndarray, "p"]
    """First derivative of the cost."""
    normal: Float[np.ndarray, "p p"]
    """Gauss-Newton second derivative: symmetric, not negative."""
    rows: Int[np.ndarray, "p"] | None = None
    """Which numbers among all these are of, on which alone the cost depends; None: all."""

    def whole(self, n: int) -> "Quadratic":
        """The same model in all ``n`` numbers."""
        if self.rows is None:
            return self
        gradient = np.zeros(n)
        gradient[self.rows] = self.gradient
        return Quadratic(self.cost, gradient, among_all(self.normal, self.rows, n))

    def handy(self, n: int) -> "Quadratic":
        """In all ``n`` numbers where these are few, else as it is."""
        return self.whole(n) if n <= DENSE_UP_TO else self

    @property
    def is_finite(self) -> bool:
        """Whether all of it is finite."""
        return bool(
            np.isfinite(self.cost)
            and np.isfinite(self.gradient).all()
            and np.isfinite(self.normal).all()
        )

    def along(
        self, directions: Float[np.ndarray, "p q"] | scipy.sparse.csr_array
    ) -> "Quadratic":
        """The same model for dx = directions . dy, in dy."""
        return Quadratic(
            self.cost,
            directions.T @ self.gradient,
            directions.T @ self.normal @ directions,
        )


@runtime_checkable
class Term(Protocol):
    """One part of the cost."""

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and its local model at ``x``."""
        ...


class ScatteringTerm(Term, Protocol):
    """A term that knows how uncertain its gradient is."""

    @property
    def rows(self) -> Int[np.ndarray, "k"]:
        """Its own numbers among those of all cameras."""
        ...

    def scatter(self, x: Float[np.ndarray, "p"]) -> Float[np.ndarray, "k k"]:
        """Covariance of the gradient at ``x`` in its own numbers."""
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
    """The local model of the sum of ``terms``, in all numbers."""
    cost, gradient, normal = 0.0, np.zeros(len(x)), np.zeros((len(x), len(x)))
    for term in terms:
        part = term.linearise(x)
        cost += part.cost
        rows = np.arange(len(x)) if part.rows is None else part.rows
        gradient[rows] += part.gradient
        normal[np.ix_(rows, rows)] += part.normal
    return Quadratic(cost, gradient, normal)


def solve_normal(
    normal: Float[np.ndarray, "p p"], right: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """The solution of the normal equations; sparse by camera where there are many."""
    if len(right) <= DENSE_UP_TO:
        return np.linalg.solve(normal, right)
    return scipy.sparse.linalg.splu(scipy.sparse.csc_array(normal)).solve(right)


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
    moves = directions
    if len(x) > DENSE_UP_TO:
        moves = scipy.sparse.csr_array(directions)
    model = total(terms, x)
    yield Iterate(0, x, model)
    share, growth = damping.initial, 2.0
    for iteration in range(1, damping.max_iterations + 1):
        inner = model.along(moves)
        diagonal = np.diag(inner.normal)
        # A parameter without effect has a zero diagonal: keep the matrix regular.
        floor = max(float(diagonal.max()), 1e-300) * 1e-12
        step = -solve_normal(
            inner.normal + np.diag(share * diagonal + floor), inner.gradient
        )
        predicted = -float(inner.gradient @ step + 0.5 * step @ inner.normal @ step)
        if not predicted > 0.0:
            return
        # With its derivatives at once: three steps of four are accepted.
        candidate = x + moves @ step
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
    model: Quadratic,
    x: Float[np.ndarray, "p"],
    limits: Float[np.ndarray, "k"],
    rows: slice | Int[np.ndarray, "k"] = slice(None),
) -> Float[np.ndarray, "p"]:
    """Where one term alone would go from ``x``, held by one unit of every parameter.

    The term's own numbers, ``rows``, do not go beyond their limits on either side of 0,
    if they were not there before.

    A term's noise is measured there: where terms pull against each other, the pull
    would otherwise be taken for noise, and the term that gives way would do so for ever.
    """
    model, end = model.handy(len(x)), x.copy()
    step = -np.linalg.solve(model.normal + np.eye(len(model.gradient)), model.gradient)
    end[slice(None) if model.rows is None else model.rows] += step
    most = np.full(len(x), np.inf)
    most[rows] = limits
    most = np.maximum(most, np.abs(x))
    return np.clip(end, -most, most)


def total_scatter(
    terms: "Sequence[ScatteringTerm]", x: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p p"]:
    """Covariance of the gradient of the sum of ``terms``, each apart from the others."""
    whole = np.zeros((len(x), len(x)))
    for term in terms:
        rows = term.rows
        whole[np.ix_(rows, rows)] += term.scatter(x)
    return whole


MIN_GROUPS = 20
"""Fewer groups than this say too little about their spread."""


def overdispersion(
    scores: Float[np.ndarray, "cells p"],
    normal: Float[np.ndarray, "p p"],
    groupings: Sequence[Int[np.ndarray, "cells"]],
) -> float:
    """How much less the data determines than its normal matrix says, at least 1.

    Were all residuals independent, the gradient's spread over groups of residuals would
    add up to the normal matrix. Errors that neighbours share (of the mesh, of the
    light) make it larger; dividing the term's weight by the ratio restores the balance.

    The weight expresses how much a term knows, so it takes the share of the precision that
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
    """Covariance of the term's gradient, by its spread over groups of residuals.

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

    Each with its ratio to the normal matrix along each direction that this determines.
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
