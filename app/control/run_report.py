"""The report of a run: one HTML file that needs no server, to be sent to a colleague."""

import dataclasses
import importlib.metadata
import math
import platform
import string
from typing import Any

from app.control.comparison_html import SWIPE_STYLE, comparison_html
from app.model.formatting import number
from app.model.markup import escaped
from app.model.pictures import Compared
from app.model.run import CurvePoint, Run
from app.model.scene_files import static_folder
from app.model.state import State
from photoreg.registration.config import RegistrationConfig

PROGRAMS = ("photoreg", "numpy", "numba", "opencv-python-headless", "scipy")
WIDTH, HEIGHT, MARGIN = 760, 300, 56


def report_html(state: State, compared: Compared) -> str:
    """The run on screen: pictures, curve, numbers, settings and versions."""
    run = state.run
    left = f"run {state.compared_with}" if state.compared_with else "start"
    mesh = state.document.mesh
    template, script = (
        (static_folder() / name).read_text(encoding="utf-8")
        for name in ("compare.html", "compare.js")
    )
    pictures = "".join(
        f"<h3>{escaped(photo.carried)} projected onto "
        f"{escaped(photo.name)}</h3>" + comparison_html(photo, left)
        for photo in compared.photos
    )
    return string.Template(template).substitute(
        title=escaped(f"Run {run.number}: {', '.join(run.photo_names)}"),
        subtitle=escaped(
            f"{mesh.name if mesh is not None else ''} · {run.began} · "
            f"{run.settings_name}"
        ),
        outcome=escaped(f"{run.outcome} {run.verdict}"),
        warnings=_list([f"⚠ {warning}" for warning in run.warnings]),
        style=SWIPE_STYLE,
        script=script,
        pictures=pictures,
        numbers=_rows(_numbers(run)),
        certainty=_list([*run.standard_errors, *run.undetermined])
        or "<p>No polish ran, so nothing is known of it.</p>",
        curve=curve_svg(run.curve),
        cameras=_cameras(run),
        settings=_rows(_settings(run.config)),
        versions=_rows(_versions()),
    )


def _numbers(run: Run) -> list[tuple[str, str]]:
    rows = []
    if run.start_error_px is not None and run.error_px is not None:
        rows.append(
            (
                "True error (the truth is known here)",
                f"{run.start_error_px:.2f} px before, {run.error_px:.2f} px now",
            )
        )
    if run.expected_error_px is not None:
        rows.append(("Expected error", f"{run.expected_error_px:.2f} px"))
    if run.start_cost is not None and run.cost is not None:
        rows.append(
            ("Cost", f"{number(run.start_cost)} before, {number(run.cost)} now")
        )
    rows += [
        ("Time", f"{run.elapsed_s:.1f} s"),
        ("Generations", f"{run.generation:,}"),
        ("Evaluations", f"{run.evaluations:,}"),
    ]
    return rows


def _settings(config: RegistrationConfig | None) -> list[tuple[str, str]]:
    def flat(value: Any, path: str) -> list[tuple[str, str]]:
        if not dataclasses.is_dataclass(value):
            return [(path, f"{value:.6g}" if isinstance(value, float) else str(value))]
        rows = []
        for field in dataclasses.fields(value):
            name = f"{path}.{field.name}" if path else field.name
            rows += flat(getattr(value, field.name), name)
        return rows

    return [] if config is None else flat(config, "")


def _versions() -> list[tuple[str, str]]:
    rows = [
        ("Python", platform.python_version()),
        ("System", f"{platform.system()} {platform.machine()}"),
    ]
    for name in PROGRAMS:
        try:
            rows.append((name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            continue
    return rows


def _cameras(run: Run) -> str:
    rows = []
    for name, start, now in zip(run.photo_names, run.start, run.cameras, strict=True):
        for when, camera in (("before", start), ("now", now)):
            # Survey coordinates have seven digits before the point.
            x, y, z = (f"{value:.10g}" for value in camera.center)
            rows.append(
                (
                    f"{name}, {when}",
                    f"focal length {camera.focal_px:.2f} px; principal point "
                    f"{camera.K[0, 2]:.2f}, {camera.K[1, 2]:.2f} px; stands at "
                    f"{x}, {y}, {z}",
                )
            )
    return _rows(rows)


def _rows(rows: list[tuple[str, str]]) -> str:
    body = "".join(
        f"<tr><th>{escaped(name)}</th><td>{escaped(value)}</td></tr>"
        for name, value in rows
    )
    return f"<table>{body}</table>"


def _list(sentences: list[str]) -> str:
    if not sentences:
        return ""
    return "<ul>" + "".join(f"<li>{escaped(s)}</li>" for s in sentences) + "</ul>"


def curve_svg(curve: tuple[CurvePoint, ...]) -> str:
    """The cost curve on a log scale, with restarts and polish levels marked."""
    points = [point for point in curve if point.best > 0.0]
    if len(points) < 2:
        return "<p>The run was too short for a curve.</p>"
    highest = max(max(p.best, p.median, p.high or 0.0) for p in points)
    top = math.ceil(math.log10(highest) - 1e-9)
    bottom = min(top - 1, math.floor(math.log10(min(p.best for p in points))))
    last = max(points[-1].step, 1)

    def x(point: CurvePoint) -> float:
        return MARGIN + (WIDTH - MARGIN - 12) * point.step / last

    def y(cost: float) -> float:
        share = (math.log10(cost) - bottom) / (top - bottom)
        return HEIGHT - 34 - (HEIGHT - 50) * share

    def line(costs: list[tuple[CurvePoint, float]], css: str) -> str:
        path = " ".join(f"{x(p):.1f},{y(c):.1f}" for p, c in costs if c > 0.0)
        return f'<polyline class="{css}" points="{path}"/>'

    parts = [
        f'<line class="grid" x1="{MARGIN}" x2="{WIDTH - 12}" y1="{y(10.0**k):.1f}" '
        f'y2="{y(10.0**k):.1f}"/><text x="{MARGIN - 8}" y="{y(10.0**k) + 4:.1f}" '
        f'text-anchor="end">{100 * 10.0**k:g} %</text>'
        for k in range(bottom, top + 1)
    ]
    for css, mark in (("restart", "restart"), ("level", "level")):
        parts += [
            f'<line class="{css}" x1="{x(p):.1f}" x2="{x(p):.1f}" y1="16" '
            f'y2="{HEIGHT - 34}"/>'
            for p in points
            if p.mark == mark
        ]
    parts += [
        line([(p, p.low) for p in points if p.low is not None], "spread"),
        line([(p, p.high) for p in points if p.high is not None], "spread"),
        line([(p, p.median) for p in points], "median"),
        line([(p, p.best) for p in points], "best"),
        f'<text x="{WIDTH / 2}" y="{HEIGHT - 8}" text-anchor="middle">step of search '
        f"and polish, to {last}</text>",
    ]
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="Cost by step">'
        f"{''.join(parts)}</svg>"
    )
