"""The report of a refinement: one HTML file that needs no server, to be sent to a colleague."""

import dataclasses
import importlib.metadata
import math
import platform
from collections.abc import Sequence
from typing import Any

from photoreg.formats.mark import COMMENT
from photoreg.geometry.camera import Camera
from photoreg.registration.config import RegistrationConfig
from photoreg.report.comparison_html import SWIPE_STYLE, comparison_html
from photoreg.report.cost_curve import CurvePoint
from photoreg.report.photo_comparison import PhotoComparison
from photoreg.report.templates import rendered
from photoreg.words import number

PROGRAMS = ("photoreg", "numpy", "numba", "opencv-python-headless", "scipy")
WIDTH, HEIGHT, MARGIN = 760, 300, 56


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunReport:
    """What a report says about a refinement."""

    title: str
    subtitle: str
    outcome: str
    """How it ended, and the verdict."""
    warnings: Sequence[str]
    comparisons: Sequence[PhotoComparison]
    left: str
    """What is before in them."""
    elapsed_s: float
    generations: int
    evaluations: int
    errors_px: tuple[float, float] | None = None
    """Mean projection error before and now, where the truth is known."""
    expected_error_px: float | None = None
    costs: tuple[float, float] | None = None
    """Cost before and now, where both were measured."""
    certainty: Sequence[str] = ()
    """How sure the cameras are, and what is open."""
    curve: tuple[CurvePoint, ...] = ()
    photo_names: Sequence[str]
    start: Sequence[Camera]
    """One a photo."""
    cameras: Sequence[Camera]
    """One a photo."""
    unit: str = ""
    """Of the model's coordinates, where that is known."""
    config: RegistrationConfig | None = None


def report_html(run: RunReport) -> str:
    """Pictures, curve, numbers, settings and versions as a page."""
    return rendered(
        "compare.html",
        mark=COMMENT,
        run=run,
        style=SWIPE_STYLE,
        comparison=comparison_html,
        numbers=_numbers(run),
        curve=curve_svg(run.curve),
        cameras=_cameras(run),
        settings=_settings(run.config),
        versions=_versions(),
    )


def _numbers(run: RunReport) -> list[tuple[str, str]]:
    rows = []
    if run.errors_px is not None:
        before, now = run.errors_px
        rows.append(
            (
                "True error (the truth is known here)",
                f"{before:.2f} px before, {now:.2f} px now",
            )
        )
    if run.expected_error_px is not None:
        rows.append(("Expected error", f"{run.expected_error_px:.2f} px"))
    if run.costs is not None:
        before, now = map(number, run.costs)
        rows.append(("Cost", f"{before} before, {now} now"))
    rows += [
        ("Time", f"{run.elapsed_s:.1f} s"),
        ("Generations", f"{run.generations:,}"),
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


def _cameras(run: RunReport) -> list[tuple[str, str]]:
    rows = []
    for name, start, now in zip(run.photo_names, run.start, run.cameras, strict=True):
        for when, camera in (("before", start), ("now", now)):
            # Survey coordinates have seven digits before the point.
            place = ", ".join(f"{value:.10g}" for value in camera.center)
            rows.append(
                (
                    f"{name}, {when}",
                    f"focal length {camera.focal_px:.2f} px; principal point "
                    f"{camera.K[0, 2]:.2f}, {camera.K[1, 2]:.2f} px; stands at "
                    f"{place} {run.unit}".rstrip(),
                )
            )
    return rows


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
