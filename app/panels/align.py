"""Tab 2, Align: bring each camera roughly into place by hand."""

import dataclasses
from collections.abc import Callable

import numpy as np
import viser

from app.control.controller import Controller
from app.model import camera_numbers
from app.model.camera_moves import first_camera
from app.model.camera_numbers import film_mm
from app.model.session import select, setting, with_entry
from app.model.state import State
from app.panels.nudges import Stepper
from app.web.bridge import Bridge
from app.web.controls import Typed, Typing, guarded, put, put_value
from app.web.widgets import Choice, Option, Tool, Tools
from photoreg.errors import InputError
from photoreg.geometry.camera import Camera

FILM_RANGE_MM = (12.0, 200.0)
"""Range of the slider: focal lengths on 35 mm film of the same field of view."""

REACH = 1e3
"""How many diagonals of the mesh from it a camera may be typed."""

NUDGE_TOOLS = (
    Tool("left", "Move the object left (J)", viser.Icon.ARROW_LEFT),
    Tool("right", "Move the object right (L)", viser.Icon.ARROW_RIGHT),
    Tool("up", "Move the object up (I)", viser.Icon.ARROW_UP),
    Tool("down", "Move the object down (K)", viser.Icon.ARROW_DOWN),
    Tool("nearer", "Bring the object nearer (N)", viser.Icon.ZOOM_IN),
    Tool("farther", "Take the object farther (M)", viser.Icon.ZOOM_OUT),
    Tool("roll left", "Roll left (U)", viser.Icon.ROTATE),
    Tool("roll right", "Roll right (O)", viser.Icon.ROTATE_CLOCKWISE),
)


class AlignPanel:
    """Controls of the Align tab that all browsers share."""

    def __init__(
        self, gui: viser.GuiApi, controller: Controller, bridge: Bridge
    ) -> None:
        self._session = session = controller.session
        self._photo = Choice(
            gui, bridge, "Photo", {}, lambda _, value: self._select(int(value))
        )
        self.view_order = gui.add_html("").order
        """Where each browser's own controls of its view go."""
        stepper = Stepper(session)
        self._nudge = Tools(
            gui,
            bridge,
            "Nudge",
            NUDGE_TOOLS,
            lambda _, value: stepper.press(value),
            repeat=True,
        )
        self._dolly = gui.add_slider(
            "Zoom, same size",
            *FILM_RANGE_MM,
            step=0.1,
            initial_value=50.0,
            hint="Zooms in and steps back, in mm of 35 mm film: the object keeps its "
            "size in the photo; its perspective changes.",
        )
        with gui.add_folder("Numbers", expand_by_default=False):
            self._keep = gui.add_checkbox(
                "Keep size",
                True,
                hint="A new focal length moves the camera back or forth, so that the "
                "object keeps its size in the photo.",
            )
            self._focal = gui.add_number(
                "Focal, px",
                1000.0,
                step=1.0,
                hint="The focal length in pixels of this photo at its full size.",
            )
            self._film = gui.add_number(
                "Focal, 35 mm",
                50.0,
                step=0.1,
                hint="In millimetres: that of a lens on 35 mm film with this view.",
            )
            self._angle = gui.add_number(
                "View angle, °", 40.0, step=0.1, hint="Over the photo's longer side."
            )
            self._principal = gui.add_vector2(
                "Principal point",
                (0.0, 0.0),
                step=1.0,
                hint="x and y in pixels, from the centre of the top-left pixel.",
            )
            self._radial = gui.add_vector3(
                "Lens k1, k2, k3",
                (0.0, 0.0, 0.0),
                step=0.001,
                hint="Lens distortion, OpenCV's radial terms: k1 below 0 bends lines "
                "outwards, as wide-angle lenses do. 0: an ideal lens.",
            )
            self._tangential = gui.add_vector2(
                "Lens p1, p2",
                (0.0, 0.0),
                step=0.0001,
                hint="Lens distortion, OpenCV's tangential terms.",
            )
            self._position = gui.add_vector3(
                "Position",
                (0.0, 0.0, 0.0),
                step=0.01,
                hint="Where the camera stands, in the scan's coordinates and unit.",
            )
            self._direction = gui.add_vector3(
                "Turn, tilt, roll",
                (0.0, 0.0, 0.0),
                step=0.1,
                hint="Degrees: about upwards, above the horizon, about the line of "
                "sight.",
            )
            self._around = gui.add_vector3(
                "Around object",
                (0.0, 0.0, 1.0),
                step=0.1,
                hint="Azimuth and elevation in degrees, and distance, as seen from the "
                "object; the camera turns along.",
            )
        with gui.add_folder("Start over", expand_by_default=False):
            self._copy = gui.add_button(
                "Copy photo 1, step aside", icon=viser.Icon.COPY, color="gray"
            )
            gui.add_markdown("*The place and lens of photo 1, 20° around the object.*")
            self._reset = gui.add_button(
                "Reset this camera", icon=viser.Icon.HOME, color="gray"
            )
            gui.add_markdown("*Level and in front of the object, all of it in frame.*")
        self._typed = (
            Typed(self._focal, lambda new: self._lens(lambda _: _only(new))),
            Typed(
                self._film,
                lambda new: self._lens(
                    lambda c: camera_numbers.focal_of_film(c, _only(new))
                ),
            ),
            Typed(
                self._angle,
                lambda new: self._lens(
                    lambda c: camera_numbers.focal_of_angle(c, _only(new))
                ),
            ),
            Typed(self._principal, self._set_principal),
            Typed(self._radial, lambda new: self._set_lens(("k1", "k2", "k3"), new)),
            Typed(self._tangential, lambda new: self._set_lens(("p1", "p2"), new)),
            Typed(self._position, self._set_position),
            Typed(self._direction, self._set_direction),
            Typed(self._around, self._set_around),
        )

        @self._dolly.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            stepper.dolly_zoom_to(self._dolly.value)

        @self._keep.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(keep_size=self._keep.value))

        @self._copy.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            self._change("Copy to camera", self._stepped_aside)

        @self._reset.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            self._change("Reset camera", self._first)

        stepper.bind(gui)

    # What the user changes.

    def _select(self, index: int) -> None:
        self._session.change(None, select(index))

    def _change(
        self, name: str, change: Callable[[Camera], Camera], gesture: str | None = None
    ) -> None:
        session = self._session
        state, index = session.state, session.state.selected
        entry = state.selected_photo
        if entry is None:
            raise InputError("There is no photo yet. Add one in the Data tab.")
        session.change(
            f"{name} {index + 1}",
            with_entry(index, camera=change(entry.camera)),
            None if gesture is None else (gesture, index),
        )

    def _lens(self, focal_px: Callable[[Camera], float]) -> None:
        state = self._session.state
        mesh = state.document.mesh
        anchor = mesh.centroid if state.keep_size and mesh is not None else None
        self._change(
            "Focal length",
            lambda c: camera_numbers.with_checked_focal(c, focal_px(c), anchor),
            "focal",
        )

    def _set_principal(self, new: Typing) -> None:
        self._change(
            "Principal point",
            lambda c: camera_numbers.with_principal_point(c, *_filled(new, c.K[:2, 2])),
            "principal",
        )

    def _set_lens(self, terms: tuple[str, ...], new: Typing) -> None:
        typed = {t: v for t, v in zip(terms, new, strict=True) if v is not None}
        self._change(
            "Lens distortion",
            lambda c: c.with_lens(dataclasses.replace(c.lens, **typed)),
            "lens",
        )

    def _set_position(self, new: Typing) -> None:
        mesh = self._session.state.document.mesh
        reach = np.inf
        if mesh is not None:
            reach = REACH * mesh.diagonal + float(np.abs(mesh.bounds).max())
        self._change(
            "Position",
            lambda c: camera_numbers.with_center(c, _filled(new, c.center), reach),
            "position",
        )

    def _set_direction(self, new: Typing) -> None:
        up = np.array(self._session.state.document.up)
        self._change(
            "Direction",
            lambda c: camera_numbers.with_direction(
                c, up, _filled(new, camera_numbers.direction_deg(c, up))
            ),
            "direction",
        )

    def _set_around(self, new: Typing) -> None:
        document = self._session.state.document
        up, anchor = np.array(document.up), _anchor(self._session.state)
        self._change(
            "Orbit",
            lambda c: camera_numbers.with_around(
                c, anchor, up, _filled(new, camera_numbers.around(c, anchor, up))
            ),
            "around",
        )

    def _first(self, _: Camera) -> Camera:
        state = self._session.state
        document, entry = state.document, state.selected_photo
        assert entry is not None
        others = tuple(e.camera for e in document.photos[: state.selected])
        return first_camera(document.mesh, entry.photo, document.up, others)

    def _stepped_aside(self, camera: Camera) -> Camera:
        state = self._session.state
        if state.selected == 0:
            raise InputError("This is photo 1 itself. Choose another photo first.")
        up, anchor = np.array(state.document.up), _anchor(state)
        return camera_numbers.stepped_aside(
            state.document.photos[0].camera, camera, anchor, up, state.selected
        )

    # What is on screen.

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        entry = state.selected_photo
        self._photo.show(
            str(state.selected),
            visible=entry is not None,
            options={
                str(i): Option(
                    f"{i + 1} · {e.photo.name.rpartition('.')[0]}",
                    title=f"Work on {e.photo.name}",
                )
                for i, e in enumerate(state.document.photos)
            },
        )
        fixed = entry is None or state.run.status != "idle"
        for control in (self._dolly, self._reset):
            put(control, "disabled", fixed)
        put(self._copy, "disabled", fixed or state.selected == 0)
        self._nudge.show([tool._replace(enabled=not fixed) for tool in NUDGE_TOOLS])
        put_value(self._keep, state.keep_size)
        for typed in self._typed:
            put(typed.handle, "disabled", fixed)
        if entry is None:
            return
        camera, up = entry.camera, np.array(state.document.up)
        put_value(
            self._dolly, round(float(np.clip(film_mm(camera), *FILM_RANGE_MM)), 1)
        )
        n_decimals = _n_decimals(state, camera)
        unit = state.document.unit
        put(self._position, "label", f"Position, {unit}" if unit else "Position")
        for control in (self._position, self._around):
            put(control, "precision", max(3, n_decimals))
        around = camera_numbers.around(camera, _anchor(state), up)
        values = (
            (round(camera.focal_px, 1),),
            (round(film_mm(camera), 2),),
            (round(camera_numbers.view_angle_deg(camera), 3),),
            tuple(round(float(v), 2) for v in camera.K[:2, 2]),
            tuple(
                round(v, 6) for v in (camera.lens.k1, camera.lens.k2, camera.lens.k3)
            ),
            tuple(round(v, 6) for v in (camera.lens.p1, camera.lens.p2)),
            tuple(round(float(v), n_decimals) for v in camera.center),
            tuple(round(float(v), 3) for v in camera_numbers.direction_deg(camera, up)),
            (
                round(float(around[0]), 3),
                round(float(around[1]), 3),
                round(float(around[2]), n_decimals),
            ),
        )
        for typed, value in zip(self._typed, values, strict=True):
            typed.show(value)


def _n_decimals(state: State, camera: Camera) -> int:
    """Decimals of a place: a hundred-thousandth of the object, in ten digits at most."""
    far = float(np.abs(camera.center).max())
    mesh = state.document.mesh
    size = far if mesh is None else mesh.diagonal
    before, fine = (int(np.floor(np.log10(max(v, 1e-12)))) for v in (far, size))
    return max(0, min(5 - fine, 9 - before))


def _anchor(state: State) -> np.ndarray:
    mesh = state.document.mesh
    return np.zeros(3) if mesh is None else mesh.bounds.mean(axis=0)


def _only(new: Typing) -> float:
    (value,) = new
    assert value is not None, "Only what was typed arrives."
    return value


def _filled(new: Typing, old: np.ndarray) -> np.ndarray:
    """The values typed, and exactly the old ones where nothing was."""
    pairs = zip(new, old, strict=True)
    return np.array([float(a) if b is None else b for b, a in pairs])
