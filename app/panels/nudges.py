"""Small steps of the selected camera, by keys that repeat and by buttons held."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
import viser

from app.model.camera_moves import nudged, rolled, with_focal
from app.model.camera_numbers import FOCAL_RANGE, focal_of_film
from app.model.session import Session, select, with_entry
from app.model.state import State
from app.web.controls import guarded
from photoreg.geometry.camera import Camera

NUDGE_SHARE = 1.0 / 640.0
"""A nudge moves the object by so much of the photo's longer side."""

NEARER_SHARE = 0.005
ROLL_STEP_DEG = 0.25
DOLLY_STEP = 1.01
"""A step of the dolly zoom multiplies the focal length by this."""

COARSE, FINE = 10.0, 0.1
"""Steps with Shift, and with Alt, in plain ones."""

Key = Literal["J", "L", "I", "K", "N", "M", "U", "O", "F", "V"]
Modifier = Literal["shift", "alt"]


class Nudge(NamedTuple):
    """One way in which the object moves in the photo."""

    key: Key
    """The letters that viser leaves free; W, A, S, D, Q, E and arrows move the view."""
    name: str
    right: float = 0.0
    down: float = 0.0
    nearer: float = 0.0
    roll: float = 0.0
    longer: float = 0.0


STEPS = (
    Nudge("J", "left", right=-1.0),
    Nudge("L", "right", right=1.0),
    Nudge("I", "up", down=-1.0),
    Nudge("K", "down", down=1.0),
    Nudge("N", "nearer", nearer=1.0),
    Nudge("M", "farther", nearer=-1.0),
    Nudge("U", "roll left", roll=-1.0),
    Nudge("O", "roll right", roll=1.0),
    Nudge("F", "longer lens", longer=1.0),
    Nudge("V", "shorter lens", longer=-1.0),
)
BY_NAME = {step.name: step for step in STEPS}


class Stepper:
    """Moves the selected camera by small steps; a row of them is one undo step."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def bind(self, gui: viser.GuiApi) -> None:
        """Gives each step its key, and 1 to 9 the photos."""
        modifiers: tuple[tuple[Modifier | None, float, str], ...] = (
            (None, 1.0, ""),
            ("shift", COARSE, ", coarse"),
            ("alt", FINE, ", fine"),
        )
        for step in STEPS:
            for modifier, factor, word in modifiers:
                command = gui.add_command(
                    f"{step.name.capitalize()}{word}",
                    hotkey=step.key,
                    modifier=modifier,
                )
                command.on_trigger(
                    guarded(lambda _, step=step, factor=factor: self.take(step, factor))
                )
        digits: tuple[Literal["1", "2", "3", "4", "5", "6", "7", "8", "9"], ...]
        digits = ("1", "2", "3", "4", "5", "6", "7", "8", "9")
        for digit in digits:
            command = gui.add_command(f"Choose photo {digit}", hotkey=digit)
            command.on_trigger(
                guarded(lambda _, index=int(digit) - 1: self._choose(index))
            )

    def press(self, name: str) -> None:
        """A tool button: the step's name, with "+" or "-" for coarse or fine."""
        factor = {"+": COARSE, "-": FINE}.get(name[-1:], 1.0)
        self.take(BY_NAME[name.rstrip("+-")], factor)

    def take(self, step: Nudge, factor: float = 1.0) -> None:
        """Takes one step, ``factor`` times as large as a plain one."""
        if step.longer:
            self._dolly_zoom(lambda focal: focal * DOLLY_STEP ** (step.longer * factor))
            return
        state, index = self._session.state, self._session.state.selected
        entry, mesh = state.selected_photo, state.document.mesh
        if entry is None or mesh is None or state.run.status != "idle":
            return
        step_px = factor * NUDGE_SHARE * max(entry.photo.width, entry.photo.height)
        camera = nudged(
            rolled(entry.camera, step.roll * factor * ROLL_STEP_DEG),
            mesh.bounds.mean(axis=0),
            step.right * step_px,
            step.down * step_px,
            step.nearer * factor * NEARER_SHARE,
        )
        word = "Roll" if step.roll else "Nudge"
        self._put(f"{word} camera {index + 1}", index, camera, word)

    def dolly_zoom_to(self, film_mm: float) -> None:
        """Another focal length, in mm of 35 mm film; the object keeps its size."""
        entry = self._session.state.selected_photo
        if entry is None:
            return
        wanted = focal_of_film(entry.camera, film_mm)
        if abs(wanted / entry.camera.focal_px - 1.0) > 5e-4:
            self._dolly_zoom(lambda _: wanted)
        # Else the slider shows a rounded value; that is no change.

    def _dolly_zoom(self, change: Callable[[float], float]) -> None:
        state, index = self._session.state, self._session.state.selected
        entry = state.selected_photo
        if entry is None or state.run.status != "idle":
            return
        side = max(entry.photo.width, entry.photo.height)
        low, high = (share * side for share in FOCAL_RANGE)
        focal = float(np.clip(change(entry.camera.focal_px), low, high))
        camera = with_focal(entry.camera, focal, _centroid(state))
        self._put(f"Zoom camera {index + 1}, same size", index, camera, "dolly")

    def _put(self, name: str, index: int, camera: Camera, gesture: str) -> None:
        self._session.change(name, with_entry(index, camera=camera), (gesture, index))

    def _choose(self, index: int) -> None:
        if index < len(self._session.state.document.photos):
            self._session.change(None, select(index))


def _centroid(state: State) -> np.ndarray:
    mesh = state.document.mesh
    return np.zeros(3) if mesh is None else mesh.centroid
