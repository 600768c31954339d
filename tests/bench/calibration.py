"""Whether photoreg knows how sure it is: the true error against the estimated one."""

import itertools
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

BUMP_HEIGHTS = (0.0005, 0.001)
BUMP_LENGTHS = (0.01, 0.03, 0.1)
"""Of the bumps of wrong scans, as shares of the diagonal."""


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


@bench
def bumpy_scans(setting: Setting) -> Iterator[Metric]:
    """True error over the estimated one, where neighbouring errors of the scan agree."""
    pairs = [
        _estimated_and_true(w)
        for height, length in itertools.product(BUMP_HEIGHTS, BUMP_LENGTHS)
        for w in worlds(setting.n, mesh_noise=height, mesh_noise_length=length)
    ]
    estimated, true = np.array(pairs).T
    ratios = true / estimated
    note = f"n={ratios.size}; true {true.min():.2f} to {true.max():.2f} px"
    yield Metric(
        "bumpy_scans.true_over_estimated.worst",
        float(ratios.max()),
        "times",
        "lower",
        None,
        0.25,
        note,
    )
    # An estimate far above the error would never be exceeded, and be worth nothing.
    yield Metric(
        "bumpy_scans.true_over_estimated.least",
        float(ratios.min()),
        "times",
        "higher",
        None,
        0.5,
        note,
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
