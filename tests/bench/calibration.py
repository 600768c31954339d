"""Whether photoreg knows how sure it is: the true error against the estimated one."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from photoreg.geometry.projection_error import projection_error
from photoreg.polish.polish_cameras import polish_cameras
from photoreg.polish.uncertainty import estimate_uncertainty
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.worlds import World, worlds

NOISY: dict[str, dict[str, Any]] = {
    "sensor_noise": {"kind": "clean", "sensor_noise": 8.0},
    "mesh_noise": {"kind": "clean", "mesh_noise": 0.0005},
    "faint": {"kind": "clean", "contrast": 0.3, "sensor_noise": 3.0},
    "mid": {"kind": "mid"},
}
"""Scenes whose answers are uncertain for different reasons."""


@bench
def calibration(setting: Setting) -> Iterator[Metric]:
    """Share of polishes whose true error is within twice the estimate."""
    everything: list[float] = []
    for name, settings in NOISY.items():
        pairs = [_estimated_and_true(w) for w in worlds(setting.n, **settings)]
        estimated, true = np.array(pairs).T
        ratios = true / estimated
        everything += ratios.tolist()
        yield Metric(
            f"calibration.{name}.within_twice",
            float((ratios <= 2.0).mean()),
            "of runs",
            "higher",
            0.9,
            0.1,
            f"n={ratios.size}; true {true.mean():.3f} px, estimated "
            f"{estimated.mean():.3f} px",
        )
        # An estimate far above the error would pass, and be worth nothing.
        yield Metric(
            f"calibration.{name}.true_over_estimated",
            float(np.median(ratios)),
            "median",
            "higher",
            0.25,
            0.5,
        )
    yield Metric(
        "calibration.within_twice",
        float((np.array(everything) <= 2.0).mean()),
        "of runs",
        "higher",
        0.9,
        0.05,
        f"n={len(everything)}",
    )


def _estimated_and_true(world: World) -> tuple[float, float]:
    """Expected and true projection error of a polish from rough cameras, in pixels."""
    *_, last = polish_cameras(
        world.mesh,
        world.photos,
        world.rough_cameras,
        world.rough_cameras,
        seed=world.seed,
    )
    estimated = estimate_uncertainty(world.mesh, last).expected_error_px
    true = projection_error(world.true_mesh, world.cameras, last.cameras).mean
    return estimated, true
