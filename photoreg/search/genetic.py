"""A genetic algorithm over the box [-1, 1]^g. Knows arrays and bounds, no cameras.

Where the paper is silent the defaults are those of GAlib 2.4, the library it used:
crossover probability 0.9, a quarter of the population replaced each generation in the
steady-state algorithm, linear scaling of the fitness for the roulette wheel, a
tournament between two that the wheel drew, and a fixed number of mutations a child.
GAlib mutates by a Gaussian of deviation 1 in each gene's own unit, which the paper does
not tell; so the deviation here is ours.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError

Replacement = Literal["steady_state", "generational"]
Selection = Literal["wheel_tournament", "tournament", "roulette"]
Crossover = Literal["uniform", "single_point"]
Mutations = Literal["fixed_number", "each_gene"]
StopReason = Literal["generations", "cost level", "stagnation"]

ROULETTE_BEST_OVER_MEAN = 1.2
"""GAlib's linear scaling: the best is drawn this many times as often as the mean."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class GeneticConfig:
    """Settings of the genetic algorithm."""

    population: int = 500
    """Individuals kept alive, 4 to a million. More finds the basin more often, at
    linear cost."""
    generations: int = 100
    """Generations of each restart, at least 1."""
    restarts: int = 5
    """How often a new population is drawn, at least 1; only the best individual is
    kept from one to the next."""
    replacement: Replacement = "steady_state"
    """steady_state: children compete with their parents' generation. generational:
    children replace it, and the best survives."""
    replaced_share: float = 0.25
    """Share of the population bred each generation in steady_state, in (0, 1]."""
    selection: Selection = "wheel_tournament"
    """How parents are chosen. roulette: by a wheel whose slots grow with fitness.
    tournament: the best of a random few. wheel_tournament: the best of a few that the
    wheel drew, as GAlib has it."""
    tournament_size: int = 2
    """How many meet in a tournament, at least 1."""
    crossover: Crossover = "uniform"
    """Which genes children swap: each with probability 1/2, or all after one point."""
    crossover_rate: float = 0.9
    """Probability that two parents cross rather than are copied, in [0, 1]."""
    mutation_rate: float = 0.1
    """Probability that a gene of a child is mutated, in [0, 1]."""
    mutations: Mutations = "fixed_number"
    """each_gene: each gene is mutated or not by itself. fixed_number: rate times genes,
    rounded up, genes drawn at random, as GAlib does it; each_gene where that is below 1.
    """
    mutation_sigma: float = 0.2
    """Standard deviation of a mutation at first, as a share of the gene's half
    interval, above 0."""
    mutation_sigma_end: float = 0.2
    """The same in the last generation of a restart, above 0; in between it shrinks
    geometrically."""
    stop_cost: float = 0.0
    """The search ends once the best cost is at or below this; 0: never."""
    stagnation: int = 0
    """A restart ends after this many generations without a better best; 0: never."""

    def __post_init__(self) -> None:
        ranges = {
            "population": (4, 1_000_000),
            "generations": (1, 1_000_000),
            "restarts": (1, 1_000_000),
            "tournament_size": (1, 1_000_000),
            "stagnation": (0, 1_000_000),
        }
        for name, (least, most) in ranges.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise InputError(f"{name} is {value:g}; give {least} to {most:,}.")
        for name in ("crossover_rate", "mutation_rate"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise InputError(f"{name} is {value}; give a probability in [0, 1].")
        if not 0.0 < self.replaced_share <= 1.0:
            raise InputError(
                f"replaced_share is {self.replaced_share}; give a share in (0, 1]."
            )
        for name in ("mutation_sigma", "mutation_sigma_end"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise InputError(f"{name} is {value}; give a number above 0.")
        if not self.stop_cost >= 0.0:
            raise InputError(f"stop_cost is {self.stop_cost}; give 0 or more.")

    @property
    def n_children(self) -> int:
        """Individuals evaluated each generation."""
        if self.replacement == "generational":
            return self.population
        return max(1, round(self.replaced_share * self.population))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Generation:
    """The state after one generation, whole: the search can go on from it.

    Generation 0 is the first population.
    """

    restart: int
    """Which restart, from 0."""
    generation: int
    """Which generation of this restart, from 0."""
    genes: Float[np.ndarray, "p g"]
    """The living population."""
    costs: Float[np.ndarray, "p"]
    """Its costs; +inf where a cost could not be computed."""
    best_genes: Float[np.ndarray, "g"]
    """The best individual of the whole search so far."""
    best_cost: float
    """Its cost."""
    evaluations: int
    """Cost evaluations so far."""
    unchanged: int
    """Generations of this restart since the best got better."""
    stop: StopReason | None
    """Why this restart ended, in its last generation."""
    random_state: Mapping[str, Any]
    """Of numpy's PCG64, after this generation."""

    @property
    def median_cost(self) -> float:
        """Median cost of the living population."""
        return float(np.median(self.costs))

    @property
    def quartiles(self) -> tuple[float, float]:
        """First and third quartile of the population's costs."""
        ordered, quarter = np.sort(self.costs), len(self.costs) // 4
        return float(ordered[quarter]), float(ordered[-1 - quarter])


def evolve(
    costs: Callable[[np.ndarray], np.ndarray],
    first_population: Callable[[int, np.random.Generator], np.ndarray],
    config: GeneticConfig,
    seed: int,
    start: Float[np.ndarray, "g"] | None = None,
    resume: Generation | None = None,
) -> Iterator[Generation]:
    """Minimises ``costs`` over [-1, 1]^g; yields after each generation.

    Args:
        costs: (p, g) genes to (p,) costs. NaN counts as +inf, so it never wins. It
            may change from one restart to the next: the best is then valued anew.
        first_population: How many, and a random source, to that many individuals.
        config: Settings.
        seed: Same seed, same search.
        start: An individual that joins the first population, so that the best is
            never worse than it.
        resume: Go on after this generation of the same search instead, to the same
            end, bit for bit.
    """
    last, best_genes, best_cost, evaluations = resume, start, np.inf, 0
    if last is not None:
        best_genes, best_cost = last.best_genes, last.best_cost
        evaluations = last.evaluations
    for restart, stream in enumerate(
        np.random.SeedSequence(seed).spawn(config.restarts)
    ):
        if last is not None and (
            restart < last.restart
            or (restart == last.restart and last.stop is not None)
            or last.stop == "cost level"
        ):
            continue
        rng = np.random.default_rng(stream)
        if last is not None and restart == last.restart:
            genes, cost, unchanged = last.genes, last.costs, last.unchanged
            rng.bit_generator.state = dict(last.random_state)
            first = last.generation + 1
        else:
            genes = first_population(config.population, rng)
            if best_genes is not None:
                genes[0] = best_genes
            cost = _finite(costs(genes))
            evaluations += len(genes)
            if best_genes is not None:
                best_cost = float(cost[0])
            unchanged = first = 0
        for generation in range(first, config.generations + 1):
            before = best_cost
            if generation > 0:
                progress = (generation - 1) / max(1, config.generations - 1)
                children = _breed(genes, cost, config, progress, rng)
                child_cost = _finite(costs(children))
                evaluations += len(children)
                genes, cost = _survivors(genes, cost, children, child_cost, config)
            leader = int(np.argmin(cost))
            if best_genes is None or cost[leader] < best_cost:
                best_genes, best_cost = genes[leader].copy(), float(cost[leader])
            unchanged = 0 if best_cost < before else unchanged + 1
            stop = _stop(config, generation, best_cost, unchanged)
            yield Generation(
                restart=restart,
                generation=generation,
                genes=genes,
                costs=cost,
                best_genes=best_genes,
                best_cost=best_cost,
                evaluations=evaluations,
                unchanged=unchanged,
                stop=stop,
                random_state=rng.bit_generator.state,
            )
            if stop is not None:
                break
        if best_cost <= config.stop_cost:
            return


def _stop(
    config: GeneticConfig, generation: int, best_cost: float, unchanged: int
) -> StopReason | None:
    if best_cost <= config.stop_cost:
        return "cost level"
    if generation >= config.generations:
        return "generations"
    if 0 < config.stagnation <= unchanged:
        return "stagnation"
    return None


def _finite(costs: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(costs), np.inf, costs)


def _breed(
    genes: np.ndarray,
    cost: np.ndarray,
    config: GeneticConfig,
    progress: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """The children of one generation: selection, crossover, mutation."""
    n_children, n_genes = config.n_children, genes.shape[1]
    n_pairs = (n_children + 1) // 2
    parents = _select(cost, 2 * n_pairs, config, rng)
    mothers, fathers = genes[parents[:n_pairs]], genes[parents[n_pairs:]]
    if config.crossover == "uniform":
        swap = rng.random((n_pairs, n_genes)) < 0.5
    else:
        point = rng.integers(1, max(2, n_genes), n_pairs)
        swap = np.arange(n_genes) >= point[:, None]
    swap &= (rng.random(n_pairs) < config.crossover_rate)[:, None]
    children = np.concatenate(
        [np.where(swap, fathers, mothers), np.where(swap, mothers, fathers)]
    )[:n_children]
    sigma = config.mutation_sigma * (
        (config.mutation_sigma_end / config.mutation_sigma) ** progress
    )
    expected = config.mutation_rate * n_genes
    if config.mutations == "each_gene" or expected < 1.0:
        mutated = rng.random(children.shape) < config.mutation_rate
        steps = sigma * rng.standard_normal(children.shape)
        return np.clip(children + np.where(mutated, steps, 0.0), -1.0, 1.0)
    rows = np.arange(n_children)
    for _ in range(math.ceil(expected)):
        at = rng.integers(0, n_genes, n_children)
        stepped = children[rows, at] + sigma * rng.standard_normal(n_children)
        children[rows, at] = np.clip(stepped, -1.0, 1.0)
    return children


def _select(
    cost: np.ndarray, n: int, config: GeneticConfig, rng: np.random.Generator
) -> np.ndarray:
    """Indices of ``n`` parents."""
    if config.selection == "roulette":
        return rng.choice(len(cost), n, p=roulette_shares(cost))
    size = (n, config.tournament_size)
    if config.selection == "tournament":
        entrants = rng.integers(0, len(cost), size)
    else:
        entrants = rng.choice(len(cost), size, p=roulette_shares(cost))
    return entrants[np.arange(n), np.argmin(cost[entrants], axis=1)]


def roulette_shares(cost: Float[np.ndarray, "p"]) -> Float[np.ndarray, "p"]:
    """Probability of each individual on the roulette wheel; they sum to 1.

    Fitness is how much lower than the worst finite cost it is, scaled linearly so
    that the best gets ``ROULETTE_BEST_OVER_MEAN`` times the mean; an infinite cost
    gets nothing unless all are infinite.
    """
    finite = np.isfinite(cost)
    if not finite.any():
        return np.full(len(cost), 1.0 / len(cost))
    fitness = np.where(finite, cost[finite].max() - np.where(finite, cost, 0.0), 0.0)
    mean, best = fitness[finite].mean(), fitness.max()
    if best > mean:
        # Linear scaling keeps the mean; it must not push the worst below 0.
        slope = min((ROULETTE_BEST_OVER_MEAN - 1.0) * mean / (best - mean), 1.0)
        fitness = mean + slope * (fitness - mean)
    else:
        fitness = np.ones(len(cost))
    fitness = np.where(finite, np.maximum(fitness, 0.0), 0.0)
    return fitness / fitness.sum()


def _survivors(
    genes: np.ndarray,
    cost: np.ndarray,
    children: np.ndarray,
    child_cost: np.ndarray,
    config: GeneticConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """The next population. The best individual always survives (elitism)."""
    if config.replacement == "generational":
        worst, elite = int(np.argmax(child_cost)), int(np.argmin(cost))
        if cost[elite] < child_cost.min():
            children[worst], child_cost[worst] = genes[elite], cost[elite]
        return children, child_cost
    all_genes = np.concatenate([genes, children])
    all_costs = np.concatenate([cost, child_cost])
    keep = np.argsort(all_costs, kind="stable")[: len(genes)]
    return all_genes[keep], all_costs[keep]
