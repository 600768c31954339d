"""Measures photoreg: `python -m tests.bench [NAME ...] [--data FOLDER] [--gate]`.

Prints a table; with --json writes it to a file. --gate ends with status 1 where a
figure is worse than the committed baseline beyond its tolerance; --update-baseline
writes the baseline, deliberately.
"""

import dataclasses
import json
import platform
import sys
import time
from pathlib import Path
from typing import Annotated

import numba
import rich.console
import rich.table
import tyro

from tests.bench import accuracy, calibration, kernel, optimisers, resection, speed
from tests.bench.metrics import (
    BENCHES,
    Metric,
    Setting,
    load_baseline,
    save_baseline,
)

__all__ = ["accuracy", "calibration", "kernel", "optimisers", "resection", "speed"]


def main(
    names: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
    /,
    *,
    data: Path | None = None,
    n: int = 20,
    json_path: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    gate: bool = False,
    update_baseline: bool = False,
) -> int:
    """Run the benches.

    Args:
        names: Benches to run; all of them when none is named.
        data: A folder of real sets, each with mesh, photos/, cameras.json, starts/.
        n: Scenes and starts per figure.
        json_path: Where to write the figures.
        gate: End with status 1 where a figure regressed against the baseline.
        update_baseline: Write the figures into the committed baseline.
    """
    unknown = [name for name in names if name not in BENCHES]
    if unknown:
        print(f"No bench {', '.join(unknown)}; there are {', '.join(BENCHES)}.")
        return 2
    baseline = load_baseline()
    console = rich.console.Console(width=130, highlight=False)
    metrics: list[Metric] = []
    for name in names or BENCHES:
        began = time.perf_counter()
        found = list(BENCHES[name](Setting(data, n)))
        metrics += found
        if found:
            title = f"{name} ({time.perf_counter() - began:.0f} s)"
            console.print(_table(title, found, baseline))
    machine = (
        f"{platform.machine()}, {numba.get_num_threads()} threads, Python "
        f"{platform.python_version()}, numba {numba.__version__}"
    )
    console.print(machine)
    if json_path is not None:
        figures = [dataclasses.asdict(metric) for metric in metrics]
        json_path.write_text(
            json.dumps({"machine": machine, "metrics": figures}, indent=1) + "\n"
        )
    if update_baseline:
        save_baseline(metrics)
    regressed = [
        metric
        for metric in metrics
        if metric.name in baseline and metric.regressed(baseline[metric.name])
    ]
    for metric in regressed:
        was = baseline[metric.name]
        console.print(f"Regressed: {metric.name} {was:.4g} -> {metric.value:.4g}")
    return 1 if gate and regressed else 0


def _table(
    title: str, metrics: list[Metric], baseline: dict[str, float]
) -> rich.table.Table:
    table = rich.table.Table(
        "figure", "value", "unit", "bar", "", "baseline", "note", title=title
    )
    for metric in metrics:
        sign = "<=" if metric.better == "lower" else ">="
        table.add_row(
            metric.name,
            f"{metric.value:.4g}",
            metric.unit,
            "" if metric.bar is None else f"{sign} {metric.bar:g}",
            {None: "", True: "reached", False: "missed"}[metric.reached],
            f"{baseline[metric.name]:.4g}" if metric.name in baseline else "",
            metric.note,
        )
    return table


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
