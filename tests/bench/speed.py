"""How long a refinement takes, where the time goes, and that threads change nothing."""

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from tests.bench.metrics import Metric, Setting, bench, spread
from tests.bench.outcomes import run_world
from tests.bench.worlds import world, worlds


@bench
def whole(setting: Setting) -> Iterator[Metric]:
    """The default preset, compiled, and its seconds by phase."""
    run_world(world("clean", 0))
    outcomes = [run_world(w) for w in worlds(setting.n, "clean")]
    times = [outcome.elapsed_s for outcome in outcomes]
    yield from spread("whole.time", times, "s", 4.0, tolerance=1.0)
    phases: dict[str, list[float]] = defaultdict(list)
    for outcome in outcomes:
        for phase, seconds in outcome.finished.seconds_by_phase.items():
            phases[phase].append(seconds)
    for phase, seconds in phases.items():
        yield Metric(
            f"whole.time.{phase}", float(np.mean(seconds)), "s", "lower", tolerance=1.0
        )
