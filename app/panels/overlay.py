"""The panel on the left: the overlay while a run goes on, before and after once it ended."""

from typing import Any

import numpy as np
import viser
import viser.uplot

from app.control.controller import Controller
from app.model.markup import escaped
from app.model.pictures import Compared, Surface
from app.model.session import setting
from app.model.state import State
from app.web.bridge import Bridge
from app.web.controls import guarded, put, put_jpeg, put_value
from app.web.styles import PHOTO_STYLES
from app.web.widgets import Choice
from photoreg.report.comparison_html import SWIPE_STYLE, comparison_html
from photoreg.report.cost_curve import CurvePoint

SURFACES: dict[str, Surface] = {
    "Photos": "photos",
    "Heat map": "disagreement",
    "Clay": "clay",
}
INK, GRID = "#98a2b3", "rgba(128,140,155,.18)"
BEST, SPREAD, RESTART, LEVEL = "#2dbeaf", "rgba(128,140,155,.35)", "#e8a33d", "#b07cd8"
NO_DOTS: Any = {"show": False}


def dots(colour: str) -> Any:
    """Points of the plot in one colour."""
    return {"show": True, "size": 7, "fill": colour, "stroke": colour}


SERIES: tuple[viser.uplot.Series, ...] = (
    {"label": "step"},
    {"label": "best", "stroke": BEST, "width": 2.5, "points": NO_DOTS},
    {"label": "median", "stroke": INK, "width": 1.2, "dash": (5, 4), "points": NO_DOTS},
    {"label": "lower quartile", "stroke": SPREAD, "width": 1, "points": NO_DOTS},
    {"label": "upper quartile", "stroke": SPREAD, "width": 1, "points": NO_DOTS},
    {"label": "restart", "stroke": RESTART, "width": 0, "points": dots(RESTART)},
    {"label": "level", "stroke": LEVEL, "width": 0, "points": dots(LEVEL)},
)
CAPTION = "margin:0 13px 8px;font-size:13.5px;line-height:1.35;overflow-wrap:anywhere"
EMPTY_CURVE = (np.array([0.0, 1.0]), *[np.full(2, np.nan)] * 6)
EMPTY_PICTURE = np.full((480, 640, 3), 38, dtype=np.uint8)
KEY = (
    '<div style="margin:0 14px 8px;font-size:11.5px;opacity:.85;display:flex;'
    'flex-wrap:wrap;gap:0 9px;white-space:nowrap">'
    f'<span><span style="color:{BEST}">━</span> best</span><span>┅ median</span>'
    f'<span>─ quartiles</span><span><span style="color:{RESTART}">●</span> restart</span>'
    f'<span><span style="color:{LEVEL}">●</span> polish level</span></div>'
)


class OverlayPanel:
    """Overlay, cost curve, and the comparison of a run that has ended."""

    def __init__(
        self, gui: viser.GuiApi, controller: Controller, bridge: Bridge
    ) -> None:
        self._shown: bytes | None = None
        self._compared: tuple[Compared, int] | None = None
        self._curve: object = ()
        session = controller.session
        self._caption = gui.add_html("")
        self._image = gui.add_image(EMPTY_PICTURE, format="jpeg")
        self._comparison = gui.add_html("", visible=False)
        self._styles = Choice(
            gui,
            bridge,
            "Style",
            PHOTO_STYLES,
            lambda _, value: session.change(None, setting(overlay_style=value)),
        )
        self._swipe = gui.add_checkbox(
            "Against the start",
            False,
            hint="The start left of a line, now right of it.",
        )
        self._line = gui.add_slider(
            "Line",
            0.0,
            1.0,
            0.01,
            0.5,
            hint="Where the start ends and the cameras of now begin.",
            visible=False,
        )
        self._surface = gui.add_dropdown(
            "Object shows",
            tuple(SURFACES),
            hint="Photos laid on as the cameras are now, or where they disagree.",
        )
        self._plot = gui.add_uplot(
            EMPTY_CURVE,
            SERIES,
            title="Cost, % of the start, by step",
            scales={"x": {"time": False}, "y": {"distr": 3}},
            axes=(
                {"stroke": INK, "grid": {"stroke": GRID}},
                {"stroke": INK, "grid": {"stroke": GRID}, "ticks": NO_DOTS, "size": 58},
            ),
            legend={"show": False},
            padding=(10, 14, 0, 0),
            height=194,
            visible=False,
        )
        self._key = gui.add_html(KEY, visible=False)

        @self._swipe.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            line = self._line.value if self._swipe.value else None
            session.change(None, setting(start_line=line))

        @self._line.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(start_line=self._line.value))

        @self._surface.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(surface=SURFACES[self._surface.value]))

    def show(self, state: State) -> None:
        """Makes picture, comparison and curve as ``state`` has them."""
        run = state.run
        put(self._caption, "content", _caption(state))
        self._styles.show(state.overlay_style)
        put(self._swipe, "visible", run.is_active)
        put_value(self._swipe, state.start_line is not None)
        put(self._line, "visible", run.is_active and state.start_line is not None)
        if state.start_line is not None:
            put_value(self._line, state.start_line)
        surface = next(name for name, s in SURFACES.items() if s == state.surface)
        put(self._surface, "visible", state.wears_run)
        put_value(self._surface, surface)
        self._show_comparison(state)
        self._show_curve(run.curve)

    def _show_picture(self, picture: bytes | None, compared: bool) -> None:
        put(self._image, "visible", picture is not None and not compared)
        if picture is not None and picture is not self._shown:
            self._shown = picture
            put_jpeg(self._image, picture)

    def _show_comparison(self, state: State) -> None:
        compared = state.comparison
        put(self._comparison, "visible", compared is not None)
        self._show_picture(state.picture, compared is not None)
        if compared is None or not compared.photos:
            return
        onto = min(state.overlay_onto, len(compared.photos) - 1)
        if self._compared is None or self._compared != (compared, onto):
            self._compared = (compared, onto)
            left = f"run {state.compared_with}" if state.compared_with else "start"
            self._comparison.content = (
                f'{SWIPE_STYLE}<div style="margin:0 12px 10px">'
                f"{comparison_html(compared.photos[onto], left)}</div>"
            )

    def _show_curve(self, curve: tuple[CurvePoint, ...]) -> None:
        if curve is self._curve:
            return
        self._curve = curve
        for node in (self._plot, self._key):
            put(node, "visible", len(curve) > 1)
        if len(curve) > 1:
            self._plot.data = curve_arrays(curve)


def curve_arrays(curve: tuple[CurvePoint, ...]) -> tuple[np.ndarray, ...]:
    """The curve as the plot takes it; NaN where there is nothing to draw."""

    def values(of: list[float | None]) -> np.ndarray:
        # In per cent: the plot writes numbers below a thousandth as 0.
        return np.array([np.nan if v is None else 100.0 * v for v in of])

    return (
        np.array([float(point.step) for point in curve]),
        values([point.best for point in curve]),
        values([point.median for point in curve]),
        values([point.low for point in curve]),
        values([point.high for point in curve]),
        values([p.best if p.mark == "restart" else None for p in curve]),
        values([p.best if p.mark == "level" else None for p in curve]),
    )


def _caption(state: State) -> str:
    used = state.document.used
    text = "A mesh and a photo in use are needed for an overlay."
    if len(used) == 1 and state.document.mesh is not None:
        text = f"The surface, by its normals, over <b>{escaped(used[0].name)}</b>"
    elif used and state.document.mesh is not None:
        onto = state.overlay_onto
        source = used[(onto + 1) % len(used)]
        text = (
            f"<b>{escaped(source.name)}</b> projected onto "
            f"<b>{escaped(used[onto].name)}</b>"
        )
    if used and state.document.mesh is not None and state.run.error_px is not None:
        text += f" · true error <b>{state.run.error_px:.2f} px</b>"
    return f'<div style="{CAPTION}">{text}</div>'
