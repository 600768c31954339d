"""The genetic algorithm on functions with a known minimum."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.search import genetic
from photoreg.search.genetic import GeneticConfig, evolve, roulette_shares

TARGET = np.array([0.3, -0.7, 0.1, 0.5, -0.2])
SMALL = GeneticConfig(population=60, generations=40, restarts=2)


def bowl(genes):
    return np.sum((genes - TARGET) ** 2, axis=1)


def uniform(n, rng):
    return rng.uniform(-1.0, 1.0, (n, len(TARGET)))


def run(config=SMALL, seed=0, costs=bowl, start=None):
    return list(evolve(costs, uniform, config, seed, start))


@pytest.mark.parametrize("replacement", ["steady_state", "generational"])
@pytest.mark.parametrize("selection", ["wheel_tournament", "tournament", "roulette"])
@pytest.mark.parametrize("crossover", ["uniform", "single_point"])
def test_every_variant_finds_the_bottom_of_a_bowl(replacement, selection, crossover):
    config = dataclasses.replace(
        SMALL,
        replacement=replacement,
        selection=selection,
        crossover=crossover,
        mutation_sigma_end=0.02,
    )
    last = run(config)[-1]
    # The best of 60 random individuals costs 0.3 to 0.6.
    assert last.best_cost < 0.05, last.best_cost
    assert bowl(last.best_genes[None])[0] == last.best_cost


def test_the_search_is_a_function_of_its_seed():
    first, same, other = run(seed=1)[-1], run(seed=1)[-1], run(seed=2)[-1]
    np.testing.assert_array_equal(first.best_genes, same.best_genes)
    assert not np.array_equal(first.best_genes, other.best_genes)


@pytest.mark.parametrize("replacement", ["steady_state", "generational"])
def test_the_best_never_gets_worse(replacement):
    config = dataclasses.replace(SMALL, replacement=replacement)
    costs = [generation.best_cost for generation in run(config)]
    assert (np.diff(costs) <= 0.0).all()


def test_restarts_keep_only_the_best():
    events = run()
    first = [event for event in events if event.restart == 0][-1]
    again = next(event for event in events if event.restart == 1)
    assert again.generation == 0
    assert again.best_cost == first.best_cost
    # A new population: its median is that of random individuals again.
    assert again.median_cost > 20 * first.median_cost, again.median_cost


def test_the_paper_preset_counts_65_000_evaluations():
    assert run(GeneticConfig())[-1].evaluations == 5 * (500 + 100 * 125)


@pytest.mark.parametrize(("rate", "most"), [(0.2, 1), (0.3, 2), (1.0, 5)])
def test_a_fixed_number_of_genes_mutates(rate, most):
    config = dataclasses.replace(
        SMALL, generations=1, restarts=1, mutation_rate=rate, replacement="generational"
    )
    seen = []

    def costs(genes):
        seen.append(genes.copy())
        return bowl(genes)

    list(evolve(costs, lambda n, rng: np.tile(0.5 * TARGET, (n, 1)), config, 0))
    changed = (seen[1] != 0.5 * TARGET).sum(axis=1)
    # Drawn with replacement: rate times genes, rounded up, at most; at least one.
    assert changed.max() == most, changed
    assert changed.min() >= 1, changed


def test_the_wheels_tournament_presses_harder_than_the_wheel():
    cost = np.linspace(1.0, 2.0, 50)
    means = {}
    for selection in ("roulette", "tournament", "wheel_tournament"):
        config = dataclasses.replace(SMALL, selection=selection)
        chosen = genetic._select(cost, 20_000, config, np.random.default_rng(0))
        means[selection] = cost[chosen].mean()
    # The better of two of 50 even steps lies at a third; the wheel alone near a half.
    assert np.isclose(means["tournament"], 4.0 / 3.0, atol=0.01), means
    assert means["wheel_tournament"] < means["tournament"] < means["roulette"], means


def test_nan_never_wins():
    def costs(genes):
        return np.where(genes[:, 0] > 0.0, np.nan, bowl(genes))

    last = run(costs=costs)[-1]
    assert np.isfinite(last.best_cost)
    assert last.best_genes[0] <= 0.0


def test_all_infinite_costs_end_in_the_start():
    start = np.full(len(TARGET), 0.25)
    last = run(costs=lambda genes: np.full(len(genes), np.nan), start=start)[-1]
    np.testing.assert_array_equal(last.best_genes, start)
    assert last.best_cost == np.inf


def test_the_start_is_never_lost():
    last = run(start=TARGET, costs=lambda g: bowl(g) - 1.0)[0]
    assert last.best_cost == -1.0
    np.testing.assert_array_equal(last.best_genes, TARGET)


def test_genes_stay_in_the_box():
    seen = []

    def costs(genes):
        seen.append(np.abs(genes).max())
        return bowl(genes)

    run(
        dataclasses.replace(SMALL, mutation_sigma=2.0, mutation_sigma_end=2.0),
        costs=costs,
    )
    assert max(seen) <= 1.0


def test_the_search_ends_at_the_cost_level():
    last = run(dataclasses.replace(SMALL, stop_cost=0.2))[-1]
    assert last.stop == "cost level"
    assert last.best_cost <= 0.2
    assert last.evaluations < run()[-1].evaluations


def test_a_restart_ends_when_nothing_improves():
    config = dataclasses.replace(SMALL, stagnation=5)
    events = run(config, costs=lambda genes: np.ones(len(genes)))
    assert [event.stop for event in events if event.stop] == ["stagnation"] * 2
    assert max(event.generation for event in events) == 5


def test_a_cost_that_changes_between_restarts_is_valued_anew():
    state = {"worse": 0.0}

    def costs(genes):
        return bowl(genes) + state["worse"]

    best = []
    for event in evolve(costs, uniform, SMALL, 0):
        best.append(event.best_cost)
        if event.stop is not None:
            state["worse"] = 10.0
    assert best[-1] >= 10.0


def test_roulette_gives_the_best_its_scaled_share():
    cost = np.array([3.0, 1.0, 2.0, np.inf, 2.5])
    shares = roulette_shares(cost)
    assert shares.sum() == pytest.approx(1.0)
    assert shares[3] == 0.0
    assert shares[1] / shares[[0, 1, 2, 4]].mean() == pytest.approx(1.2)
    assert (np.diff(shares[[1, 2, 4, 0]]) < 0).all()


@pytest.mark.parametrize("cost", [[2.0, 2.0], [np.inf, np.inf]])
def test_roulette_is_fair_between_equals(cost):
    np.testing.assert_allclose(roulette_shares(np.array(cost)), 0.5)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("population", 3),
        ("generations", 0),
        ("restarts", 0),
        ("mutation_rate", 1.5),
        ("crossover_rate", -0.1),
        ("replaced_share", 0.0),
        ("mutation_sigma", np.nan),
        ("stop_cost", -1.0),
    ],
)
def test_an_impossible_setting_is_refused_by_name(name, value):
    with pytest.raises(InputError, match=f"^{name} is {value}; give"):
        dataclasses.replace(SMALL, **{name: value})
