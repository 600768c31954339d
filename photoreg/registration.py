"""The whole refinement: prepare, search, and the events that tell how it goes."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from photoreg.camera import Camera
from photoreg.consistency import ConsistencyConfig, PhotoConsistency, patches_of
from photoreg.errors import InputError, RefinementError
from photoreg.genes import CameraModel, Coordinates, GeneBox, GeneMap
from photoreg.genetic import Generation, GeneticConfig, evolve
from photoreg.mesh import Mesh
from photoreg.photo import Photo
from photoreg.sampling import SurfaceSamples, sample_surface
from photoreg.visibility import VisibilityMethod, visible

PresetName = Literal["default", "paper", "fast", "thorough"]
Phase = Literal["prepare", "search", "polish"]


@dataclasses.dataclass(frozen=True)
class RegistrationConfig:
    """Everything that a refinement can be told."""

    seed: int = 0
    """Same seed, same answer, whatever the number of threads; 0 or more."""
    samples: int = 1000
    """Surface points that the search compares, at least 10."""
    focus_samples: bool = True
    """Take the surface points only where two photos may see them; false: from the
    whole surface, as the paper does."""
    camera_model: CameraModel = "pinhole"
    """pinhole: square pixels, no skew, 9 genes a camera. full: 11."""
    coordinates: Coordinates = "object"
    """Genes of the cameras: camera (the paper's) or object (turns about the object)."""
    box: GeneBox = dataclasses.field(
        default_factory=lambda: GeneBox(
            focal=0.03, principal_point=0.005, rotation_deg=4.0, scale=0.07, shift=0.045
        )
    )
    """Gene intervals around the start."""
    tie_focal_to_distance: bool = True
    """First population by the paper's eq. 4, f / d ~ w / W."""
    occlusion: VisibilityMethod = "rays"
    """How points hidden behind the surface are found, at the start and after each
    restart: rays, depth, or normals (not at all, as in the paper)."""
    consistency: ConsistencyConfig = dataclasses.field(
        default_factory=lambda: ConsistencyConfig(max_side_px=512, blur_px=1.0)
    )
    """How photos are compared in the search."""
    genetic: GeneticConfig = dataclasses.field(
        default_factory=lambda: GeneticConfig(
            population=300, generations=60, restarts=1, mutation_sigma_end=0.05
        )
    )
    """The search."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; give 0 or more.")
        if self.samples < 10:
            raise InputError(f"samples is {self.samples}; give at least 10.")

    @classmethod
    def preset(
        cls, name: PresetName = "default", seed: int = 0
    ) -> "RegistrationConfig":
        """The settings of a preset.

        ``default``: a short search that finds the basin, then the polish. ``fast``: a
        shorter one. ``thorough``: a wider box and a longer search. ``paper``: the
        genetic algorithm exactly as the paper has it, alone.

        Raises:
            InputError: if there is no such preset.
        """
        default = cls(seed=seed)
        if name == "default":
            return default
        if name == "fast":
            return dataclasses.replace(
                default,
                genetic=dataclasses.replace(
                    default.genetic, population=150, generations=40
                ),
            )
        if name == "thorough":
            return dataclasses.replace(
                default,
                box=default.box.widened(2.2),
                genetic=dataclasses.replace(
                    default.genetic, population=1000, generations=100, restarts=2
                ),
            )
        if name == "paper":
            return cls(
                seed=seed,
                samples=1000,
                focus_samples=False,
                coordinates="camera",
                box=GeneBox(),
                occlusion="normals",
                consistency=ConsistencyConfig(
                    exposure=False, min_share=0.0, max_side_px=1 << 30
                ),
                genetic=GeneticConfig(),
            )
        raise InputError(
            f"{name!r} is not a preset; choose default, paper, fast or thorough."
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Progress:
    """One step of a running refinement."""

    phase: Phase
    """What is going on."""
    step: str
    """The same in plain words."""
    fraction: float
    """Share of the whole run's budget spent, in [0, 1]. Not a promise of time left."""
    generation: int
    """Generations of the search so far, over all restarts."""
    evaluations: int
    """Cost evaluations so far."""
    best_cost: float
    """Cost of ``cameras``; comparable only within one phase."""
    median_cost: float
    """Median cost of the living population; the best cost where there is none."""
    elapsed_s: float
    """Seconds since the start."""
    cameras: tuple[Camera, ...]
    """The best so far, one a photo: always a complete answer."""


@dataclasses.dataclass(frozen=True, eq=False)
class Finished:
    """How a refinement ended."""

    cameras: tuple[Camera, ...]
    """The answer, one a photo."""
    start_cost: float
    """Cost of the cameras given."""
    cost: float
    """Cost of the answer, measured the same way; never above ``start_cost``."""
    reason: str
    """Why it ended, in one sentence."""
    warnings: tuple[str, ...]
    """What makes the answer doubtful, one sentence each."""
    elapsed_s: float
    """Seconds it took."""
    generations: int
    """Generations of the search."""
    evaluations: int
    """Cost evaluations of the search."""
    seconds_by_phase: dict[str, float]
    """Seconds by phase."""


Event = Progress | Finished


def refine(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig | None = None,
) -> Iterator[Event]:
    """Refines rough cameras until the photos agree over the surface.

    Stop iterating to cancel: every event holds the best cameras so far. The last
    event is a ``Finished``.

    Args:
        mesh: The surface.
        photos: Two or more.
        cameras: The pre-registration, one a photo, in the same order.
        config: Settings; None: the default preset.

    Raises:
        InputError: if photos and cameras do not match.
        RefinementError: if no camera sees the surface, or no two see a common part.
    """
    config = RegistrationConfig() if config is None else config
    _check(photos, cameras)
    return _run(mesh, tuple(photos), tuple(cameras), config)


def _check(photos: Sequence[Photo], cameras: Sequence[Camera]) -> None:
    if len(photos) < 2:
        raise InputError(f"A refinement needs two photos or more, not {len(photos)}.")
    if len(photos) != len(cameras):
        raise InputError(
            f"There are {len(photos)} photos but {len(cameras)} cameras; give one camera "
            "a photo, in the same order."
        )
    for photo, camera in zip(photos, cameras, strict=True):
        if (photo.width, photo.height) != (camera.width, camera.height):
            raise InputError(
                f"{photo.name} is {photo.width}x{photo.height} px, but its camera is for "
                f"{camera.width}x{camera.height} px."
            )


def _run(
    mesh: Mesh,
    photos: tuple[Photo, ...],
    start: tuple[Camera, ...],
    config: RegistrationConfig,
) -> Iterator[Event]:
    began = time.perf_counter()
    yield Progress("prepare", "getting ready", 0.0, 0, 0, np.inf, np.inf, 0.0, start)
    samples = _samples(mesh, start, config)
    warnings = _view_warnings(mesh, photos, start)
    patches = None
    if config.consistency.cost == "mncc":
        patches = patches_of(mesh, samples, start, config.consistency)
    consistency = PhotoConsistency(samples, photos, config.consistency, patches=patches)
    gene_map = GeneMap(
        start, mesh.centroid, config.box, config.camera_model, config.coordinates
    )
    if config.occlusion != "normals":
        consistency.allow(
            visible(samples, start, mesh, config.occlusion, min_cosine=0.0)
        )
    consistency.require(start)
    start_cost = consistency.cost(start)
    prepared = time.perf_counter()
    generations, last, best = 0, None, start
    for last in evolve(
        lambda genes: consistency.costs(genes, gene_map),
        lambda n, rng: gene_map.first_population(n, rng, config.tie_focal_to_distance),
        config.genetic,
        config.seed,
        start=np.zeros(gene_map.n_genes),
    ):
        generations += last.generation > 0
        best = tuple(gene_map.to_cameras(last.best_genes))
        yield Progress(
            "search",
            f"generation {generations} of {_budget(config)}",
            0.05 + 0.95 * generations / _budget(config),
            generations,
            last.evaluations,
            last.best_cost,
            last.median_cost,
            time.perf_counter() - began,
            best,
        )
    assert last is not None
    searched = time.perf_counter()
    yield Finished(
        best,
        start_cost,
        last.best_cost,
        _reason(last),
        tuple(warnings + _border_warnings(gene_map, last)),
        searched - began,
        generations,
        last.evaluations,
        {"prepare": prepared - began, "search": searched - prepared},
    )


def _budget(config: RegistrationConfig) -> int:
    return config.genetic.generations * config.genetic.restarts


def _samples(
    mesh: Mesh, cameras: Sequence[Camera], config: RegistrationConfig
) -> SurfaceSamples:
    """The points to compare; where two photos may see them, if so configured."""
    if not config.focus_samples:
        return sample_surface(mesh, config.samples, config.seed)
    # Ten times as many as wanted are enough where a tenth of the surface is shared.
    candidates = sample_surface(mesh, 10 * config.samples, config.seed)
    seen = visible(candidates, cameras, mesh, "rays", config.consistency.min_cosine)
    shared = np.flatnonzero(seen.sum(axis=0) >= 2)
    rng = np.random.default_rng(config.seed)
    if len(shared) > config.samples:
        shared = np.sort(rng.choice(shared, config.samples, replace=False))
    if len(shared) < 10:
        raise RefinementError(
            "The photos show hardly any common part of the surface with these cameras, "
            f"so they cannot be compared ({len(shared)} of {len(candidates)} points). "
            "Align the cameras, or take photos from nearer viewpoints."
        )
    return candidates.subset(shared)


def _view_warnings(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> list[str]:
    """Warnings about what the start cameras see.

    Raises:
        RefinementError: if none of them sees the surface.
    """
    seen = visible(sample_surface(mesh, 2000, 0), cameras, mesh, "rays", 0.0)
    blind = [
        photo.name for photo, row in zip(photos, seen, strict=True) if not row.any()
    ]
    if len(blind) == len(photos):
        raise RefinementError(
            "No camera sees the surface from where it stands. Align the cameras first."
        )
    warnings = [
        f"The camera of {name} does not see the surface; align it and refine again."
        for name in blind
    ]
    either = seen.any(axis=0).sum()
    shared = (seen.sum(axis=0) >= 2).sum()
    if shared < 0.1 * either:
        warnings.append(
            "The photos hardly overlap on the surface: "
            f"{100 * shared / max(1, either):.0f} % of what they see is seen twice. "
            "The answer rests on little."
        )
    return warnings


def _border_warnings(gene_map: GeneMap, last: Generation) -> list[str]:
    names = gene_map.names()
    outside = [names[g] for g in np.flatnonzero(gene_map.on_border(last.best_genes))]
    if not outside:
        return []
    return [
        f"The answer lies on the border of the search box ({', '.join(outside)}): the "
        "true cameras may lie outside. Refine again from here, or use a wider box."
    ]


def _reason(last: Generation) -> str:
    if last.stop == "cost level":
        return f"The cost fell to the level asked for ({last.best_cost:.4g})."
    if last.stop == "stagnation":
        return "The search stopped improving."
    return "All generations of the search are done."
