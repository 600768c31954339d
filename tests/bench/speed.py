"""How long a refinement takes, where the time goes, and that threads change nothing."""

import dataclasses
import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.registration.config import RegistrationConfig
from tests.bench.metrics import Metric, Setting, bench, spread
from tests.bench.outcomes import error_figures, run_world, time_figures
from tests.bench.worlds import world, worlds

ROOT = Path(__file__).parents[2]

PAPER = {500: (6.54, 3.0), 1000: (5.63, 6.0)}
"""Individuals to the paper's mean error in pixels, and our bar in seconds. The paper
took 15 and 40 minutes."""


@bench
def paper(setting: Setting) -> Iterator[Metric]:
    """The paper's algorithm, with its two sizes of population.

    Starts lie inside the paper's gene intervals, as its manual ones must have; then
    once more as every other bench starts, where the truth may lie outside.
    """
    for population, (error_px, seconds) in PAPER.items():
        preset = RegistrationConfig.preset("paper")
        genetic = dataclasses.replace(preset.genetic, population=population)
        config = dataclasses.replace(preset, genetic=genetic)
        scenes = [w.by_hand() for w in worlds(setting.n, "shell")]
        outcomes = [run_world(scene, config) for scene in scenes]
        yield from error_figures(f"paper_{population}", outcomes, error_px)
        yield from time_figures(f"paper_{population}", outcomes, seconds)
        outcomes = [run_world(w, config) for w in worlds(setting.n, "shell")]
        yield from error_figures(f"paper_{population}.rough", outcomes)


@bench
def whole(setting: Setting) -> Iterator[Metric]:
    """The default preset, compiled, and its seconds by phase."""
    run_world(world("clean", 0))
    outcomes = [run_world(w) for w in worlds(setting.n, "clean")]
    yield from time_figures("whole", outcomes, 4.0)
    phases: dict[str, list[float]] = defaultdict(list)
    for outcome in outcomes:
        for phase, seconds in outcome.finished.seconds_by_phase.items():
            phases[phase].append(seconds)
    for phase, seconds in phases.items():
        yield Metric(
            f"whole.time.{phase}", float(np.mean(seconds)), "s", "lower", tolerance=1.0
        )


@bench
def photos(setting: Setting) -> Iterator[Metric]:
    """Two, three and eight photos: processor time may not grow faster than N."""
    times: dict[int, float] = {}
    for n_photos in (2, 3, 8):
        scenes = list(
            worlds(
                max(1, min(setting.n, 5)), "clean", n_photos=n_photos, baseline_deg=15.0
            )
        )
        run_world(scenes[0])
        outcomes = [run_world(scene) for scene in scenes]
        times[n_photos] = float(np.mean([o.cpu_s for o in outcomes]))
        yield from error_figures(f"photos.{n_photos}", outcomes, 0.5)
        yield Metric(
            f"photos.{n_photos}.processor",
            times[n_photos],
            "s",
            "lower",
            tolerance=0.5,
        )
    for n_photos in (3, 8):
        yield Metric(
            f"photos.{n_photos}.time_over_linear",
            times[n_photos] / times[2] / (n_photos / 2),
            "x",
            "lower",
            1.0,
            0.5,
        )


@bench
def threads(setting: Setting) -> Iterator[Metric]:
    """The answer with one thread and with two, each in its own process."""
    counts = [1, 2] if (os.cpu_count() or 1) >= 2 else [1]
    answers = [
        _probe({"kind": "clean", "threads": n}, NUMBA_NUM_THREADS=str(n))
        for n in counts
    ]
    differ = sum(answer["cameras"] != answers[0]["cameras"] for answer in answers)
    seconds = ", ".join(f"{answer['elapsed_s']:.1f} s" for answer in answers)
    yield Metric(
        "threads.answers_that_differ",
        differ,
        "answers",
        "lower",
        0.0,
        note=f"{counts} threads: {seconds}",
    )


@bench
def large(setting: Setting) -> Iterator[Metric]:
    """Photos of 24 million pixels and a mesh of 2 million faces, in its own process."""
    answers = [
        _probe(
            {
                "kind": "clean",
                "settings": {"width": 6000, "height": 4000},
                "n_faces": 2_000_000,
            }
        )
        for _ in range(max(1, min(setting.n, 3)))
    ]
    # Rough starts are as wide in the photo as at 1,024 px: 6000 / 1024 times the pixels.
    yield from spread(
        "large.time", [a["elapsed_s"] for a in answers], "s", 8.0, tolerance=1.0
    )
    yield from spread(
        "large.peak_memory", [a["peak_gb"] for a in answers], "GB", None, 2.5
    )
    yield from spread(
        "large.error",
        [a["end_px"] for a in answers],
        "px of 6000",
        note=f"start {answers[0]['start_px']:.0f} px; {answers[0]['n_faces']:,} faces; "
        f"processor {answers[0]['cpu_s']:.1f} s; {answers[0]['phases']}",
    )


def _probe(task: dict[str, Any], **environment: str) -> dict[str, Any]:
    """Runs ``tests.bench.probe`` by itself and reads its figures."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.bench.probe", json.dumps(task)],
        cwd=ROOT,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return json.loads(done.stdout.splitlines()[-1])
