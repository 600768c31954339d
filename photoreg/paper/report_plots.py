"""The figures of the report, drawn by matplotlib as SVG text."""

import io
from collections.abc import Sequence
from typing import Any

from photoreg.errors import InputError
from photoreg.paper.experiment import MethodRun

PAPER_MEANS_PX = (6.54, 5.63)
"""Mean errors of the paper's Table 1, with 500 and with 1,000 individuals."""

_COLOURS = ("#2f6db3", "#d5762c", "#4b8f5c", "#8a5aa8")


def check_plots() -> None:
    """Asks for matplotlib, before hours of runs rather than after.

    Raises:
        InputError: if it is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError(
            "The report's figures need matplotlib, which is not installed; install it "
            "by `pip install 'photoreg[report]'`."
        ) from error


def draw_error_of_each_run(runs: Sequence[MethodRun]) -> str:
    """Figure 4: projection error of each run, a line for each size of population."""
    figure, axes = _figure(7.2, 3.4)
    for k, (method, mine) in enumerate(_by_method(runs).items()):
        colour = _COLOURS[k % len(_COLOURS)]
        numbers = [run.run for run in mine]
        errors = [run.end_px for run in mine]
        axes.plot(numbers, errors, "o-", color=colour, label=method, markersize=5)
        if k < len(PAPER_MEANS_PX):
            axes.axhline(
                PAPER_MEANS_PX[k],
                color=colour,
                linestyle="--",
                linewidth=1,
                alpha=0.7,
                label=f"the paper's mean, {PAPER_MEANS_PX[k]:.2f} px",
            )
    axes.set_xlabel("run")
    axes.set_ylabel("projection error (px)")
    axes.set_xticks(sorted({run.run for run in runs}))
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.01, 1))
    return _svg(figure)


def draw_cost_against_error(runs: Sequence[MethodRun]) -> str:
    """Figure 8: cost against projection error, of the ends and on the way."""
    figure, axes = _figure(7.2, 4.2)
    for k, (method, mine) in enumerate(_by_method(runs).items()):
        colour = _COLOURS[k % len(_COLOURS)]
        way = [point for run in mine for point in run.path]
        axes.scatter(
            [cost for cost, _ in way],
            [error for _, error in way],
            s=16,
            color=colour,
            alpha=0.4,
            linewidths=0,
            label=f"{method}: best on the way",
        )
        axes.scatter(
            [run.cost for run in mine],
            [run.end_px for run in mine],
            s=34,
            color=colour,
            edgecolors="white",
            linewidths=0.6,
            label=f"{method}: end",
            zorder=3,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("cost (squared colour difference)")
    axes.set_ylabel("projection error (px)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(_few_labels())
    axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.01, 1))
    return _svg(figure)


def _few_labels() -> Any:
    """Labels 2 and 5 of each decade; a log axis of one decade has no others."""
    from matplotlib.ticker import FuncFormatter

    def label(value: float, _: object) -> str:
        text = f"{value:g}"
        return text if text.strip("0.")[:1] in ("2", "5") else ""

    return FuncFormatter(label)


def _by_method(runs: Sequence[MethodRun]) -> dict[str, list[MethodRun]]:
    groups: dict[str, list[MethodRun]] = {}
    for run in runs:
        groups.setdefault(run.method, []).append(run)
    return groups


def _figure(width: float, height: float) -> tuple[Any, Any]:
    """A figure without pyplot: no windows, no global state."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e6eaee", linewidth=0.8)
    axes.set_axisbelow(True)
    return figure, axes


def _svg(figure: Any) -> str:
    """The figure as an <svg> element, the same for the same runs."""
    import matplotlib

    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "photoreg", "svg.fonttype": "none"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
