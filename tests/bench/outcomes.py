"""One refinement after another against the truth, and the figures of many."""

import dataclasses
import time
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.events import Finished
from photoreg.registration.refinement import refine
from tests.bench.metrics import Metric, spread
from tests.bench.worlds import World


@dataclasses.dataclass(frozen=True)
class Outcome:
    """One refinement against the truth."""

    start_px: float
    end_px: float
    elapsed_s: float
    cpu_s: float
    """Processor seconds of all threads: steadier than the clock on a busy machine."""
    finished: Finished


def run(
    mesh: Mesh,
    photos: Sequence[Photo],
    true: Sequence[Camera],
    start: Sequence[Camera],
    config: RegistrationConfig | None = None,
    true_mesh: Mesh | None = None,
    freedom: Freedom | None = None,
) -> Outcome:
    """Refines ``start`` and measures both ends of the way, on ``true_mesh`` if given."""
    began, cpu_began = time.perf_counter(), time.process_time()
    *_, finished = refine(mesh, photos, start, config, freedom)
    elapsed_s = time.perf_counter() - began
    cpu_s = time.process_time() - cpu_began
    assert isinstance(finished, Finished)
    surface = mesh if true_mesh is None else true_mesh
    return Outcome(
        projection_error(surface, true, start).mean,
        projection_error(surface, true, finished.cameras).mean,
        elapsed_s,
        cpu_s,
        finished,
    )


def run_world(
    world: World,
    config: RegistrationConfig | None = None,
    freedom: Freedom | None = None,
) -> Outcome:
    """Refines a made scene's rough cameras; its seed is the search's too."""
    config = RegistrationConfig() if config is None else config
    return run(
        world.mesh,
        world.photos,
        world.cameras,
        world.rough_cameras,
        dataclasses.replace(config, seed=world.seed),
        world.true_mesh,
        freedom,
    )


def figures(
    name: str,
    worlds: Iterable[World],
    preset: PresetName = "default",
    *,
    mean_bar: float | None = None,
    worst_bar: float | None = None,
    under: tuple[float, float] | None = None,
) -> Iterator[Metric]:
    """Error and time of a preset over scenes.

    Args:
        name: First part of the metrics' names.
        worlds: The scenes.
        preset: The preset's name.
        mean_bar: Bar for the mean error, in pixels.
        worst_bar: Bar for the worst error, in pixels.
        under: An error in pixels, and the share of runs that should end at or below it.
    """
    config = RegistrationConfig.preset(preset)
    outcomes = [run_world(world, config) for world in worlds]
    yield from error_figures(name, outcomes, mean_bar, worst_bar, under)
    yield from time_figures(name, outcomes)


def time_figures(
    name: str, outcomes: Sequence[Outcome], bar: float | None = None
) -> Iterator[Metric]:
    """Mean and worst seconds by the clock, and by the processor."""
    note = f"processor {np.mean([o.cpu_s for o in outcomes]):.1f} s"
    yield from spread(
        f"{name}.time",
        [outcome.elapsed_s for outcome in outcomes],
        "s",
        bar,
        tolerance=1.0,
        note=note,
    )


def error_figures(
    name: str,
    outcomes: Sequence[Outcome],
    mean_bar: float | None = None,
    worst_bar: float | None = None,
    under: tuple[float, float] | None = None,
) -> Iterator[Metric]:
    """Mean, spread, worst and share of successes of the errors of ``outcomes``."""
    errors = np.array([outcome.end_px for outcome in outcomes])
    starts = [outcome.start_px for outcome in outcomes]
    note = f"start {min(starts):.1f}-{max(starts):.1f} px"
    mean, std, worst = spread(
        f"{name}.error", errors, "px", mean_bar, worst_bar, note=note
    )
    yield mean
    yield std
    order = np.argsort(-errors)[:4]
    ends = ", ".join(f"{errors[k]:.2f} ({k})" for k in order)
    yield dataclasses.replace(worst, note=f"worst (run): {ends}")
    if under is not None:
        limit, share = under
        yield Metric(
            f"{name}.under_{limit:g}px",
            float((errors <= limit).mean()),
            "of runs",
            "higher",
            share,
            0.05,
            f"{(errors <= limit).sum()} of {errors.size}",
        )
