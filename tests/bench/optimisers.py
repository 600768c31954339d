"""Our search against other optimisers: the same cost, the same number of evaluations.

Each starts from the same first population (or, where it takes a point, from the
pre-registration), works in the same box of genes and has the same budget. The
libraries come with the optional extra ``bench``; one that is not installed is left out.
"""

import contextlib
import dataclasses
import importlib
import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np
from scipy.optimize import differential_evolution

from photoreg.geometry.projection_error import projection_error
from photoreg.parameters.genes import GeneMap
from photoreg.registration import genetic_search
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.refinement import refine
from photoreg.search.genetic import GeneticConfig, evolve
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.worlds import World, worlds

BUDGET = 20_000
"""Cost evaluations of each optimiser."""
POPULATION = 200
"""Individuals of the libraries' populations: the best of 100, 200 and 400 for most."""


@dataclasses.dataclass
class Problem:
    """A cost over [-1, 1]^g that counts and times its evaluations."""

    search_costs: Callable[[np.ndarray], np.ndarray]
    gene_map: GeneMap
    first: np.ndarray
    """The first population, the pre-registration in it."""
    seed: int
    evaluations: int = 0
    best_cost: float = np.inf
    best_genes: np.ndarray | None = None

    def costs(self, genes: np.ndarray) -> np.ndarray:
        """Costs of a population; what exceeds the budget is not evaluated."""
        values = np.full(len(genes), np.inf)
        allowed = max(0, min(len(genes), BUDGET - self.evaluations))
        if allowed:
            inside = np.clip(genes[:allowed], -1.0, 1.0)
            values[:allowed] = self.search_costs(inside)
            self.evaluations += allowed
            leader = int(np.argmin(values))
            if values[leader] < self.best_cost:
                self.best_cost = float(values[leader])
                self.best_genes = inside[leader].copy()
        # Some libraries cannot take infinity.
        return np.where(np.isfinite(values), values, 1e9)


Optimiser = Callable[[Problem], None]


def ours(problem: Problem) -> None:
    """The default preset's genetic algorithm, given more generations."""
    preset = RegistrationConfig.preset("default", seed=problem.seed).genetic
    generations = (BUDGET - preset.population) // preset.n_children
    config = dataclasses.replace(preset, generations=generations, restarts=1)
    _search(problem, config)


def paper(problem: Problem) -> None:
    """The paper's genetic algorithm, its 5 restarts within the budget."""
    preset = RegistrationConfig.preset("paper", seed=problem.seed).genetic
    each = BUDGET // preset.restarts - preset.population
    config = dataclasses.replace(preset, generations=each // preset.n_children)
    _search(problem, config)


def _search(problem: Problem, config: GeneticConfig) -> None:
    for _ in evolve(
        problem.costs,
        problem.gene_map.first_population,
        config,
        problem.seed,
        start=problem.first[0],
    ):
        pass


def pymoo(problem: Problem) -> None:
    """Pymoo's genetic algorithm: simulated binary crossover, polynomial mutation."""
    algorithms = importlib.import_module("pymoo.algorithms.soo.nonconvex.ga")
    problems = importlib.import_module("pymoo.core.problem")
    optimize = importlib.import_module("pymoo.optimize")

    class Boxed(problems.Problem):
        def __init__(self) -> None:
            n = problem.gene_map.n_genes
            super().__init__(n_var=n, n_obj=1, xl=-np.ones(n), xu=np.ones(n))

        def _evaluate(self, x, out, *args, **kwargs):
            out["F"] = problem.costs(x)

    optimize.minimize(
        Boxed(),
        algorithms.GA(pop_size=POPULATION, sampling=problem.first),
        ("n_eval", BUDGET),
        seed=problem.seed,
        verbose=False,
    )


def pygad(problem: Problem) -> None:
    """PyGAD: tournament, uniform crossover, mutation probability 0.1."""
    library = importlib.import_module("pygad")

    def fitness(_, genes, __):
        return -problem.costs(np.atleast_2d(genes))

    n_parents = POPULATION // 2
    library.GA(
        num_generations=BUDGET // (POPULATION - 1),
        num_parents_mating=n_parents,
        initial_population=problem.first,
        fitness_func=fitness,
        fitness_batch_size=POPULATION,
        parent_selection_type="tournament",
        crossover_type="uniform",
        mutation_probability=0.1,
        random_mutation_min_val=-0.2,
        random_mutation_max_val=0.2,
        gene_space={"low": -1.0, "high": 1.0},
        keep_elitism=1,
        random_seed=problem.seed,
        suppress_warnings=True,
    ).run()


def scipy(problem: Problem) -> None:
    """Scipy's differential evolution, best1bin, without its final polish."""
    n = problem.gene_map.n_genes
    differential_evolution(
        lambda x: problem.costs(x.T),
        [(-1.0, 1.0)] * n,
        init=problem.first,  # pyright: ignore[reportArgumentType]
        maxiter=BUDGET // POPULATION,
        tol=0.0,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=problem.seed,
    )


def pycma(problem: Problem) -> None:
    """Pycma's CMA-ES from the pre-registration, sigma 0.3, its own population size."""
    cma = importlib.import_module("cma")
    n = problem.gene_map.n_genes
    options = {"bounds": [-1.0, 1.0], "seed": problem.seed + 1, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(np.zeros(n), 0.3, options)
    while problem.evaluations < BUDGET and not strategy.stop():
        genes = strategy.ask()
        strategy.tell(genes, list(problem.costs(np.array(genes))))


LIBRARIES: dict[str, tuple[str, Optimiser]] = {
    "pymoo": ("pymoo", pymoo),
    "pygad": ("pygad", pygad),
    "scipy": ("scipy", scipy),
    "pycma": ("cma", pycma),
}


@bench
def optimisers(setting: Setting) -> Iterator[Metric]:
    """Final cost, error and time of every optimiser on the default preset's cost."""
    found: dict[str, Optimiser] = {"ours": ours, "paper": paper}
    for name, (module, optimiser) in LIBRARIES.items():
        if importlib.util.find_spec(module) is None:
            print(f"optimisers: {name} is left out, because it is not installed.")
        else:
            found[name] = optimiser
    ends: dict[str, list[tuple[float, float, float]]] = {name: [] for name in found}
    for world in worlds(setting.n, "clean"):
        for name, optimiser in found.items():
            ends[name].append(_end(world, optimiser))
    mean = {name: np.array(rows).mean(axis=0) for name, rows in ends.items()}
    for name, (cost, error_px, seconds) in mean.items():
        spread = np.array(ends[name]).std(axis=0)
        yield Metric(
            f"optimisers.{name}.cost",
            cost,
            "",
            "lower",
            None,
            0.25,
            f"± {spread[0]:.2g}; {error_px:.2f} ± {spread[1]:.2f} px; {seconds:.2f} s",
        )
    for name in found:
        if name == "ours":
            continue
        yield Metric(
            f"optimisers.cost_over_{name}",
            mean["ours"][0] / mean[name][0],
            "x",
            "lower",
            1.0 if name in ("pymoo", "pygad", "paper") else None,
        )
        yield Metric(
            f"optimisers.time_over_{name}",
            mean["ours"][2] / mean[name][2],
            "x",
            "lower",
            tolerance=0.5,
        )


def _end(world: World, optimiser: Optimiser) -> tuple[float, float, float]:
    """Final cost, projection error in pixels and seconds."""
    config = RegistrationConfig.preset("default", seed=world.seed)
    gene_map = GeneMap(
        world.rough_cameras,
        world.mesh.centroid,
        config.box,
        config.camera_model,
        config.coordinates,
    )
    first = gene_map.first_population(POPULATION, np.random.default_rng(world.seed))
    first[0] = 0.0
    problem = Problem(_search_costs(world, config), gene_map, first, world.seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        began = time.perf_counter()
        optimiser(problem)
        seconds = time.perf_counter() - began
    assert problem.best_genes is not None
    assert problem.evaluations <= BUDGET
    cameras = gene_map.to_cameras(problem.best_genes)
    error_px = projection_error(world.true_mesh, world.cameras, cameras).mean
    return problem.best_cost, error_px, seconds


class _CaughtError(Exception):
    """Ends a refinement whose search has been caught."""


def _search_costs(
    world: World, config: RegistrationConfig
) -> Callable[[np.ndarray], np.ndarray]:
    """The very function that a refinement's search minimises."""
    caught: list[Callable[[np.ndarray], np.ndarray]] = []

    def catch(costs: Callable[[np.ndarray], np.ndarray], *_: Any, **__: Any) -> None:
        caught.append(costs)
        raise _CaughtError

    with (
        mock.patch.object(genetic_search, "evolve", catch),
        contextlib.suppress(_CaughtError),
    ):
        for _ in refine(world.mesh, world.photos, world.rough_cameras, config):
            pass
    return caught[0]
