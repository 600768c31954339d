"""Levenberg-Marquardt over abstract terms."""

import numpy as np
import pytest

from photoreg.polish import levenberg_marquardt
from photoreg.polish.levenberg_marquardt import (
    Damping,
    Prior,
    Quadratic,
    minimise,
    overdispersion,
    own_end,
    scatter,
    solve_normal,
    total,
    total_scatter,
)


class Rosenbrock:
    """Half of (1 - x)^2 + 100 (y - x^2)^2: a curved valley with its bottom at (1, 1)."""

    def _residuals(self, x):
        return np.array([1.0 - x[0], 10.0 * (x[1] - x[0] ** 2)])

    def linearise(self, x):
        J = np.array([[-1.0, 0.0], [-20.0 * x[0], 10.0]])
        r = self._residuals(x)
        return Quadratic(0.5 * float(r @ r), J.T @ r, J.T @ J)


def test_minimise_follows_a_curved_valley_to_its_bottom():
    steps = list(
        minimise([Rosenbrock()], np.array([-1.2, 1.0]), Damping(200, 1e-9, 0.0))
    )
    assert np.abs(steps[-1].x - 1.0).max() < 1e-6, steps[-1].x


def test_the_cost_never_rises():
    steps = list(minimise([Rosenbrock()], np.array([-1.2, 1.0]), Damping(60)))
    costs = np.array([step.model.cost for step in steps])
    assert (np.diff(costs) < 0.0).all(), costs


def test_a_parameter_that_nothing_sees_stays():
    prior = Prior(np.array([2.0, 0.0]), np.diag([1.0, 0.0]))
    last = list(minimise([prior], np.array([5.0, 7.0]), Damping()))[-1]
    assert abs(last.x[0] - 2.0) < 1e-5, last.x
    assert last.x[1] == 7.0


def test_two_priors_meet_at_their_weighted_mean():
    terms = [Prior(np.array([0.0]), np.eye(1)), Prior(np.array([4.0]), 3.0 * np.eye(1))]
    last = list(minimise(terms, np.array([9.0]), Damping()))[-1]
    assert abs(last.x[0] - 3.0) < 1e-6, last.x


def test_scatter_makes_up_for_the_numbers_fitted_to_the_same_residuals():
    rng = np.random.default_rng(1)
    spreads = []
    for _ in range(200):
        J, r = rng.normal(size=(40, 12)), rng.normal(size=40)
        r -= J @ np.linalg.solve(J.T @ J, J.T @ r)
        # Known so well that the unit that holds own_step counts for nothing.
        scores, normal = 1e3 * J * r[:, None], 1e6 * J.T @ J
        spread = scatter(scores, normal, [np.arange(40)])
        spreads.append(np.trace(np.linalg.solve(normal, spread)) / 12)
    # At least 1 each, so the mean lies above it; without the correction it is 1.004.
    assert 1.05 < np.mean(spreads) < 1.3, np.mean(spreads)


def test_scatter_is_large_along_the_direction_whose_residuals_are_repeated():
    rng = np.random.default_rng(2)
    n, times = 2000, 9
    J = np.zeros((times * n, 2))
    J[: times * n // 2, 0] = rng.normal(size=times * n // 2)
    # The second direction's rows come nine times over, with one residual each.
    J[times * n // 2 :, 1] = np.repeat(rng.normal(size=n // 2), times)
    r = rng.normal(size=times * n)
    r[times * n // 2 :] = np.repeat(rng.normal(size=n // 2), times)
    scores, normal = J * r[:, None], J.T @ J
    spread = scatter(scores, normal, [np.arange(times * n) // times])
    ratio = np.diag(spread) / np.diag(normal)
    assert abs(ratio[0] - 1.0) < 0.2, ratio
    assert abs(ratio[1] - times) < 1.5, ratio


def test_overdispersion_is_one_for_independent_and_m_for_repeated_residuals():
    rng = np.random.default_rng(0)
    J, r = rng.normal(size=(3000, 4)), rng.normal(size=(3000, 1))
    groups = [np.arange(3000)]
    alone = overdispersion(J * r, J.T @ J, groups)
    assert abs(alone - 1.0) < 0.1, alone
    # Each residual four times over: the normal matrix counts all, the groups one.
    repeated = overdispersion(
        np.repeat(J * r, 4, axis=0), 4.0 * J.T @ J, [np.arange(12000) // 4]
    )
    assert abs(repeated - 4.0) < 0.4, repeated


def test_overdispersion_is_what_most_of_the_precision_suffers():
    rng = np.random.default_rng(1)
    column = np.arange(4000) % 4
    J = np.eye(4)[column] * rng.normal(size=(4000, 1))
    # One direction of four has residuals a thousand times as large in square.
    r = np.where(column == 3, np.sqrt(1000.0), 1.0) * rng.normal(size=4000)
    ratio = overdispersion(J * r[:, None], J.T @ J, [np.arange(4000)])
    assert abs(ratio - 4.0 / 3.0) < 0.1, ratio


class Cliff:
    """The square root of x, whose bottom lies where it cannot be reckoned."""

    def linearise(self, x):
        root = np.sqrt(x[0]) if x[0] > 0.0 else np.nan
        return Quadratic(float(root), np.array([0.5 / root]), np.array([[0.1 / root]]))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_step_to_where_nothing_can_be_reckoned_is_refused():
    steps = list(minimise([Cliff()], np.array([4.0]), Damping(30)))
    assert all(step.model.is_finite for step in steps)
    assert 0.0 < steps[-1].x[0] < 4.0


def test_no_step_goes_beyond_its_limit():
    prior = Prior(np.array([9.0, 1.0]), np.eye(2))
    limits = np.array([2.0, 2.0])
    *_, last = minimise([prior], np.zeros(2), Damping(30), None, limits)
    assert 0.5 < last.x[0] <= 2.0
    # What began beyond may come back, but goes no farther.
    *_, last = minimise([prior], np.array([20.0, 1.0]), Damping(30), None, limits)
    assert last.x == pytest.approx([9.0, 1.0], abs=1e-4)


def test_where_a_term_would_go_alone_is_within_the_limits():
    model = Quadratic(1.0, np.array([-1e9, -0.5]), np.diag([1e-9, 0.0]))
    end = own_end(model, np.array([0.25, 0.0]), np.array([3.0, 3.0]))
    assert end == pytest.approx([3.0, 0.5])


class Between:
    """Ten residuals of two cameras of nine numbers each, among those of many."""

    def __init__(self, i, k, seed):
        rng = np.random.default_rng(seed)
        self.rows = np.concatenate([np.arange(9 * one, 9 * one + 9) for one in (i, k)])
        self.J, self.r = rng.normal(size=(10, 18)), rng.normal(size=10)

    def linearise(self, x):
        r = self.r + self.J @ x[self.rows]
        return Quadratic(0.5 * float(r @ r), self.J.T @ r, self.J.T @ self.J, self.rows)

    def scatter(self, x):
        del x
        return self.J.T @ self.J

    def whole(self, n):
        """The same rows as a dense term's."""
        J = np.zeros((len(self.r), n))
        J[:, self.rows] = self.J
        return J


def ring_of_terms(n_cameras=9):
    return [
        Between(i, (i + step) % n_cameras, 10 * i + step)
        for i in range(n_cameras)
        for step in (1, 2)
    ]


def test_the_sum_of_terms_of_few_numbers_each_is_that_of_all_residuals():
    terms, n = ring_of_terms(), 81
    x = np.random.default_rng(0).normal(size=n)
    J = np.concatenate([term.whole(n) for term in terms])
    r = J @ x + np.concatenate([term.r for term in terms])
    model = total(terms, x)
    assert model.cost == pytest.approx(0.5 * float(r @ r))
    np.testing.assert_allclose(model.gradient, J.T @ r, atol=1e-9)
    np.testing.assert_allclose(model.normal, J.T @ J, atol=1e-9)
    np.testing.assert_allclose(total_scatter(terms, x), J.T @ J, atol=1e-9)


def test_sparse_normal_equations_have_the_solution_of_dense_ones(monkeypatch):
    terms, n = ring_of_terms(), 81
    normal = total(terms, np.zeros(n)).normal + 0.1 * np.eye(n)
    right = np.random.default_rng(1).normal(size=n)
    dense = np.linalg.solve(normal, right)
    np.testing.assert_allclose(solve_normal(normal, right), dense, rtol=1e-9)
    prior = Prior(np.zeros(n), 0.1 * np.eye(n))
    # Of the last 20 numbers each two move together.
    directions = np.eye(n)[:, :71]
    directions[71:, 61:] = np.eye(10)
    ends = []
    for most in (60, 100):
        monkeypatch.setattr(levenberg_marquardt, "DENSE_UP_TO", most)
        found = minimise([prior, *terms], np.ones(n), Damping(), directions)
        *_, last = found
        ends.append(last.x)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    assert np.abs(ends[0]).max() > 0.1


def test_where_a_term_would_go_alone_does_not_know_the_other_cameras(monkeypatch):
    term, n = ring_of_terms()[3], 81
    x = np.random.default_rng(2).normal(size=n)
    ends = []
    for most in (60, 100):
        monkeypatch.setattr(levenberg_marquardt, "DENSE_UP_TO", most)
        ends.append(own_end(term.linearise(x), x, np.full(18, 3.0), term.rows))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)
    others = np.setdiff1d(np.arange(n), term.rows)
    assert np.array_equal(ends[0][others], x[others])
    assert np.abs(ends[0] - x)[term.rows].max() > 0.01
