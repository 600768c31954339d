"""One browser's view: free, or through a photo's camera with the photo behind the mesh.

Two ways to look through. *Move*: the photo is the background, glued to the canvas, and
the camera follows the view. *Look through*: the camera stays; the photo is a plane in the
scene, and the view only turns about the camera's centre and zooms by its field of view,
so mesh and photo stay together to the pixel at any zoom.
"""

import threading
import time
from collections.abc import Callable
from typing import Literal

import numpy as np
import viser
import viser.transforms as vtf

from app.control.camera_claims import CameraClaims
from app.control.controller import Controller
from app.model.camera_moves import DisplayFrame
from app.model.session import with_entry
from app.model.state import FoundCamera, PhotoEntry, State
from app.scene.gizmos import GIZMO_PX
from app.scene.home_view import home_view
from app.scene.nodes import SceneNodes
from app.scene.photo_view import PhotoView
from app.web.controls import guarded, notify
from photoreg.geometry.camera import Camera

FREE_FOV = np.radians(14.0)
"""Narrow, so that the object is not dwarfed by the cameras that stand before it."""

LONG_LOOK = 10.0
ECHO_TOLERANCE = 1e-6
"""The browser answers a pose with itself, to 1e-15; a hand moves it by more."""

HOME_TOLERANCE = 0.02
"""How near the first view the browser's camera must be to be there, in units of the
page: it glides, and rests a little before its goal. A hand moves it by more."""

SETTLE_S = 10.0
"""After a pose was set the view glides there, on a slow machine for a while. Until it
has arrived, or for so long, what it reports is not the user's doing."""

GESTURE_PAUSE_S = 2.5
"""A rest of this length ends a gesture; what follows is another undo step. The browser
does not tell when the mouse is released, and draws a frame a second where it has no
graphics card and much else to do: a shorter rest would cut one drag into several steps."""

HOLD_S = 0.7
"""So long after its last move a view keeps the camera in its hand."""

PIVOT = 1e-3
"""Distance of the pivot in *Look through*, in page units: the view turns about the camera's
centre to less than a tenth of a pixel."""

FARTHEST_PIVOT = 1e4
"""viser's own limit."""

MAX_ZOOM = 64.0

Mode = Literal["free", "inspect", "move"]


class Viewport:
    """The view of one browser."""

    def __init__(
        self,
        client: viser.ClientHandle,
        controller: Controller,
        scene: SceneNodes,
        claims: CameraClaims,
        wake: Callable[[], None],
    ) -> None:
        """``wake`` asks for ``show`` on the thread that paints."""
        self.client = client
        self.mode: Mode = "free"
        self._is_picking = self._is_exporting = False
        self._wants_cameras: bool | None = None
        """Whether the user wants to see the cameras; None: as the open tabs have it."""
        self.zoom = 1.0
        """In *Look through*: how much larger than the whole photo."""
        self._controller = controller
        self._session = controller.session
        self._scene = scene
        self._claims = claims
        self._wake = wake
        self._lock = threading.RLock()
        self._hidden: list[viser.SceneNodeHandle] = []
        self._photo = PhotoView(client, scene)
        self._home: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._stands_at: Camera | None = None
        self._aim: np.ndarray | None = None
        self._settling_until = 0.0
        self._at_home: tuple[np.ndarray, float, bool] | None = None
        self._last_move = -np.inf
        self._gesture = 0
        self._told_at = -np.inf
        self._framed: object = None
        self._found: tuple[FoundCamera, ...] = ()
        client.camera.min_orbit_distance = PIVOT
        self._hide()
        client.camera.on_update(guarded(self._on_camera))

    # What the user asks for.

    def choose(self, mode: Mode) -> None:
        """Free, or through the selected photo in one of two ways."""
        with self._lock:
            if mode == "free":
                self.free()
            elif self._session.state.selected_photo is not None:
                self._look_through(mode)
            self._wake()

    def free(self) -> None:
        """Back to the view from before looking through; home if there already."""
        with self._lock:
            if self.mode == "free":
                self.go_home(self._session.state)
                return
            self._leave_inspect()
            self.mode = "free"
            self._hide()
            self._photo.show_none(self._session.state.dark)
            self._stands_at = None
            if self._home is None:
                self.go_home(self._session.state)
                return
            position, look_at, up = self._home
            with self.client.atomic():
                _place(self.client, position, look_at, up)
                self.client.camera.fov = FREE_FOV

    def pick(self, on: bool) -> None:
        """Clicks on the model place points, or no longer do: no camera in their way.

        A view that nobody has turned yet shows the object alone, as large as it goes.
        """
        with self._lock:
            if on != self._is_picking:
                self._is_picking = on
                self._on_other_tab()

    def export(self, on: bool) -> None:
        """The Export tab is on screen, or no longer is: it is about the object alone."""
        with self._lock:
            if on != self._is_exporting:
                self._is_exporting = on
                self._on_other_tab()

    def toggle_cameras(self) -> None:
        """Hides the cameras in this browser where they are shown, and the other way."""
        with self._lock:
            self._wants_cameras = not self._shows_cameras
            self._hide()

    def frame_all(self) -> None:
        """Everything in the frame again: the scene, or the whole photo."""
        with self._lock:
            if self.mode == "free":
                self.go_home(self._session.state)
            self.fit()

    @property
    def _shows_cameras(self) -> bool:
        if self._wants_cameras is not None:
            return self._wants_cameras
        return not (self._is_picking or self._is_exporting)

    def _on_other_tab(self) -> None:
        if self._wants_cameras:
            self._wants_cameras = None
        self._hide()
        if self.mode == "free":
            self._keep_home(self._session.state)

    def fit(self) -> None:
        """Look through: the whole photo again."""
        with self._lock:
            if self.mode == "inspect":
                self.set_zoom(1.0)
                self._aim = None
                self._stands_at = None
                self._wake()

    def set_zoom(self, zoom: float) -> None:
        """Look through: how much larger than the whole photo."""
        with self._lock:
            entry, view = self._session.state.selected_photo, self.client.camera
            if self.mode != "inspect" or entry is None:
                return
            self.zoom = float(np.clip(zoom, 1.0, MAX_ZOOM))
            view.fov = self._photo.view_angle(entry.camera, self.zoom)

    def _look_through(self, mode: Mode) -> None:
        if self.mode == "free":
            camera = self.client.camera
            self._home = (
                np.array(camera.position),
                np.array(camera.look_at),
                np.array(camera.up_direction),
            )
        was_free = self.mode == "free"
        if mode != "inspect":
            self._leave_inspect()
        self.mode, self.zoom, self._aim = mode, 1.0, None
        if was_free:
            self._hide()
        self._stands_at = None

    def _leave_inspect(self) -> None:
        if self.mode != "inspect":
            return
        self._photo.remove_plane()
        self.client.camera.max_orbit_distance = FARTHEST_PIVOT

    def go_home(self, state: State) -> None:
        """The view from which the mesh is seen, and the cameras where they are shown."""
        camera = self.client.camera
        aspect = camera.image_width / max(camera.image_height, 1)
        # On a screen of many pixels an inch the canvas has more of them than this.
        gizmo_share = GIZMO_PX / max(camera.image_height, 3.0 * GIZMO_PX)
        position, look_at = home_view(
            state,
            self._scene.frame,
            FREE_FOV,
            aspect,
            gizmo_share,
            alone=not self._shows_cameras,
        )
        self._at_home = (position, aspect, not self._shows_cameras)
        with self.client.atomic():
            _place(self.client, position, look_at, np.array(state.document.up))
            camera.fov = FREE_FOV

    @property
    def _is_at_home(self) -> bool:
        """Whether nobody has turned the view, and it has arrived."""
        if self._at_home is None:
            return False
        place = np.array(self.client.camera.position)
        return bool(np.abs(place - self._at_home[0]).max() <= HOME_TOLERANCE)

    def _keep_home(self, state: State) -> None:
        """Fits the first view again when the canvas, or what is shown, has changed."""
        if self._at_home is None or not self._is_at_home:
            return
        _, aspect, was_alone = self._at_home
        camera = self.client.camera
        change = camera.image_width / max(camera.image_height, 1) / aspect - 1.0
        if abs(change) > 0.02 or was_alone == self._shows_cameras:
            self.go_home(state)

    # What follows from a change of state.

    def show(self, state: State) -> None:
        """Brings the view in line with the state."""
        with self._lock:
            # The state may have moved on while this call waited for the lock.
            state = self._session.state
            document = state.document
            scope = (document.mesh, len(document.photos), document.up)
            if self._framed != scope:
                self._framed = scope
                self._home = None
                if self.mode == "free":
                    self.go_home(state)
            elif self._found != state.found:
                # They stand elsewhere; a view that somebody has turned stays as it is.
                if self.mode != "free":
                    self._home = None
                elif self._is_at_home:
                    self.go_home(state)
            self._found = state.found
            if self.mode == "free":
                self._keep_home(state)
                self._photo.show_none(state.dark)
                return
            entry = state.selected_photo
            if entry is None:
                self.free()
                return
            if entry.camera is not self._stands_at:
                self._push(entry.camera)
            self._show_photo(state, entry)

    def _push(self, camera: Camera) -> None:
        """Puts the view where the camera is."""
        rotation, position = self._scene.frame.pose(camera)
        direction, view = rotation[:, 2], self.client.camera
        self._stands_at = camera
        self._settling_until = time.monotonic() + SETTLE_S
        if self.mode == "move":
            depth = float((-position) @ direction)
            # The pivot lies in the object, so that the view orbits it.
            distance = depth if depth > 0.05 else 1.0
        else:
            distance = PIVOT
            if self._aim is not None:
                direction = rotation @ np.linalg.inv(camera.K) @ self._aim
                direction = direction / np.linalg.norm(direction)
        with self.client.atomic():
            _place(
                self.client,
                position,
                position + distance * direction,
                -rotation[:, 1],
            )
            if self.mode == "inspect":
                view.max_orbit_distance = PIVOT

    def _show_photo(self, state: State, entry: PhotoEntry) -> None:
        if self.mode == "move":
            self._photo.show_behind(state, entry)
        else:
            self._photo.show_plane(state, entry, self.zoom)

    # What the browser reports.

    def _on_camera(self, view: viser.CameraHandle) -> None:
        with self._lock:
            state = self._session.state
            entry = state.selected_photo
            if self.mode == "free":
                self._keep_home(state)
            elif entry is not None:
                if self.mode == "move":
                    self._show_photo(state, entry)
                    self._follow_hand(view, state, entry)
                else:
                    self._follow_eye(view, entry)

    def _follow_hand(
        self, view: viser.CameraHandle, state: State, entry: PhotoEntry
    ) -> None:
        """Move: the camera goes where the view goes."""
        if state.run.status != "idle" or entry.camera is not self._stands_at:
            return  # A view that is not yet where the camera is does not carry it.
        now, index = time.monotonic(), state.selected
        rotation = vtf.SO3(view.wxyz).as_matrix()
        moved = self._scene.frame.with_pose(
            entry.camera, rotation, np.array(view.position)
        )
        if _apart(self._scene.frame, moved, entry.camera) < ECHO_TOLERANCE:
            self._settling_until = 0.0
            return
        if now < self._settling_until:
            return
        if not self._claims.take(self.client.client_id, index, HOLD_S):
            if now - self._told_at > GESTURE_PAUSE_S:
                notify(
                    self.client,
                    "Somebody else has it",
                    f"Camera {index + 1} is being moved in another browser.",
                    False,
                )
            self._told_at = now
            self._push(entry.camera)
            return
        if now - self._last_move > GESTURE_PAUSE_S:
            self._gesture += 1
        self._last_move = now
        self._stands_at = moved
        self._session.change(
            f"Move camera {index + 1}",
            with_entry(index, camera=moved),
            ("view", self.client.client_id, self._gesture),
        )

    def _follow_eye(self, view: viser.CameraHandle, entry: PhotoEntry) -> None:
        """Look through: remembers where the view looks and how far it is zoomed in."""
        camera, frame = entry.camera, self._scene.frame
        rotation, position = frame.pose(camera)
        off = float(np.abs(np.array(view.position) - position).max())
        if off > 2.0 * PIVOT:
            if time.monotonic() >= self._settling_until:
                self._push(camera)
            return
        self._settling_until = 0.0
        if not self._photo.has_plane:
            return  # It is on its way.
        if not self._photo.fits_canvas:
            self._photo.show_plane(self._session.state, entry, self.zoom)
            return
        direction = rotation.T @ vtf.SO3(view.wxyz).as_matrix()[:, 2]
        if direction[2] > 0.1:
            self._aim = camera.K @ (direction / direction[2])
        fitting = np.tan(0.5 * self._photo.view_angle(camera))
        zoom = float(fitting / np.tan(0.5 * view.fov))
        if abs(zoom / self.zoom - 1.0) > 1e-3:
            self.zoom = zoom
            self._wake()

    def _hide(self) -> None:
        """Hides shared nodes for this browser alone, and shows the others again.

        A node of the client of the same name lies over the server's.
        """
        names = ["/clear"] if self.mode == "free" else ["/solid", "/cameras"]
        if self.mode == "free" and not self._shows_cameras:
            # While points are clicked, a camera that they have just placed stands before
            # the object, and its gizmo would take the next click.
            names.append("/cameras")
        for handle in self._hidden:
            handle.remove()
        self._hidden = [
            self.client.scene.add_frame(name, show_axes=False, visible=False)
            for name in names
        ]


def _apart(frame: DisplayFrame, first: Camera, second: Camera) -> float:
    """How far apart two poses are, in units of the page and of the rotation's entries."""
    turn = np.abs(first.R_cam_world - second.R_cam_world).max()
    return float(turn + np.abs(first.center - second.center).max() * frame.scale)


def _place(
    client: viser.ClientHandle,
    position: np.ndarray,
    look_at: np.ndarray,
    up: np.ndarray,
) -> None:
    """Sets a view exactly: viser drops a change of look_at below 1e-5 of its size."""
    camera = client.camera
    direction = look_at - position
    direction = direction / np.linalg.norm(direction)
    camera.up_direction = up
    camera.position = position
    camera.look_at = position + LONG_LOOK * direction
    camera.look_at = look_at
