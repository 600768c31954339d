"""The report of the paper's experiment: Markdown, HTML and JSON, with plots."""

import base64
import dataclasses
import html
import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from photoreg.formats.mark import COMMENT, marked_picture
from photoreg.formats.writing import write_files
from photoreg.paper.experiment import MethodRun
from photoreg.paper.report_plots import draw_cost_against_error, draw_error_of_each_run

TABLES: dict[str, tuple[str, str]] = {
    "population": (
        "Table 1: error after the search",
        "The paper ran each size of population ten times.",
    ),
    "beyond": (
        "Past the paper, from the same starts",
        "Levenberg-Marquardt stands for the paper's failed attempt: all colour "
        "differences of the sharp photos from the manual start, without a pyramid. Our "
        "polish starts from the same cameras with blurred photos; the default preset "
        "searches first.",
    ),
    "colour": ("Colour spaces", ""),
    "cost": ("Costs", ""),
    "visibility": (
        "Visibility",
        "Rays and depth buffer are asked at the start and after each restart.",
    ),
    "camera": ("Camera models", ""),
    "first": (
        "First population",
        "Equation 4 ties the focal length to the distance, f / d ~ w / W.",
    ),
    "genetic": (
        "Genetic algorithms",
        "With the same number of cost evaluations.",
    ),
}
"""Title and remark of each table, in the order of the report."""


FIGURES: tuple[str, ...] = ("figure4.svg", "figure8.svg")


@dataclasses.dataclass(frozen=True, eq=False)
class Setup:
    """What the runs have in common."""

    photo_size: tuple[int, int]
    n_faces: int
    samples: int
    generations: int
    restarts: int
    pictures: tuple[tuple[str, bytes], ...]
    """Name and JPEG bytes of each photo."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """One method over its runs."""

    method: str
    n_runs: int
    mean_px: float
    std_px: float
    worst_px: float
    seconds: float
    evaluations: int
    paper: str


def summed_up(runs: Sequence[MethodRun], paper: dict[tuple[str, str], str]) -> dict:
    """The rows of each table: key of the table to its rows."""
    tables: dict[str, list[Row]] = {}
    for key in TABLES:
        of_table = [run for run in runs if run.table == key]
        for method in dict.fromkeys(run.method for run in of_table):
            mine = [run for run in of_table if run.method == method]
            errors = np.array([run.end_px for run in mine])
            tables.setdefault(key, []).append(
                Row(
                    method=method,
                    n_runs=len(mine),
                    mean_px=float(errors.mean()),
                    std_px=float(errors.std()),
                    worst_px=float(errors.max()),
                    seconds=float(np.mean([run.seconds for run in mine])),
                    evaluations=round(np.mean([run.evaluations for run in mine])),
                    paper=paper.get((key, method), ""),
                )
            )
    return tables


def report_files(folder: Path, n_photos: int = 2) -> list[Path]:
    """The files that `write_report` will write, the report first."""
    photos = [f"photo{k}.jpg" for k in range(1, n_photos + 1)]
    names = ["report.html", "report.md", "results.json", *FIGURES, *photos]
    return [folder / name for name in names]


def write_report(
    folder: Path,
    setup: Setup,
    runs: Sequence[MethodRun],
    paper: dict[tuple[str, str], str],
    overwrite: bool = False,
) -> list[Path]:
    """Writes report.md, report.html, results.json and the figures; returns the files.

    Args:
        folder: Where to; it exists.
        setup: What the runs have in common.
        runs: All runs of all methods.
        paper: Table and method to what the paper says of it.
        overwrite: Whether files without photoreg's mark may be replaced.

    Raises:
        InputError: if matplotlib is not installed.
        OutputError: if a file cannot be written, or another is there.
    """
    table_1 = [run for run in runs if run.table == "population"]
    drawings = (draw_error_of_each_run(table_1), draw_cost_against_error(table_1))
    figures = dict(zip(FIGURES, drawings, strict=True))
    tables = summed_up(runs, paper)
    names = [path.name for path in report_files(folder, len(setup.pictures))]
    encoded = [marked_picture(data) for _, data in setup.pictures]
    pictures = dict(zip(names[-len(encoded) :], encoded, strict=True))
    mark = f"<!-- {COMMENT} -->\n"
    contents = {
        "report.html": _html(setup, runs, tables, pictures, figures),
        "report.md": mark + _markdown(setup, runs, tables, list(pictures)),
        "results.json": _json(setup, runs, tables),
        **{name: mark + svg for name, svg in figures.items()},
        **pictures,
    }
    return write_files(
        {folder / name: content for name, content in contents.items()},
        overwrite=overwrite,
    )


def correlations(runs: Sequence[MethodRun]) -> tuple[float, float]:
    """Correlation of cost and error: of the runs' ends, and of their ways (of logs)."""
    ends = np.array([(run.cost, run.end_px) for run in runs])
    ways = np.array([point for run in runs for point in run.path])
    return _correlation(ends), _correlation(np.log(ways))


def _correlation(pairs: np.ndarray) -> float:
    if len(pairs) < 2 or (pairs.std(axis=0) == 0.0).any():
        return float("nan")
    return float(np.corrcoef(pairs.T)[0, 1])


def _introduction(setup: Setup, runs: Sequence[MethodRun]) -> list[str]:
    starts = [run.start_px for run in runs]
    width, height = setup.photo_size
    return [
        "The experiment of Jankó and Chetverikov, “Photo-Consistency Based Registration "
        "of an Uncalibrated Image Pair to a 3D Surface Model Using Genetic Algorithm” "
        "(3DPVT 2004), on a shell of our own: the paper's Shell with its synthetic "
        "texture is not public.",
        f"Two photos of {width} x {height} pixels, {setup.n_faces:,} faces, "
        f"{setup.samples:,} surface points, {setup.restarts} x {setup.generations} "
        "generations. Each run starts from other manual cameras, "
        f"{min(starts):.1f} to {max(starts):.1f} px off and inside the paper's gene "
        "intervals; all methods share the starts. Error: the paper's equation 5, in "
        "pixels.",
        f"Measured on {platform.machine()} with {os.cpu_count()} processor cores, "
        f"{platform.system()}, Python {platform.python_version()}.",
    ]


def _table_1(runs: Sequence[MethodRun]) -> tuple[list[str], list[list[str]]]:
    """Error of each run: before, by each size of population, by the default preset."""
    columns: dict[str, dict[int, float]] = {
        "manual start": {run.run: run.start_px for run in runs}
    }
    for run in runs:
        if run.table == "population" or run.method == "default preset":
            columns.setdefault(run.method, {})[run.run] = run.end_px
    numbers = sorted({number for column in columns.values() for number in column})
    rows = [
        [str(number), *(f"{column[number]:.2f}" for column in columns.values())]
        for number in numbers
    ]
    means = [float(np.mean(list(column.values()))) for column in columns.values()]
    rows.append(["mean", *(f"{mean:.2f}" for mean in means)])
    return ["run", *columns], rows


HEADER = (
    *("method", "runs", "mean px", "± px", "worst px", "s", "evaluations"),
    "the paper",
)


def _cells(row: Row) -> list[str]:
    return [
        row.method,
        str(row.n_runs),
        f"{row.mean_px:.2f}",
        f"{row.std_px:.2f}",
        f"{row.worst_px:.2f}",
        f"{row.seconds:.1f}",
        f"{row.evaluations:,}" if row.evaluations else "-",
        row.paper,
    ]


def _correlation_text(runs: Sequence[MethodRun]) -> str:
    ends, ways = correlations([run for run in runs if run.table == "population"])
    return (
        f"Correlation of cost and error: {ends:.2f} over the ends of the runs, {ways:.2f} "
        "over the best individuals on the way (of the logarithms). The paper: clearly "
        "correlated."
    )


def _markdown(
    setup: Setup, runs: Sequence[MethodRun], tables: dict, pictures: Sequence[str]
) -> str:
    parts = ["# The paper's experiment, reproduced", *_introduction(setup, runs)]
    parts.append(" ".join(f"![{name}]({name})" for name in pictures))
    for key, rows in tables.items():
        title, remark = TABLES[key]
        parts.append(f"## {title}")
        if remark:
            parts.append(remark)
        parts.append(_markdown_table(HEADER, [_cells(row) for row in rows]))
        if key == "population":
            parts += [
                _markdown_table(*_table_1(runs)),
                "## Figure 4: error of each run",
                "![Error of each run](figure4.svg)",
                "## Figure 8: cost against error",
                "![Cost against error](figure8.svg)",
                _correlation_text(runs),
            ]
    return "\n\n".join(parts) + "\n"


def _markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1d2329; background: #fff;
       max-width: 60rem; margin: 2.5rem auto; padding: 0 1.5rem; }
h1 { font-size: 1.7rem; margin-bottom: .5rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; }
p { max-width: 46rem; margin: .5rem 0; }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .8rem; text-align: right; border-bottom: 1px solid #dfe4e8; }
th { font-weight: 600; color: #55606a; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
table.methods th:last-child, table.methods td:last-child { text-align: left; }
table.runs tr:last-child td { font-weight: 600; border-bottom: none; }
.photos { display: flex; gap: 1rem; margin: 1rem 0; }
.photos img { width: calc(50% - .5rem); border-radius: 4px; }
figure { margin: 0; } figure svg { max-width: 100%; height: auto; }
"""


def _html(
    setup: Setup,
    runs: Sequence[MethodRun],
    tables: dict,
    pictures: dict[str, bytes],
    figures: dict[str, str],
) -> str:
    parts = ["<h1>The paper's experiment, reproduced</h1>"]
    parts += [f"<p>{html.escape(text)}</p>" for text in _introduction(setup, runs)]
    images = "".join(
        f'<img alt="{html.escape(name)}" src="data:image/jpeg;base64,'
        f'{base64.b64encode(data).decode()}">'
        for name, data in pictures.items()
    )
    parts.append(f'<div class="photos">{images}</div>')
    for key, rows in tables.items():
        title, remark = TABLES[key]
        parts.append(f"<h2>{html.escape(title)}</h2>")
        if remark:
            parts.append(f"<p>{html.escape(remark)}</p>")
        cells = [_cells(row) for row in rows]
        parts.append(_html_table(HEADER, cells, "methods"))
        if key == "population":
            parts += [
                _html_table(*_table_1(runs), "runs"),
                "<h2>Figure 4: error of each run</h2>",
                f"<figure>{figures['figure4.svg']}</figure>",
                "<h2>Figure 8: cost against error</h2>",
                f"<figure>{figures['figure8.svg']}</figure>",
                f"<p>{html.escape(_correlation_text(runs))}</p>",
            ]
    body = "\n".join(parts)
    return (
        f"<!doctype html>\n<!-- {COMMENT} -->\n"
        '<html lang="en"><head><meta charset="utf-8">'
        "<title>The paper's experiment, reproduced</title>"
        f"<style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def _html_table(header: Sequence[str], rows: Sequence[Sequence[str]], kind: str) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    lines = (
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    return f'<table class="{kind}"><tr>{head}</tr>\n' + "\n".join(lines) + "\n</table>"


def _json(setup: Setup, runs: Sequence[MethodRun], tables: dict) -> str:
    common = dataclasses.asdict(setup)
    common["pictures"] = [name for name, _ in setup.pictures]
    ends, ways = correlations([run for run in runs if run.table == "population"])
    figures = {
        "format": "photoreg-results",
        "setup": common,
        "correlation": {"ends": ends, "ways": ways},
        "tables": {
            key: [dataclasses.asdict(row) for row in rows]
            for key, rows in tables.items()
        },
        "runs": [dataclasses.asdict(run) for run in runs],
    }
    # JSON knows no NaN: a correlation of one run is null.
    return json.dumps(_without_nan(figures), indent=1) + "\n"


def _without_nan(value: object) -> object:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
