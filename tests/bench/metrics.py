"""What a bench measures: figures with a unit, a direction and a tolerance."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

BASELINE = Path(__file__).with_name("baseline.json")


@dataclasses.dataclass(frozen=True)
class Metric:
    """One figure of a bench."""

    name: str
    """Dotted: bench.what.statistic."""
    value: float
    unit: str
    better: Literal["lower", "higher"]
    bar: float | None = None
    """The figure to reach; None where there is none."""
    tolerance: float = 0.25
    """Relative change against the baseline that is still noise. Loose for times,
    because machines are noisy; tight for errors and ratios."""
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the bar is reached; None where there is none."""
        if self.bar is None:
            return None
        if self.better == "lower":
            return self.value <= self.bar
        return self.value >= self.bar

    def regressed(self, baseline: float) -> bool:
        """Whether the value is worse than the baseline by more than the tolerance."""
        slack = self.tolerance * abs(baseline)
        if self.better == "lower":
            return not self.value <= baseline + slack
        return not self.value >= baseline - slack


def spread(
    name: str,
    values: Sequence[float] | np.ndarray,
    unit: str,
    mean_bar: float | None = None,
    worst_bar: float | None = None,
    tolerance: float = 0.25,
    note: str = "",
) -> Iterator[Metric]:
    """Mean, standard deviation and worst of values where lower is better."""
    array = np.asarray(values, dtype=np.float64)
    count = f"n={array.size}" + (f"; {note}" if note else "")
    yield Metric(
        f"{name}.mean", float(array.mean()), unit, "lower", mean_bar, tolerance, count
    )
    yield Metric(
        f"{name}.std", float(array.std()), unit, "lower", None, 4 * tolerance, count
    )
    yield Metric(
        f"{name}.worst",
        float(array.max()),
        unit,
        "lower",
        worst_bar,
        2 * tolerance,
        count,
    )


@dataclasses.dataclass(frozen=True)
class Setting:
    """What every bench is told."""

    data: Path | None
    """Folder of real sets with true cameras; None: those benches are left out."""
    n: int
    """Scenes and starts per figure."""


Bench = Callable[[Setting], Iterator[Metric]]

BENCHES: dict[str, Bench] = {}


def bench(function: Bench) -> Bench:
    """Registers a bench under its function's name."""
    BENCHES[function.__name__] = function
    return function


def load_baseline() -> dict[str, float]:
    """The committed figures by name; empty when there are none yet."""
    if not BASELINE.exists():
        return {}
    return json.loads(BASELINE.read_text(encoding="utf-8"))


def save_baseline(metrics: Sequence[Metric]) -> None:
    """Writes these figures over those of the same name."""
    figures = {
        **load_baseline(),
        **{metric.name: round(metric.value, 6) for metric in metrics},
    }
    BASELINE.write_text(
        json.dumps(figures, indent=1, sort_keys=True) + "\n", encoding="utf-8"
    )
