"""Tab 2, Align: bring each camera roughly into place by hand."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import viser

from app.conductor import Conductor
from app.controls import guarded, put, put_value
from app.panel_data import index_of, photo_options
from app.placement import first_camera, nudged, rolled, with_focal
from app.session import select, setting, with_entry
from app.state import State
from app.viewport import Viewport
from photoreg.camera import Camera
from photoreg.errors import InputError

FILM_RANGE_MM = (12.0, 200.0)
"""Range of the slider: focal lengths on 35 mm film of the same field of view."""

FILM_DIAGONAL_MM = 43.27

ROLL_STEP_DEG = 0.25
Key = Literal["J", "L", "I", "K", "N", "M", "U", "O"]
NUDGE_SHARE = 1.0 / 640.0
"""A nudge moves the object by so much of the photo's longer side."""

NEARER_SHARE = 0.005

NUDGES: tuple[tuple[Key, str, float, float, float, float], ...] = (
    ("J", "left", -1.0, 0.0, 0.0, 0.0),
    ("L", "right", 1.0, 0.0, 0.0, 0.0),
    ("I", "up", 0.0, -1.0, 0.0, 0.0),
    ("K", "down", 0.0, 1.0, 0.0, 0.0),
    ("N", "nearer", 0.0, 0.0, 1.0, 0.0),
    ("M", "farther", 0.0, 0.0, -1.0, 0.0),
    ("U", "turned left", 0.0, 0.0, 0.0, -1.0),
    ("O", "turned right", 0.0, 0.0, 0.0, 1.0),
)
"""Key, where the object goes in the photo, and steps right, down, nearer and of roll.
The letters that viser leaves free; W, A, S, D, Q, E and the arrows move the view."""

ViewportOf = Callable[[int], Viewport | None]

FREE, THROUGH = "Free view", "Look through"


class AlignPanel:
    """Controls of the Align tab."""

    def __init__(
        self, gui: viser.GuiApi, conductor: Conductor, viewport_of: ViewportOf
    ) -> None:
        self._session = session = conductor.session
        gui.add_markdown(
            "Bring each photo to within about 20 pixels; the refinement does the rest."
        )
        self._choice = gui.add_dropdown("Photo", photo_options(session.state))
        self._free = gui.add_button(FREE, icon=viser.Icon.ARROWS_MOVE, color="gray")
        self._through = gui.add_button(THROUGH, icon=viser.Icon.EYE)
        gui.add_markdown(
            "*Free view*: drag the coloured arrows and arcs of the camera. "
            "*Look through*: the photo lies behind the mesh; orbit, pan (right button) "
            "and zoom (wheel) until they coincide, the camera follows."
        )
        self._opacity = gui.add_slider("Mesh opacity", 0.0, 1.0, 0.01, 0.55)
        with gui.add_folder("Lens and roll"):
            self._focal = gui.add_number("Focal length, px", 1000.0, step=1.0)
            self._slider = gui.add_slider(
                "35 mm film, mm", *FILM_RANGE_MM, step=0.1, initial_value=50.0
            )
            self._keep = gui.add_checkbox(
                "Keep the object's size", True, hint="The camera moves back or forth."
            )
            self._left = gui.add_button(
                "Roll left", icon=viser.Icon.ROTATE, color="gray"
            )
            self._right = gui.add_button(
                "Roll right", icon=viser.Icon.ROTATE_CLOCKWISE, color="gray"
            )
        self._undo = gui.add_button(
            "Undo", icon=viser.Icon.ARROW_BACK_UP, color="gray", disabled=True
        )
        self._redo = gui.add_button(
            "Redo", icon=viser.Icon.ARROW_FORWARD_UP, color="gray", disabled=True
        )
        self._reset = gui.add_button(
            "Reset this camera", icon=viser.Icon.HOME, color="gray"
        )
        gui.add_markdown(
            "Keys, hold to repeat: **J L I K** move the object in the photo, **N M** "
            "bring it nearer or farther, **U O** turn it. Ctrl+Z undoes, Ctrl+Shift+Z "
            "redoes."
        )
        self._roll_gesture = 0
        self._focal_gesture = 0

        @self._choice.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, select(index_of(session.state, self._choice.value)))

        @self._free.on_click
        @guarded
        def _(event: viser.GuiEvent) -> None:
            viewport = viewport_of(event.client_id or 0)
            if viewport is not None:
                viewport.free()

        @self._through.on_click
        @guarded
        def _(event: viser.GuiEvent) -> None:
            viewport = viewport_of(event.client_id or 0)
            if viewport is not None:
                viewport.look_through()

        @self._opacity.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            value = float(np.clip(self._opacity.value, 0.0, 1.0))
            session.change(None, setting(mesh_opacity=value))

        @self._keep.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(keep_size=self._keep.value))

        @self._focal.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            self._set_focal(float(self._focal.value), 0.06)

        @self._slider.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            entry = session.state.selected_photo
            if entry is not None:
                px_per_mm = 1.0 / film_mm(entry.camera, 1.0)
                self._set_focal(self._slider.value * px_per_mm, 0.06 * px_per_mm)

        for key, where, *steps in NUDGES:
            self._bind_nudge(gui, key, where, steps)

        for button, sign in ((self._left, -1.0), (self._right, 1.0)):
            self._bind_roll(button, sign * ROLL_STEP_DEG)

        @self._undo.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.undo()

        @self._redo.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.redo()

        @self._reset.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            state, index = session.state, session.state.selected
            entry = state.selected_photo
            if entry is None:
                raise InputError("There is no photo yet. Add one in the Data tab.")
            document = state.document
            others = tuple(e.camera for e in document.photos[:index])
            camera = first_camera(document.mesh, entry.photo, document.up, others)
            session.change(
                f"Reset camera {index + 1}", with_entry(index, camera=camera)
            )

    def _bind_roll(self, button: viser.GuiButtonHandle, step_deg: float) -> None:
        session = self._session

        @button.on_hold(callback_hz=12.0)
        @guarded
        def _(_: viser.GuiEvent) -> None:
            entry, index = session.state.selected_photo, session.state.selected
            if entry is None:
                return
            session.change(
                f"Roll camera {index + 1}",
                with_entry(index, camera=rolled(entry.camera, step_deg)),
                ("roll", index, step_deg),
            )

    def _bind_nudge(
        self, gui: viser.GuiApi, key: Key, where: str, steps: list[float]
    ) -> None:
        session = self._session
        command = gui.add_command(f"Nudge the object {where}", hotkey=key)
        right, down, nearer, roll = steps

        @command.on_trigger
        @guarded
        def _(_: viser.CommandEvent) -> None:
            state, index = session.state, session.state.selected
            entry, mesh = state.selected_photo, state.document.mesh
            if entry is None or mesh is None or state.run.status != "idle":
                return
            step_px = NUDGE_SHARE * max(entry.photo.width, entry.photo.height)
            camera = nudged(
                rolled(entry.camera, roll * ROLL_STEP_DEG),
                mesh.bounds.mean(axis=0),
                right * step_px,
                down * step_px,
                nearer * NEARER_SHARE,
            )
            session.change(
                f"Nudge camera {index + 1}",
                with_entry(index, camera=camera),
                ("nudge", index),
            )

    def _set_focal(self, focal_px: float, tolerance_px: float) -> None:
        session = self._session
        state, index = session.state, session.state.selected
        entry, mesh = state.selected_photo, state.document.mesh
        if entry is None:
            raise InputError("There is no photo yet. Add one in the Data tab.")
        side = max(entry.photo.width, entry.photo.height)
        low, high = 0.1 * side, 30.0 * side
        if not low <= focal_px <= high:
            put_value(self._focal, round(entry.camera.focal_px, 1))
            raise InputError(
                f"A focal length for this photo should be {low:.0f} to {high:.0f} px, "
                f"but is {focal_px:g}."
            )
        if abs(focal_px - entry.camera.focal_px) < tolerance_px:
            return  # The control shows a rounded value; that is no change.
        anchor = mesh.centroid if state.keep_size and mesh is not None else None
        session.change(
            f"Focal length {index + 1}",
            with_entry(index, camera=with_focal(entry.camera, focal_px, anchor)),
            ("focal", index),
        )

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        options = photo_options(state)
        put(self._choice, "options", options)
        put_value(self._opacity, state.mesh_opacity)
        put_value(self._keep, state.keep_size)
        entry = state.selected_photo
        fixed = entry is None or state.run.status != "idle"
        for control in (
            self._focal,
            self._slider,
            self._left,
            self._right,
            self._reset,
        ):
            put(control, "disabled", fixed)
        put(self._through, "disabled", entry is None)
        if entry is not None:
            put_value(self._choice, options[state.selected])
            put_value(self._focal, round(entry.camera.focal_px, 1))
            film = film_mm(entry.camera, entry.camera.focal_px)
            put_value(self._slider, round(float(np.clip(film, *FILM_RANGE_MM)), 1))
        can_travel = state.run.status == "idle"
        for button, word, name in (
            (self._undo, "Undo", state.undo_name),
            (self._redo, "Redo", state.redo_name),
        ):
            put(button, "label", word if name is None else f"{word}: {name}")
            put(button, "disabled", name is None or not can_travel)


def film_mm(camera: Camera, focal_px: float) -> float:
    """Focal length on 35 mm film that has the same field of view."""
    return focal_px * FILM_DIAGONAL_MM / float(np.hypot(camera.width, camera.height))
