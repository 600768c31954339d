"""Tab 3, Refine: start, watch, stop, accept or revert; and the overlay beside it."""

from typing import Any

import numpy as np
import viser
import viser.uplot

from app.bus import Bus
from app.conductor import Conductor
from app.controls import guarded, number, put, put_value
from app.run import Run
from app.session import setting
from app.state import State
from app.styles import PHOTO_STYLES
from app.widgets import Choice
from photoreg.presets import PresetName

PRESETS: dict[str, PresetName] = {
    "Standard": "default",
    "Quick": "fast",
    "Thorough": "thorough",
    "As in the paper": "paper",
}
PRESET_HELP: dict[PresetName, str] = {
    "default": "Search, then polish: right for most starts.",
    "fast": "A short search and polish, for a first look.",
    "thorough": "A wider search, for very rough starts.",
    "paper": "The genetic algorithm of the paper alone, as published.",
}
INK, GRID = "#98a2b3", "rgba(128,140,155,.18)"
NO_DOTS: Any = {"show": False}
SERIES: tuple[viser.uplot.Series, ...] = (
    {"label": "step"},
    {"label": "best", "stroke": "#2dbeaf", "width": 2.5, "points": NO_DOTS},
    {"label": "median", "stroke": INK, "width": 1.2, "dash": (5, 4), "points": NO_DOTS},
)
EMPTY_CURVE = (np.array([0.0, 1.0]), np.full(2, np.nan), np.full(2, np.nan))
EMPTY_PICTURE = np.full((480, 640, 3), 38, dtype=np.uint8)


class RefinePanel:
    """Controls of the Refine tab."""

    def __init__(self, gui: viser.GuiApi, conductor: Conductor) -> None:
        session = conductor.session
        gui.add_markdown(
            "Moves all cameras together until the photos agree over the whole surface."
        )
        self._preset = gui.add_dropdown("Thoroughness", tuple(PRESETS))
        self._preset_help = gui.add_markdown("")
        self._start = gui.add_button("Refine", icon=viser.Icon.PLAYER_PLAY)
        self._stop = gui.add_button(
            "Stop and keep the best",
            icon=viser.Icon.PLAYER_STOP,
            color="red",
            visible=False,
        )
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._text = gui.add_markdown("")
        self._accept = gui.add_button(
            "Accept", icon=viser.Icon.CHECK, color="teal", visible=False
        )
        self._revert = gui.add_button(
            "Revert", icon=viser.Icon.ARROW_BACK_UP, color="gray", visible=False
        )

        @self._preset.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(preset=PRESETS[self._preset.value]))

        @self._start.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            conductor.refine()

        @self._stop.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            conductor.stop()

        @self._accept.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            conductor.accept()

        @self._revert.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            conductor.revert()

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        run = state.run
        idle, review = run.status == "idle", run.status == "review"
        preset = next(k for k, v in PRESETS.items() if v == state.preset)
        put_value(self._preset, preset)
        put(self._preset, "disabled", not idle)
        put(self._preset_help, "content", f"*{PRESET_HELP[state.preset]}*")
        put(self._start, "visible", idle)
        ready = state.document.mesh is not None and len(state.document.used) > 1
        put(self._start, "disabled", not ready or state.job is not None)
        put(self._stop, "visible", run.is_active)
        put(self._stop, "disabled", run.status == "stopping")
        put(self._bar, "visible", run.is_active)
        put_value(self._bar, round(100.0 * run.fraction, 1))
        put(self._accept, "visible", review)
        put(self._revert, "visible", review)
        put(self._text, "content", _report(state, ready))


def _report(state: State, ready: bool) -> str:
    run = state.run
    if run.status == "idle":
        if not ready:
            return "A mesh and two photos are needed. Load them in the Data tab."
        if run.error_px is not None:
            return (
                f"True error now: **{run.error_px:.2f} px** (the truth is known here)."
            )
        return ""
    rows = []
    if run.start_error_px is not None and run.error_px is not None:
        rows.append(
            ("True error", f"{run.start_error_px:.2f}", f"{run.error_px:.2f} px")
        )
    if run.start_cost is not None and run.cost is not None:
        rows.append(("Cost", number(run.start_cost), number(run.cost)))
    elif run.curve:
        rows.append(("Cost", "100 %", f"{number(100 * run.curve[-1].best)} %"))
    table = ""
    if rows:
        table = "\n\n| | start | now |\n|:--|--:|--:|\n" + "\n".join(
            f"| {name} | {before} | **{after}** |" for name, before, after in rows
        )
    if run.status == "review":
        warnings = "".join(f"\n\n⚠ {warning}" for warning in run.warnings)
        took = f" {run.elapsed_s:.1f} s." if run.elapsed_s > 0 else ""
        return f"**{run.outcome}**{took}{table}{warnings}\n\nKeep these cameras?"
    return f"{_step(run)}{table}"


def _step(run: Run) -> str:
    words = (run.step or "Starting")[:1].upper() + (run.step or "Starting")[1:]
    return f"{words} · {run.elapsed_s:.1f} s · {run.evaluations:,} evaluations"


class OverlayPanel:
    """The panel on the left: the overlay picture and the cost curve."""

    def __init__(self, gui: viser.GuiApi, conductor: Conductor, bus: Bus) -> None:
        self._conductor = conductor
        self._shown: bytes | None = None
        self._curve: object = ()
        session = conductor.session
        self._caption = gui.add_markdown("")
        self._image = gui.add_image(EMPTY_PICTURE, format="jpeg")
        self._styles = Choice(
            gui,
            bus,
            "As",
            PHOTO_STYLES,
            lambda _, value: session.change(None, setting(overlay_style=value)),
        )
        self._plot = gui.add_uplot(
            EMPTY_CURVE,
            SERIES,
            title="Cost relative to the start, by step",
            scales={"x": {"time": False}, "y": {"distr": 3}},
            axes=(
                {"stroke": INK, "grid": {"stroke": GRID}},
                {"stroke": INK, "grid": {"stroke": GRID}, "ticks": NO_DOTS, "size": 58},
            ),
            legend={"show": False},
            padding=(10, 14, 0, 0),
            height=210,
            visible=False,
        )

    def show(self, state: State) -> None:
        """Makes the picture and the curve as ``state`` has them."""
        used = state.document.used
        caption = "Two photos in use are needed for an overlay."
        if len(used) > 1 and state.document.mesh is not None:
            onto = state.overlay_onto
            source = used[(onto + 1) % len(used)]
            caption = (
                f"**{source.name}** carried over the surface onto **{used[onto].name}**"
            )
            if state.run.error_px is not None:
                caption += f" · true error **{state.run.error_px:.2f} px**"
        put(self._caption, "content", caption)
        self._styles.show(state.overlay_style)
        picture = self._conductor.picture
        if picture is not None and picture is not self._shown:
            self._shown = picture
            # The worker has made a JPEG already; the public setter takes pixels and
            # would encode them again, on the thread that serves the page.
            self._image._data = picture
        curve = state.run.curve
        if curve is not self._curve:
            self._curve = curve
            put(self._plot, "visible", len(curve) > 1)
            if len(curve) > 1:
                self._plot.data = (
                    np.array([float(point.step) for point in curve]),
                    np.array([point.best for point in curve]),
                    np.array([point.median for point in curve]),
                )
