"""Terms trusted as far as their scatter allows."""

import numpy as np
import pytest

from photoreg.polish import levenberg_marquardt
from photoreg.polish.levenberg_marquardt import (
    Damping,
    Prior,
    Quadratic,
    among_all,
    minimise,
)
from photoreg.polish.sandwich_term import SandwichTerm


class Line:
    """Half the squared distance from ``mean`` along each direction, by ``normal``."""

    def __init__(self, mean, normal):
        self.mean, self.normal = np.array(mean), np.array(normal)

    def linearise(self, x):
        gradient = self.normal @ (x - self.mean)
        return Quadratic(float(0.5 * (x - self.mean) @ gradient), gradient, self.normal)


class Placed(Line):
    """The same of two numbers among more."""

    def __init__(self, mean, normal, rows):
        super().__init__(mean, normal)
        self.rows = np.array(rows)

    def linearise(self, x):
        model = super().linearise(x[self.rows])
        return Quadratic(model.cost, model.gradient, model.normal, self.rows)


def test_a_term_of_few_numbers_is_doubted_as_among_all(monkeypatch):
    normal = np.array([[400.0, 30.0], [30.0, 90.0]])
    line = Placed([0.3, -0.2], normal, [3, 7])
    spread = np.array([[900.0, 10.0], [10.0, 95.0]])
    rng = np.random.default_rng(0)
    x, root = rng.normal(size=9), rng.normal(size=(9, 9))
    covariance = 1e-3 * root @ root.T
    dense = SandwichTerm.measured(
        line, among_all(normal, line.rows, 9), among_all(spread, line.rows, 9)
    ).doubted(x, covariance)
    whole = dense.linearise(x)
    monkeypatch.setattr(levenberg_marquardt, "DENSE_UP_TO", 4)
    own = SandwichTerm.measured(line, normal, spread).doubted(x, covariance)
    assert own.factor == pytest.approx(dense.factor)
    assert own.factor > 1.5
    assert own.surprise == pytest.approx(dense.surprise)
    model = own.linearise(x)
    assert len(model.gradient) == 2
    assert model.cost == pytest.approx(whole.cost)
    np.testing.assert_allclose(model.whole(9).normal, whole.normal, atol=1e-9)
    np.testing.assert_allclose(model.whole(9).gradient, whole.gradient, atol=1e-9)


def lowest(terms, n=2):
    *_, last = minimise(terms, np.zeros(n), Damping(max_iterations=50))
    return last.x


def test_where_the_scatter_is_the_normal_matrix_nothing_changes():
    normal = np.array([[4.0, 1.0], [1.0, 2.0]])
    line = Line([0.3, -0.2], normal)
    weighed = SandwichTerm.measured(line, normal, normal)
    x = np.array([0.7, 0.1])
    there, model = weighed.linearise(x), line.linearise(x)
    assert np.allclose(there.gradient, model.gradient)
    assert np.allclose(there.normal, model.normal)
    assert there.cost == pytest.approx(model.cost)


def test_a_direction_that_scatters_counts_as_little_as_it_scatters():
    # Both directions look alike in the normal matrix; the second scatters 100 times.
    normal = 100.0 * np.eye(2)
    wrong = SandwichTerm.measured(
        Line([1.0, 1.0], normal), normal, np.diag([100.0, 10_000.0])
    )
    right = Line([0.0, 0.0], 100.0 * np.eye(2))
    x = lowest([wrong, right])
    assert x[0] == pytest.approx(0.5, abs=1e-3)
    assert x[1] == pytest.approx(1.0 / 101.0, abs=1e-3)


def test_the_scatter_is_never_below_the_normal_matrix():
    normal = np.diag([5.0, 3.0])
    weighed = SandwichTerm.measured(Line([0.0, 0.0], normal), normal, 1e-3 * normal)
    assert np.allclose(weighed.inverse_scatter, np.linalg.inv(normal))


def test_what_a_term_does_not_know_stays_unknown():
    normal = np.diag([5.0, 0.0])
    weighed = SandwichTerm.measured(
        Line([1.0, 7.0], normal), normal, np.diag([5.0, 0.0])
    )
    x = lowest([Prior(np.zeros(2), np.eye(2)), weighed])
    assert x[1] == 0.0
    assert x[0] == pytest.approx(5.0 / 6.0, abs=1e-3)


def test_a_term_that_disagrees_beyond_its_noise_counts_less():
    normal = 100.0 * np.eye(3)
    fat = SandwichTerm.measured(Line([1.0, 0.0, 0.0], normal), normal, normal)
    sure = 1e-4 * np.eye(3)
    doubted = fat.doubted(np.zeros(3), sure)
    # Of three numbers one is 10 sigma off: 100 / (f + 0.01) = 3.
    assert doubted.factor == pytest.approx(100.0 / 3.0 - 0.01, rel=1e-3)
    assert doubted.surprise < 1e-10
    assert np.allclose(doubted.inverse_scatter, fat.inverse_scatter / doubted.factor)


def test_a_term_that_agrees_within_its_noise_or_the_others_is_not_doubted():
    normal = 100.0 * np.eye(3)
    near = SandwichTerm.measured(Line([0.05, 0.1, 0.0], normal), normal, normal)
    assert near.doubted(np.zeros(3), 1e-4 * np.eye(3)).factor == 1.0
    far = SandwichTerm.measured(Line([1.0, 0.0, 0.0], normal), normal, normal)
    open_direction = np.diag([100.0, 1e-4, 1e-4])
    doubted = far.doubted(np.zeros(3), open_direction)
    assert doubted.factor == 1.0
    assert doubted.surprise > 0.1


def test_disagreement_of_the_size_of_the_noise_is_found_so_on_average():
    rng = np.random.default_rng(0)
    normal = np.diag([50.0, 20.0, 80.0, 10.0])
    covariance = np.diag([0.02, 0.01, 0.005, 0.05])
    true_factor = 6.0
    factors = []
    for _ in range(300):
        mean = rng.normal(size=4) * np.sqrt(
            true_factor / np.diag(normal) + np.diag(covariance)
        )
        weighed = SandwichTerm.measured(Line(mean, normal), normal, normal)
        factors.append(weighed.doubted(np.zeros(4), covariance).factor)
    assert 0.7 * true_factor < np.mean(factors) < 1.3 * true_factor, np.mean(factors)
