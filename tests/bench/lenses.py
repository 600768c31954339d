"""Refinements of photos through real lenses, whose terms nobody knows beforehand."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from photoreg.registration.config import RegistrationConfig
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.outcomes import error_figures, run_world, time_figures
from tests.bench.worlds import World, world

PHONE_FOCAL_SHARE = 0.78
"""Focal length of a phone over its photo's width."""

SOLVING = dataclasses.replace(RegistrationConfig(), distortion="auto")

FIRST_SEED = 100


def _through_k1(n: int, kind: str) -> Iterator[World]:
    """Scenes through one radial term, drawn from -0.15 to 0.05."""
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        k1 = float(np.random.default_rng(seed).uniform(-0.15, 0.05))
        yield world(
            kind,
            seed,
            focal_share=PHONE_FOCAL_SHARE,
            distortion=(k1, 0.0, 0.0, 0.0, 0.0),
        )


def _through_phones(n: int, kind: str) -> Iterator[World]:
    """Scenes through terms as those of real phones."""
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        rng = np.random.default_rng(seed)
        k1, k2 = float(rng.uniform(0.02, 0.12)), float(rng.uniform(-0.2, 0.05))
        p1, p2 = (0.001 * float(sign) for sign in rng.choice([-1.0, 1.0], 2))
        yield world(
            kind, seed, focal_share=PHONE_FOCAL_SHARE, distortion=(k1, k2, p1, p2, 0.0)
        )


def _ideal(n: int, kind: str) -> Iterator[World]:
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        yield world(kind, seed)


@bench
def lens(setting: Setting) -> Iterator[Metric]:
    """Unknown lenses solved along, and ideal ones solved all the same."""
    cases = (
        ("lens.k1", _through_k1, "clean", 0.10, 0.3),
        ("lens.phone", _through_phones, "clean", 0.15, 0.5),
        ("lens.k1_mid", _through_k1, "mid", None, None),
        ("lens.ideal", _ideal, "clean", 0.10, 0.3),
        ("lens.ideal_mid", _ideal, "mid", None, None),
    )
    for name, scenes, kind, mean_bar, worst_bar in cases:
        outcomes = [run_world(made, SOLVING) for made in scenes(setting.n, kind)]
        yield from error_figures(name, outcomes, mean_bar, worst_bar)
        yield from time_figures(name, outcomes)


@bench
def lens_held(setting: Setting) -> Iterator[Metric]:
    """The same with every lens held at 0: what it costs not to solve them."""
    held = dataclasses.replace(SOLVING, distortion="none")
    for name, scenes in (("k1", _through_k1), ("ideal", _ideal)):
        outcomes = [run_world(made, held) for made in scenes(setting.n, "clean")]
        yield from error_figures(f"lens_held.{name}", outcomes)
        yield from time_figures(f"lens_held.{name}", outcomes)
