"""Measures photoreg: `python -m tests.bench [NAME ...] [--data FOLDER] [--gate]`.

Prints a table; --json writes it to a file, --markdown prints it for the README. --gate
ends with status 1 where a figure is worse than the committed baseline beyond its
tolerance; --update-baseline writes the baseline, deliberately. Three scenes a figure and
a quarter of an hour are the default; the README's figures are those of
`--n 20 --minutes 0`.
"""

import dataclasses
import json
import platform
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numba
import rich.console
import rich.table
import tyro

from tests.bench import (
    accuracy,
    big,
    calibration,
    kernel,
    lenses,
    one_photo,
    optimisers,
    page,
    photos,
    placing,
    refine_page,
    resection,
    speed,
    texture,
    third_view,
    verdicts,
    way,
)
from tests.bench.metrics import (
    BENCHES,
    Metric,
    Setting,
    load_baseline,
    save_baseline,
)

__all__ = [
    "accuracy",
    "big",
    "calibration",
    "kernel",
    "lenses",
    "one_photo",
    "optimisers",
    "page",
    "photos",
    "placing",
    "refine_page",
    "resection",
    "speed",
    "texture",
    "third_view",
    "verdicts",
    "way",
]


def main(
    names: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
    /,
    *,
    data: Path | None = None,
    n: int = 3,
    minutes: float = 15.0,
    markdown: bool = False,
    json_path: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    gate: bool = False,
    update_baseline: bool = False,
) -> int:
    """Run the benches.

    Args:
        names: Benches to run; all of them when none is named.
        data: A folder of real sets, each with mesh, photos/, cameras.json, starts/.
        n: Scenes and starts per figure.
        minutes: Begin no further bench after so many minutes; 0: run all of them.
        markdown: Print the figures once more as a Markdown table.
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
    first = time.perf_counter()
    for name in names or BENCHES:
        began = time.perf_counter()
        if 0.0 < 60.0 * minutes < began - first:
            console.print(
                f"{name}: left out, because {minutes:g} minutes are over; --minutes 0 "
                "runs all."
            )
            continue
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
    if markdown:
        print(markdown_table(metrics))
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


def markdown_table(metrics: Sequence[Metric]) -> str:
    """The figures as a Markdown table, one row a figure."""
    rows = ["| figure | value | bar | | |", "|---|---|---|---|---|"]
    for metric in metrics:
        sign = "≤" if metric.better == "lower" else "≥"
        bar = "" if metric.bar is None else f"{sign} {metric.bar:g}"
        verdict = {None: "", True: "reached", False: "**missed**"}[metric.reached]
        note = metric.note.replace("|", "/")
        rows.append(
            f"| {metric.name} | {metric.value:.3g} {metric.unit} | {bar} | {verdict} | "
            f"{note} |"
        )
    return "\n".join(rows)


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
