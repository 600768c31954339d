"""Left dock, Points: click the same points in the photo and on the model."""

import itertools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from app.control.controller import Controller
from app.model import point_pairs
from app.model.camera_moves import DisplayFrame
from app.model.markup import mounted
from app.model.masks import MASK_SUFFIXES, mask_of, painted_mask
from app.model.object_box import with_box, without_box
from app.model.session import select, setting, with_entry
from app.model.state import State
from app.panels.data import index_of, photo_options
from app.panels.pair_table import pair_rows, table_html
from app.panels.photo_gain import add_photo_gain
from app.scene.markers import Pull
from app.web.bridge import Bridge, Number, Values, Whole
from app.web.controls import guarded, guarded_slow, in_background, put, put_value
from app.web.widgets import Tool, Tools
from photoreg.errors import InputError
from photoreg.resection.solver import N_POSE

MAX_CROPS = 8
"""Points of the other photo that are shown at once: two rows."""


class PointsPanel:
    """The picker, the table of pairs, and what can be done with them."""

    def __init__(
        self,
        gui: viser.GuiApi,
        controller: Controller,
        bridge: Bridge,
        on_picking: Callable[[int, bool], None],
    ) -> None:
        """``on_picking`` is told of a browser whose clicks place points, or no longer."""
        self._controller = controller
        self._session = session = controller.session
        self._pictures = controller.pictures
        self._picking: set[int] = set()
        self._tell_picking = on_picking
        self._gesture = itertools.count()
        self._pull: tuple[str, int] = ("pull", -1)
        self._choice = gui.add_dropdown(
            "Photo",
            photo_options(session.state),
            hint="Whose points are clicked. The keys 1 to 9 choose it, too.",
        )
        gui.add_html(
            f'<div style="margin:2px 10px 4px">{mounted("picker")}<div></div></div>'
        )
        self._gain = add_photo_gain(gui, session)
        self._state = gui.add_html("")
        self._live = gui.add_checkbox(
            "Solve live",
            True,
            hint="Places this photo's camera anew whenever one of its points changes.",
        )
        self._solve = gui.add_button(
            "Solve",
            icon=viser.Icon.TARGET_ARROW,
            disabled=True,
            hint="Places this photo's camera where its points fit best.",
        )
        self._table = gui.add_html("")
        self._tools = Tools(gui, bridge, "", (), lambda _, value: self._use_tool(value))
        self._mask = gui.add_upload_button(
            "Load a mask",
            icon=viser.Icon.CIRCLE_HALF_2,
            color="gray",
            mime_type=",".join(MASK_SUFFIXES),
            hint="A picture of the photo's shape: dark or transparent where this photo "
            "does not count. Mask and Bring back, above, paint it.",
        )
        gui.add_markdown(
            "Drag a marker, in the photo or on the model, to correct it; **Delete** "
            "removes the one in focus. In the photo the wheel zooms, dragging pans. "
            "While this tab is open no camera stands in the way of the model."
        )
        bridge.on("pick", self._on_pick, photo=str, u=Number, v=Number)
        bridge.on("move", self._on_move, photo=str, number=Whole, u=Number, v=Number)
        bridge.on("delete", self._on_delete, photo=str, number=Whole)
        bridge.on("choose", self._on_choose, photo=str, number=Whole | None)
        bridge.on(
            "paint",
            self._on_paint,
            photo=str,
            stroke=list[tuple[Number, Number]],
            radius=Number,
            counts=bool,
        )
        bridge.on("unmask", self._on_unmask, photo=str)
        bridge.on(
            "box", self._on_box, photo=str, box=tuple[Number, Number, Number, Number]
        )
        bridge.on("unbox", self._on_unbox, photo=str)
        bridge.on("picking", self._on_picking, on=bool)

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
            controller.solver.place(state.selected_photo.name, step, gesture)

        @self._mask.on_upload
        @guarded_slow
        def _(event: viser.GuiEvent) -> None:
            self._load_mask(event.target.value.name, event.target.value.content)

    def _use_tool(self, tool: str) -> None:
        session = self._session
        state, index = session.state, session.state.selected
        entry, other = state.selected_photo, _other_with_points(state)
        if entry is None:
            return
        if tool == "clear":
            step = f"Delete the points of photo {index + 1}"
            session.change(step, with_entry(index, pairs=()))
        elif other is not None:
            change = point_pairs.with_surface_points_of(entry.name, other)
            session.change(f"Take the points of {other}", change)

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
        entry = self._session.state.selected_photo
        point = self._surface_point(frame, origin, direction)
        if entry is not None and point is not None:
            change = point_pairs.with_surface_point(entry.name, point)
            self._change(entry.name, "Point", change)

    def on_marker_pull(self, frame: DisplayFrame, pull: Pull) -> None:
        """A marker is dragged over the surface; one drag is one undo step.

        Solving waits for the end: a view through the photo would move under the hand.
        """
        state = self._session.state
        entry, index = state.selected_photo, state.selected
        if pull.phase == "start":
            self._pull = ("pull", next(self._gesture))
        point = self._surface_point(frame, pull.origin, pull.direction)
        if entry is None:
            return
        step = f"Move point {pull.number} of photo {index + 1}"
        if point is not None:
            change = point_pairs.with_moved_surface_point(
                entry.name, pull.number, point
            )
            self._session.change(step, change, self._pull)
        if pull.phase == "end" and self._session.state.live_solve:
            self._controller.solver.place(entry.name, step, self._pull)

    def _surface_point(
        self, frame: DisplayFrame, origin: np.ndarray, direction: np.ndarray
    ) -> tuple[float, float, float] | None:
        """Where a ray of the page meets the full mesh; None while a run goes on."""
        state = self._session.state
        mesh = state.document.mesh
        if mesh is None or state.run.status != "idle":
            return None
        start = frame.to_world(np.asarray(origin, dtype=np.float64))
        ray = np.asarray(direction, dtype=np.float64) / frame.scale
        faces, distances = mesh.first_hits(start[None], ray[None])
        if faces[0] < 0:
            return None
        x, y, z = (float(v) for v in start + distances[0] * ray)
        return x, y, z

    def _on_pick(self, values: Values, _: viser.ClientHandle) -> None:
        name, pixel = values["photo"], (values["u"], values["v"])
        self._change(name, "Point", point_pairs.with_photo_point(name, pixel))

    def _on_move(self, values: Values, _: viser.ClientHandle) -> None:
        name, number = values["photo"], values["number"]
        pixel = (values["u"], values["v"])
        change = point_pairs.with_moved_point(name, number, pixel)
        self._change(name, f"Move point {number}", change)

    def _on_delete(self, values: Values, _: viser.ClientHandle) -> None:
        name, number = values["photo"], values["number"]
        change = point_pairs.without_point(name, number)
        self._change(name, f"Delete point {number}", change)

    def _on_choose(self, values: Values, _: viser.ClientHandle) -> None:
        change = point_pairs.chosen(values["photo"], values["number"])
        self._session.change(None, change)

    def _on_picking(self, values: Values, client: viser.ClientHandle) -> None:
        self._tell_picking(client.client_id, values["on"])
        if values["on"]:
            self._picking.add(client.client_id)
            mesh = self._session.state.document.mesh
            if mesh is not None:
                # A first ray, which on two million triangles takes seconds.
                rays = np.zeros((1, 3)), np.ones((1, 3))
                in_background(client, "Picking", lambda: mesh.first_hits(*rays))
        else:
            self._picking.discard(client.client_id)

    def _change(self, name: str, step: str, change: Any) -> None:
        """A change of the points and, if solving is live, of the camera: one step."""
        session, gesture = self._session, ("points", next(self._gesture))
        index = point_pairs.index_of_photo(session.state, name)
        step = f"{step} of photo {index + 1}"
        if session.change(step, change, gesture) and session.state.live_solve:
            self._controller.solver.place(name, step, gesture)

    # The mask.

    def _on_paint(self, values: Values, client: viser.ClientHandle) -> None:
        stroke = values["stroke"][:5000]
        radius, counts, name = values["radius"], values["counts"], values["photo"]

        def paint() -> None:
            # A photo of 50 megapixels takes a quarter of a second: not on the loop.
            session = self._session
            with session.lock:
                index = point_pairs.index_of_photo(session.state, name)
                entry = session.state.document.photos[index]
                png = painted_mask(
                    entry.mask_png,
                    entry.photo.width,
                    entry.photo.height,
                    stroke,
                    radius,
                    counts,
                )
                session.change(
                    f"Paint the mask of photo {index + 1}",
                    with_entry(index, mask_png=png),
                )

        in_background(client, "Painting a mask", paint)

    def _load_mask(self, name: str, content: bytes) -> None:
        entry = self._session.state.selected_photo
        if entry is None:
            raise InputError("There is no photo yet. Add one in the Data tab.")
        plain = name.replace("\\", "/").rpartition("/")[2] or "mask"
        png = mask_of(plain, content, entry.photo.width, entry.photo.height)

        def change(state: State) -> State:
            index = point_pairs.index_of_photo(state, entry.name)
            return with_entry(index, mask_png=png)(state)

        self._session.change(f"Load the mask {plain}", change)

    def _on_unmask(self, values: Values, _: viser.ClientHandle) -> None:
        index = point_pairs.index_of_photo(self._session.state, values["photo"])
        self._session.change(
            f"Clear the mask of photo {index + 1}", with_entry(index, mask_png=None)
        )

    # The box.

    def _on_box(self, values: Values, _: viser.ClientHandle) -> None:
        index = point_pairs.index_of_photo(self._session.state, values["photo"])
        self._session.change(
            f"Draw a box in photo {index + 1}", with_box(values["photo"], values["box"])
        )

    def _on_unbox(self, values: Values, _: viser.ClientHandle) -> None:
        index = point_pairs.index_of_photo(self._session.state, values["photo"])
        self._session.change(
            f"Remove the box of photo {index + 1}", without_box(values["photo"])
        )

    # What is shown.

    def show(self, state: State) -> None:
        """Makes the panel as ``state`` has it."""
        options = photo_options(state)
        put(self._choice, "options", options)
        put_value(self._live, state.live_solve)
        put_value(self._gain, state.photo_gain)
        entry, idle = state.selected_photo, state.run.status == "idle"
        if entry is not None:
            put_value(self._choice, options[state.selected])
        n_whole = 0 if entry is None else len(entry.whole_pairs)
        put(self._solve, "disabled", n_whole < N_POSE or not idle)
        put(self._mask, "disabled", entry is None or not idle)
        self._tools.show(tools(state), visible=entry is not None and idle)
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
                "box": entry.box,
                "busy": not idle,
                "gain": state.photo_gain,
                "chosen": state.chosen_pair,
                "hint": point_pairs.next_click(state),
                "crops": [
                    {
                        "n": number,
                        "photo": self._pictures.photo_key(other.photo),
                        "name": other.name,
                        "u": pixel[0],
                        "v": pixel[1],
                        "width": other.photo.width,
                        "height": other.photo.height,
                    }
                    for number, other, pixel in point_pairs.to_be_clicked(state)[
                        :MAX_CROPS
                    ]
                ],
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


def tools(state: State) -> list[Tool]:
    """What can be done with all points of the selected photo."""
    entry = state.selected_photo
    return [
        Tool(
            "copy",
            "Take the other photo's points on the model; then click them in this one",
            viser.Icon.COPY,
            " From other photo",
            _other_with_points(state) is not None,
        ),
        Tool(
            "clear",
            "Delete all points of this photo",
            viser.Icon.TRASH,
            " Delete all",
            entry is not None and bool(entry.pairs),
        ),
    ]


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
