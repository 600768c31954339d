"""Two gizmos for the selected camera: at the camera itself, and about the object."""

import dataclasses
from collections.abc import Callable

import numpy as np
import viser
import viser.transforms as vtf

from app.model.camera_moves import DisplayFrame, orbit_axes, orbited
from app.model.state import State
from app.web.controls import guarded, put
from photoreg.geometry.camera import Camera

Moved = Callable[[str, int, Callable[[Camera], Camera]], None]
"""Takes a phase, a browser, and what makes the camera where the hand has it from the one
in force."""

GIZMO_PX = 105.0
ORBIT_PX = 190.0


class Gizmos:
    """Of the two one is shown; nothing is read from them but what a hand does."""

    def __init__(self, scene: viser.SceneApi, moved: Moved) -> None:
        self._frame = DisplayFrame()
        self._holder: int | None = None
        self.move = scene.add_transform_controls(
            "/cameras/gizmo",
            scale=GIZMO_PX,
            fixed=True,
            depth_test=False,
            line_width=3.0,
            visible=False,
        )
        self.orbit = scene.add_transform_controls(
            "/cameras/orbit",
            scale=ORBIT_PX,
            fixed=True,
            depth_test=False,
            line_width=4.0,
            disable_axes=True,
            disable_sliders=True,
            visible=False,
        )
        self.orbit_rest = np.eye(3)
        self._orbit_start: tuple[Camera, np.ndarray] | None = None

        @self.move.on_update
        @guarded
        def _(event: viser.TransformControlsEvent) -> None:
            self._hold(event)
            rotation = vtf.SO3(event.target.wxyz).as_matrix()
            position = np.array(event.target.position)
            moved(
                event.phase,
                event.client_id or 0,
                lambda camera: self._frame.with_pose(camera, rotation, position),
            )

        @self.orbit.on_update
        @guarded
        def _(event: viser.TransformControlsEvent) -> None:
            self._hold(event)
            wxyz = np.array(event.target.wxyz)
            moved(
                event.phase,
                event.client_id or 0,
                lambda camera: self._orbited(camera, wxyz),
            )
            if event.phase == "end":
                self._orbit_start = None

    def let_go(self, browser: int) -> None:
        """Frees the gizmo that a browser held when it went away."""
        if self._holder == browser:
            self._holder = None
            self._orbit_start = None

    def _hold(self, event: viser.TransformControlsEvent) -> None:
        self._holder = None if event.phase == "end" else event.client_id

    def _orbited(self, camera: Camera, wxyz: np.ndarray) -> Camera:
        """The camera orbited as far as the gizmo was turned since it was taken."""
        if self._orbit_start is None:
            self._orbit_start = (camera, self.orbit_rest)
        start, rest = self._orbit_start
        # From the start each time: steps would add up their rounding.
        turn = vtf.SO3(wxyz).as_matrix() @ rest.T
        carried = orbited(start, self._frame.to_world(np.zeros(3)), turn)
        return dataclasses.replace(
            camera,
            R_cam_world=carried.R_cam_world,
            t_cam_world=carried.t_cam_world,
        )

    def show(self, state: State, frame: DisplayFrame) -> None:
        """Puts the gizmo in use where the selected camera is."""
        self._frame = frame
        entry = state.selected_photo
        visible = entry is not None and state.run.status == "idle"
        put(self.move, "visible", visible and state.gizmo == "move")
        put(self.orbit, "visible", visible and state.gizmo == "orbit")
        if entry is None or self._holder is not None:
            return  # The hand that drags it is ahead of the state.
        rotation, position = frame.pose(entry.camera)
        self.move.wxyz = vtf.SO3.from_matrix(rotation).wxyz
        self.move.position = position
        self.orbit_rest = orbit_axes(position, np.array(state.document.up))
        self.orbit.wxyz = vtf.SO3.from_matrix(self.orbit_rest).wxyz
