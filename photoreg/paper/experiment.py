"""The paper's experiment on our Shell: which methods are compared, and their runs."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.parameters.gene_box import GeneBox
from photoreg.parameters.genes import GeneMap
from photoreg.polish.config import PolishConfig
from photoreg.polish.polish_cameras import polish_cameras
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.refinement import refine
from photoreg.synthetic.scene import Scene

PATH_STEPS = 12
"""How many points of a run's way, cost and error, are kept."""


@dataclasses.dataclass(frozen=True)
class Method:
    """One row of a table: a way to register the photos."""

    table: str
    """Key of the table that it belongs to."""
    name: str
    """What stands in the row."""
    config: RegistrationConfig | PolishConfig
    """A refinement, or a polish alone from the manual start."""
    paper: str = ""
    """What the paper says of it: a figure or a few words; empty where it is silent."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class MethodRun:
    """One method from one manual start."""

    table: str
    method: str
    run: int
    """Number of the run from 1; it decides the start and the seed."""
    start_px: float
    """Projection error of the manual start, in pixels."""
    end_px: float
    """Projection error of the answer, in pixels."""
    cost: float
    """Cost of the answer; comparable between runs of the same method only."""
    seconds: float
    evaluations: int
    """Cost evaluations of the search; 0 for a polish."""
    path: tuple[tuple[float, float], ...]
    """Cost and projection error of the best individual on the way of the search."""


def manual_start(
    mesh: Mesh,
    cameras: Sequence[Camera],
    error_px: tuple[float, float] = (15.0, 25.0),
    seed: int = 0,
) -> list[Camera]:
    """Manual cameras whose truth lies inside the paper's gene intervals.

    The paper's search cannot leave its intervals (focal length 2 %, principal point
    0.5 %, rotation 1 degree, camera centre 3 %), so the errors of its manual
    pre-registration must have been smaller. All nine parameters of each camera are
    drawn evenly, then scaled together to the mean error wanted.

    Args:
        mesh: The surface.
        cameras: The true cameras.
        error_px: Lowest and highest mean projection error, in pixels.
        seed: Same seed, same cameras.

    Raises:
        InputError: if the intervals are too narrow for such an error.
    """
    rng = np.random.default_rng([seed, 0x3A4D])
    target = rng.uniform(*error_px)
    gene_map = GeneMap(cameras, mesh.centroid, GeneBox(), "pinhole", "camera")
    for _ in range(30):
        genes = rng.uniform(-1.0, 1.0, gene_map.n_genes)
        scale = 1.0
        # The error grows almost linearly with the genes: a few steps find the scale.
        for _ in range(6):
            manual = gene_map.to_cameras(scale * genes)
            scale *= target / projection_error(mesh, cameras, manual, 2_000).mean
        # What is 1 from the truth must not be over 1 from the start, hence a margin.
        if scale * np.abs(genes).max() <= 0.95:
            return gene_map.to_cameras(scale * genes)
    raise InputError(
        f"No manual cameras {target:.1f} px off lie within the paper's gene intervals; "
        "ask for less."
    )


def methods(
    populations: Sequence[int], generations: int, polish: PolishConfig | None = None
) -> list[Method]:
    """Every row of every table.

    Args:
        populations: Individuals of Table 1's columns; the comparisons use the first.
        generations: Generations of each restart, 100 in the paper.
        polish: Our polish; None: its defaults.
    """
    paper = RegistrationConfig.preset("paper")
    paper = _with_genetic(paper, generations=generations, population=populations[0])
    genetic = paper.genetic
    said = {500: "6.54 px, 15 min", 1000: "5.63 px, 40 min"}
    rows = [
        Method(
            "population",
            f"{population} individuals",
            _with_genetic(paper, population=population),
            said.get(population, ""),
        )
        for population in populations
    ]
    colours = {"luv": "best", "xyz": "worse", "hsi": "worse", "lab": "", "rgb": ""}
    rows += [
        Method("colour", name.upper(), _with_consistency(paper, colour=name), verdict)
        for name, verdict in colours.items()
    ]
    costs = {
        "alpha_trimmed": ("alpha-trimmed mean, 0.2", "best"),
        "trimmed_squares": ("trimmed squares, 0.2", "slightly worse"),
        "ssd": ("sum of squares, eq. 1", "not robust"),
        "variance": ("variance of colours", "worse"),
        "mncc": ("modified normalised cross-correlation", "worse"),
    }
    rows += [
        Method("cost", label, _with_consistency(paper, cost=name), verdict)
        for name, (label, verdict) in costs.items()
    ]
    visibilities = {
        "normals": ("normals, cosine at least 0.5", "chosen: much faster"),
        "rays": ("the same, and rays", "the method it was compared with"),
        "depth": ("the same, and a depth buffer", ""),
    }
    rows += [
        Method(
            "visibility",
            label,
            dataclasses.replace(paper, occlusion=name),  # pyright: ignore[reportArgumentType]
            verdict,
        )
        for name, (label, verdict) in visibilities.items()
    ]
    rows += [
        Method("camera", "18 genes: pinhole", paper, "more efficient"),
        Method(
            "camera",
            "22 genes: skew and two focal lengths as well",
            dataclasses.replace(paper, camera_model="full"),
            "harder to search",
        ),
        Method("first", "with eq. 4", paper, "much more efficient"),
        Method(
            "first",
            "without",
            dataclasses.replace(paper, tie_focal_to_distance=False),
        ),
    ]
    share = genetic.n_children / genetic.population
    simple = max(1, round(generations * share))
    rows += [
        Method("genetic", "steady-state, tournament, uniform", paper, "chosen"),
        Method(
            "genetic",
            f"generational, {simple} generations",
            _with_genetic(paper, replacement="generational", generations=simple),
            "converges slower",
        ),
        Method(
            "genetic",
            "roulette wheel",
            _with_genetic(paper, selection="roulette"),
            "not chosen",
        ),
        Method(
            "genetic",
            "single-point crossover",
            _with_genetic(paper, crossover="single_point"),
            "not chosen",
        ),
        Method(
            "genetic",
            f"1 x {5 * generations} generations, no restart",
            _with_genetic(paper, restarts=1, generations=5 * generations),
            "converges too early",
        ),
    ]
    polish = PolishConfig() if polish is None else polish
    return rows + _beyond(paper, populations[0], polish)


def _beyond(
    paper: RegistrationConfig, population: int, polish: PolishConfig
) -> list[Method]:
    sharp = dataclasses.replace(
        polish,
        blurs_px=(0.0,),
        points=(1_000,),
        rounds=(1,),
        extra_rounds=0,
        rim_reaches_px=(4.0,),
        use_silhouette=False,
        iterations=100,
    )
    default = dataclasses.replace(RegistrationConfig.preset("default"), polish=polish)
    return [
        Method("beyond", f"the paper's search, {population} individuals", paper),
        Method("beyond", "Levenberg-Marquardt from the manual start", sharp, "failed"),
        Method("beyond", "our polish alone from the manual start", polish),
        Method("beyond", "default preset", default),
    ]


def runs(
    scene: Scene, rows: Sequence[Method], n_runs: int, n_compared: int, seed: int = 0
) -> Iterator[MethodRun]:
    """Runs every method from the manual starts; yields each as it ends.

    Every method starts from the same manual cameras with the same seeds. A method
    that stands in several tables is run once.

    Args:
        scene: The Shell.
        rows: The methods.
        n_runs: Runs of each method of Table 1 and of the last table.
        n_compared: Runs of each method of the other tables.
        seed: Of the starts and searches.
    """
    done: dict[tuple[object, int], MethodRun] = {}
    starts = {
        number: manual_start(scene.true_mesh, scene.cameras, seed=1000 * seed + number)
        for number in range(1, n_runs + 1)
    }
    for row in rows:
        for number in range(1, count(row, n_runs, n_compared) + 1):
            key = (row.config, number)
            if key not in done:
                done[key] = _one(scene, starts[number], row, number, seed)
            yield dataclasses.replace(done[key], table=row.table, method=row.name)


def count(row: Method, n_runs: int, n_compared: int) -> int:
    """How often a method is run."""
    return n_runs if row.table in ("population", "beyond") else n_compared


def _one(
    scene: Scene, start: Sequence[Camera], row: Method, number: int, seed: int
) -> MethodRun:
    def error_px(cameras: Sequence[Camera], n_samples: int = 10_000) -> float:
        return projection_error(scene.true_mesh, scene.cameras, cameras, n_samples).mean

    began = time.perf_counter()
    path: list[tuple[float, Sequence[Camera]]] = []
    if isinstance(row.config, PolishConfig):
        *_, last = polish_cameras(
            scene.mesh, scene.photos, start, start, row.config, 1000 * seed + number
        )
        cameras, cost, evaluations = last.cameras, last.cost, 0
    else:
        config = dataclasses.replace(row.config, seed=1000 * seed + number)
        finished = None
        for event in refine(scene.mesh, scene.photos, start, config):
            if isinstance(event, Finished):
                finished = event
            elif isinstance(event, Progress) and event.phase == "search":
                path.append((event.best_cost, event.cameras))
        assert finished is not None
        cameras, cost = finished.cameras, finished.cost
        evaluations = finished.evaluations
    seconds = time.perf_counter() - began
    kept = sorted({round(k) for k in np.linspace(0, len(path) - 1, PATH_STEPS)})
    return MethodRun(
        table=row.table,
        method=row.name,
        run=number,
        start_px=error_px(start),
        end_px=error_px(cameras),
        cost=cost,
        seconds=seconds,
        evaluations=evaluations,
        path=tuple((path[k][0], error_px(path[k][1], 2_000)) for k in kept if path),
    )


def _with_consistency(config: RegistrationConfig, **changes: Any) -> RegistrationConfig:
    return dataclasses.replace(
        config, consistency=dataclasses.replace(config.consistency, **changes)
    )


def _with_genetic(config: RegistrationConfig, **changes: Any) -> RegistrationConfig:
    return dataclasses.replace(
        config, genetic=dataclasses.replace(config.genetic, **changes)
    )
