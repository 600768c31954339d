"""Left dock, Points: click the same points in the photo and on the model."""

import html
import itertools
import json
import threading
from typing import Any

import numpy as np
import viser

from app import points
from app.bus import Bus, Values, mounted, sending
from app.conductor import Conductor
from app.controls import guarded, guarded_slow, notify, put, put_value
from app.masks import mask_of, painted_mask
from app.panel_data import index_of, photo_options
from app.pictures import Pictures
from app.placement import DisplayFrame
from app.session import select, setting, with_entry
from app.state import State
from photoreg.camera import Camera
from photoreg.errors import InputError
from photoreg.photo import PHOTO_SUFFIXES
from photoreg.resection import N_FOCAL, N_POSE, N_PRINCIPAL

SUSPECT_FACTOR = 3.0
"""A pair so many times worse than the typical one is marked, at least."""

NEEDS = (
    f"{N_POSE} pairs give the pose, {N_FOCAL} also the focal length, {N_PRINCIPAL} also "
    "the principal point."
)


class PointsPanel:
    """The picker, the table of pairs, and what can be done with them."""

    def __init__(
        self, gui: viser.GuiApi, conductor: Conductor, bus: Bus, pictures: Pictures
    ) -> None:
        self._conductor = conductor
        self._session = session = conductor.session
        self._pictures = pictures
        self._picking: set[int] = set()
        self._gesture = itertools.count()
        self._choice = gui.add_dropdown("Photo", photo_options(session.state))
        gui.add_html(
            f'<div style="margin:2px 10px 4px">{mounted("picker")}<div></div></div>'
        )
        self._state = gui.add_html("")
        self._live = gui.add_checkbox(
            "Solve as points come in",
            True,
            hint="Places this photo's camera anew whenever one of its points changes.",
        )
        self._solve = gui.add_button(
            "Solve", icon=viser.Icon.TARGET_ARROW, disabled=True
        )
        self._table = gui.add_html("")
        self._copy = gui.add_button(
            "Take the other photo's points on the model",
            icon=viser.Icon.COPY,
            color="gray",
            visible=False,
        )
        self._clear = gui.add_button(
            "Delete all points of this photo",
            icon=viser.Icon.TRASH,
            color="gray",
            visible=False,
        )
        self._mask = gui.add_upload_button(
            "Load a mask",
            icon=viser.Icon.CIRCLE_HALF_2,
            color="gray",
            mime_type=",".join(PHOTO_SUFFIXES),
            hint="A picture of the photo's shape: dark or transparent where this photo "
            "does not count. Leave out and Bring back, above, paint it.",
        )
        gui.add_markdown(
            "Wheel zooms, dragging pans, **Delete** removes the marker in focus; a "
            "click on a marker, then elsewhere, puts it there."
        )
        bus.on("pick", self._on_pick)
        bus.on("move", self._on_move)
        bus.on("delete", self._on_delete)
        bus.on("choose", self._on_choose)
        bus.on("paint", self._on_paint)
        bus.on("unmask", self._on_unmask)
        bus.on("picking", self._on_picking)

        @self._choice.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            index = index_of(session.state, self._choice.value)
            session.change(None, select(index))

        @self._live.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(live_solve=self._live.value))

        @self._solve.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            state = session.state
            solution = state.current_solution
            if state.selected_photo is None:
                raise InputError("There is no photo yet. Add one in the Data tab.")
            if solution is not None and solution.problem:
                raise InputError(solution.problem)
            step = f"Solve camera {state.selected + 1}"
            gesture = ("solve", next(self._gesture))
            conductor.solver.place(state.selected_photo.name, step, gesture)

        @self._copy.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            state = session.state
            entry, other = state.selected_photo, _other_with_points(state)
            if entry is not None and other is not None:
                session.change(
                    f"Take the points of {other}",
                    points.with_surface_points_of(entry.name, other),
                )

        @self._mask.on_upload
        @guarded_slow
        def _(event: viser.GuiEvent) -> None:
            self._load_mask(event.target.value.name, event.target.value.content)

        @self._clear.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            index = session.state.selected
            session.change(
                f"Delete the points of photo {index + 1}", with_entry(index, pairs=())
            )

    # Clicks.

    def on_surface_click(
        self,
        client: viser.ClientHandle,
        frame: DisplayFrame,
        origin: np.ndarray,
        direction: np.ndarray,
    ) -> None:
        """A click in the scene: the point of the full mesh under it joins a pair."""
        if client.client_id not in self._picking:
            return
        state = self._session.state
        entry, mesh = state.selected_photo, state.document.mesh
        if entry is None or mesh is None or state.run.status != "idle":
            return
        start = frame.to_world(np.asarray(origin, dtype=np.float64))
        ray = np.asarray(direction, dtype=np.float64) / frame.scale
        faces, distances = mesh.first_hits(start[None], ray[None])
        if faces[0] < 0:
            return
        x, y, z = (float(v) for v in start + distances[0] * ray)
        self._change(
            entry.name, "Point", points.with_surface_point(entry.name, (x, y, z))
        )

    def _on_pick(self, values: Values, _: viser.ClientHandle) -> None:
        name = str(values["photo"])
        pixel = (float(values["u"]), float(values["v"]))
        self._change(name, "Point", points.with_photo_point(name, pixel))

    def _on_move(self, values: Values, _: viser.ClientHandle) -> None:
        name, number = str(values["photo"]), int(values["number"])
        pixel = (float(values["u"]), float(values["v"]))
        change = points.with_moved_point(name, number, pixel)
        self._change(name, f"Move point {number}", change)

    def _on_delete(self, values: Values, _: viser.ClientHandle) -> None:
        name, number = str(values["photo"]), int(values["number"])
        change = points.without_point(name, number)
        self._change(name, f"Delete point {number}", change)

    def _on_choose(self, values: Values, _: viser.ClientHandle) -> None:
        number = values["number"]
        number = None if number is None else int(number)
        self._session.change(None, points.chosen(str(values["photo"]), number))

    def _on_picking(self, values: Values, client: viser.ClientHandle) -> None:
        if values["on"]:
            self._picking.add(client.client_id)
        else:
            self._picking.discard(client.client_id)

    def _change(self, name: str, step: str, change: Any) -> None:
        """A change of the points and, if solving is live, of the camera: one step."""
        session, gesture = self._session, ("points", next(self._gesture))
        index = points.index_of_photo(session.state, name)
        step = f"{step} of photo {index + 1}"
        if session.change(step, change, gesture) and session.state.live_solve:
            self._conductor.solver.place(name, step, gesture)

    # The mask.

    def _on_paint(self, values: Values, client: viser.ClientHandle) -> None:
        stroke = [(float(u), float(v)) for u, v in values["stroke"]][:5000]
        radius, counts = float(values["radius"]), bool(values["counts"])
        name = str(values["photo"])

        def paint() -> None:
            # A photo of 50 megapixels takes a quarter of a second: not on the loop.
            session = self._session
            try:
                with session.lock:
                    index = points.index_of_photo(session.state, name)
                    entry = session.state.document.photos[index]
                    photo = entry.photo
                    png = painted_mask(
                        entry.mask_png,
                        photo.width,
                        photo.height,
                        stroke,
                        radius,
                        counts,
                    )
                    session.change(
                        f"Paint the mask of photo {index + 1}",
                        with_entry(index, mask_png=png),
                    )
            except InputError as error:
                notify(client, "That is not possible", str(error))

        threading.Thread(target=paint, daemon=True).start()

    def _load_mask(self, name: str, content: bytes) -> None:
        entry = self._session.state.selected_photo
        if entry is None:
            raise InputError("There is no photo yet. Add one in the Data tab.")
        plain = name.replace("\\", "/").rpartition("/")[2] or "mask"
        png = mask_of(plain, content, entry.photo.width, entry.photo.height)

        def change(state: State) -> State:
            index = points.index_of_photo(state, entry.name)
            return with_entry(index, mask_png=png)(state)

        self._session.change(f"Load the mask {plain}", change)

    def _on_unmask(self, values: Values, _: viser.ClientHandle) -> None:
        index = points.index_of_photo(self._session.state, str(values["photo"]))
        self._session.change(
            f"Clear the mask of photo {index + 1}", with_entry(index, mask_png=None)
        )

    # What is shown.

    def show(self, state: State) -> None:
        """Makes the panel as ``state`` has it."""
        options = photo_options(state)
        put(self._choice, "options", options)
        put_value(self._live, state.live_solve)
        entry, idle = state.selected_photo, state.run.status == "idle"
        if entry is not None:
            put_value(self._choice, options[state.selected])
        n_whole = 0 if entry is None else len(entry.whole_pairs)
        put(self._solve, "disabled", n_whole < N_POSE or not idle)
        put(self._mask, "disabled", entry is None or not idle)
        put(self._clear, "visible", entry is not None and bool(entry.pairs) and idle)
        put(self._copy, "visible", _other_with_points(state) is not None and idle)
        rows = pair_rows(state)
        put(self._table, "content", table_html(state, rows))
        data: dict[str, Any] = {"photo": None, "pairs": []}
        if entry is not None:
            data = {
                "photo": self._pictures.photo_key(entry.photo),
                "name": entry.name,
                "width": entry.photo.width,
                "height": entry.photo.height,
                "mask": self._pictures.mask_key(entry.mask_png),
                "busy": not idle,
                "chosen": state.chosen_pair,
                "hint": points.next_click(state),
                "pairs": [
                    {
                        "n": pair.number,
                        "u": None if pair.pixel is None else pair.pixel[0],
                        "v": None if pair.pixel is None else pair.pixel[1],
                        "whole": pair.is_whole,
                        "bad": row["bad"],
                        "tip": row["text"],
                    }
                    for pair, row in zip(entry.pairs, rows, strict=True)
                ],
            }
        put(self._state, "content", mounted("picker-state", state=json.dumps(data)))


def _other_with_points(state: State) -> str | None:
    """A photo whose surface points the selected one could take."""
    entry = state.selected_photo
    if entry is None:
        return None
    have = {pair.number for pair in entry.pairs}
    for other in state.document.photos:
        if other.name != entry.name and any(
            pair.world is not None and pair.number not in have for pair in other.pairs
        ):
            return other.name
    return None


def pair_rows(state: State) -> list[dict[str, Any]]:
    """For each pair of the selected photo its residual, in words, and whether bad."""
    entry = state.selected_photo
    if entry is None:
        return []
    camera: Camera = entry.camera
    solution = state.current_solution
    left_out: set[int] = set()
    if solution is not None and solution.resection is not None:
        inliers = solution.resection.inliers
        left_out = {
            pair.number
            for pair, good in zip(solution.pairs, inliers, strict=True)
            if not good
        }
    residuals = points.residuals_px(entry, camera)
    worst = max(residuals, key=lambda n: residuals[n], default=None)
    rows = []
    for pair in entry.pairs:
        residual = residuals.get(pair.number)
        if pair.world is None:
            text = "not yet on the model"
        elif pair.pixel is None:
            text = "not yet in the photo"
        elif residual is not None and np.isfinite(residual):
            text = f"{residual:.1f} px" if residual < 1000 else f"{residual:,.0f} px"
        else:
            text = "behind the camera"
        rows.append(
            {
                "number": pair.number,
                "text": text,
                "bad": pair.number in left_out,
                "worst": pair.number == worst and len(residuals) > 1,
            }
        )
    return rows


def table_html(state: State, rows: list[dict[str, Any]]) -> str:
    """The table of pairs, and above it what the solution says."""
    entry = state.selected_photo
    if entry is None:
        return ""
    return (
        f'<div style="margin:4px 12px;font-size:13px;line-height:1.4">'
        f"{_verdict_html(state)}{_rows_html(state, entry.name, rows)}</div>"
    )


def _verdict_html(state: State) -> str:
    entry, solution = state.selected_photo, state.current_solution
    assert entry is not None
    n = len(entry.whole_pairs)
    if n < N_POSE:
        missing = N_POSE - n
        more = "one more pair" if missing == 1 else f"{missing} more pairs"
        return (
            f'<div style="opacity:.75;margin-bottom:6px">{more} to place the camera. '
            f"{NEEDS}</div>"
        )
    if solution is None:
        return '<div style="opacity:.75;margin-bottom:6px">Solving …</div>'
    if solution.resection is None:
        return _note_html(solution.problem, bad=True)
    resection = solution.resection
    error = resection.expected_error_px
    colour = "#2dbeaf" if error < 20 and not resection.warnings else "#e8a33d"
    text = (
        f'<div style="margin-bottom:6px"><span style="font-size:18px;font-weight:650;'
        f'color:{colour}">± {error:.1f} px</span> expected over the surface<br>'
        f'<span style="opacity:.75">{html.escape(resection.summary)}</span></div>'
    )
    left_out = bool((~resection.inliers).any())
    return text + "".join(
        _note_html(_by_number(warning, solution.pairs), bad=left_out and i == 0)
        for i, warning in enumerate(resection.warnings)
    )


def _by_number(warning: str, pairs: tuple[Any, ...]) -> str:
    """The engine counts whole pairs from 1; the markers have numbers of their own."""
    numbers = [pair.number for pair in pairs]
    if numbers == list(range(1, len(numbers) + 1)):
        return warning
    head, sep, tail = warning.partition(" do")
    words = head.replace(",", "").replace(" and", "").split()
    if not sep or not words or words[0] not in ("Pair", "Pairs"):
        return warning
    named = [str(numbers[int(word) - 1]) for word in words[1:] if word.isdigit()]
    listed = named[-1:] if len(named) == 1 else [", ".join(named[:-1]), named[-1]]
    return f"{words[0]} {' and '.join(listed)}{sep}{tail}"


def _note_html(text: str, bad: bool) -> str:
    colour = "255,95,86" if bad else "232,163,61"
    return (
        f'<div style="border-left:3px solid rgb({colour});padding:4px 8px;'
        f"background:rgba({colour},.12);border-radius:0 5px 5px 0;margin-bottom:6px"
        f'">{html.escape(text)}</div>'
    )


def _rows_html(state: State, name: str, rows: list[dict[str, Any]]) -> str:
    if not rows:
        return ""
    cells = []
    for row in rows:
        number = row["number"]
        colour = "#ff5f56" if row["bad"] else "#e8a33d" if row["worst"] else "inherit"
        remark = "does not fit" if row["bad"] else "largest" if row["worst"] else ""
        back = "rgba(45,190,175,.22)" if number == state.chosen_pair else "none"
        cells.append(
            f'<tr style="cursor:pointer;background:{back}" '
            f'onclick="{sending("choose", photo=name, number=number)}">'
            f'<td style="padding:2px 6px;font-weight:650">{number}</td>'
            f'<td style="text-align:right;color:{colour};'
            f'font-variant-numeric:tabular-nums">{row["text"]}</td>'
            f'<td style="padding-left:8px;color:{colour};opacity:.85">{remark}</td>'
            f'<td style="text-align:right"><button aria-label="Delete point {number}" '
            f'title="Delete point {number}" style="{_CROSS}" '
            f'onclick="{sending("delete", photo=name, number=number)}">✕</button></td>'
            "</tr>"
        )
    head = '<tr style="opacity:.6;font-size:12px"><td style="padding:0 6px">Point</td>'
    head += '<td style="text-align:right">Residual</td><td></td><td></td></tr>'
    return (
        '<table style="width:100%;border-collapse:collapse">'
        f"{head}{''.join(cells)}</table>"
    )


_CROSS = (
    "background:none;border:0;color:inherit;opacity:.6;cursor:pointer;font:inherit;"
    "padding:0 6px"
)
