"""One browser's view: free, or through a photo's camera with the photo behind the mesh.

viser's camera knows a vertical field of view and nothing else. So the photo is warped,
on the server, to what a centred pinhole camera of the canvas's shape would have taken;
then mesh and photo coincide whatever the principal point or fx : fy.
"""

import threading
import time
from typing import Literal

import cv2
import numpy as np
import viser
import viser.transforms as vtf

from app.home_view import home_view
from app.placement import DisplayFrame
from app.scene import Scene
from app.session import Session, with_entry
from app.state import State
from photoreg.camera import Camera

FREE_FOV = np.radians(14.0)
"""Narrow, so that the object is not dwarfed by the cameras that stand before it."""

LONG_LOOK = 10.0
ECHO_TOLERANCE = 1e-6
"""The browser answers a pose with itself, to 1e-15; a hand moves it by more."""

SETTLE_S = 10.0
"""After a pose was set the view glides there, on a slow machine for a while. Until it
has arrived, or for so long, what it reports is not the user's doing."""

GESTURE_PAUSE_S = 2.5
"""A rest of this length ends a gesture; what follows is another undo step. The browser
does not tell when the mouse is released, and draws a frame a second where it has no
graphics card and much else to do: a shorter rest would cut one drag into several steps."""

SURROUND = {True: (38, 41, 48), False: (229, 232, 237)}
"""Around the photo that is looked through, on a dark and on a light page."""

MAX_BACKGROUND_PX = 1600
FIT = 0.97

Mode = Literal["free", "move"]


class Viewport:
    """The view of one browser."""

    def __init__(
        self, client: viser.ClientHandle, session: Session, scene: Scene
    ) -> None:
        self.client = client
        self.mode: Mode = "free"
        self._session = session
        self._scene = scene
        self._lock = threading.RLock()
        self._hidden: list[viser.SceneNodeHandle] = []
        self._home: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._stands_at: Camera | None = None
        self._settling_until = 0.0
        self._at_home: tuple[np.ndarray, float] | None = None
        self._last_move = -np.inf
        self._gesture = 0
        self._background: object = None
        self._backdrop_shown = False
        self._framed: object = None
        self._hide("/clear")
        client.camera.on_update(self._on_camera)

    # What the user asks for.

    def free(self) -> None:
        """Back to the view from before looking through."""
        with self._lock:
            if self.mode == "free":
                self.go_home(self._session.state)
                return
            self.mode = "free"
            self._hide("/clear")
            dark = self._session.state.dark
            self.client.scene.set_background_image(backdrop(dark))
            self._background = None
            self._stands_at = None
            camera = self.client.camera
            if self._home is None:
                self.go_home(self._session.state)
                return
            position, look_at, up = self._home
            with self.client.atomic():
                _place(self.client, position, look_at, up)
                camera.fov = FREE_FOV

    def look_through(self) -> None:
        """Looks through the selected photo's camera; moving the view moves it."""
        with self._lock:
            if self._session.state.selected_photo is None:
                return
            if self.mode == "free":
                camera = self.client.camera
                self._home = (
                    np.array(camera.position),
                    np.array(camera.look_at),
                    np.array(camera.up_direction),
                )
                self._hide("/solid", "/cameras")
            self.mode = "move"
            self._stands_at = None
            self.show(self._session.state)

    def go_home(self, state: State) -> None:
        """The view from which mesh and cameras are all seen."""
        camera = self.client.camera
        aspect = camera.image_width / max(camera.image_height, 1)
        position, look_at = home_view(state, self._scene.frame, FREE_FOV, aspect)
        self._at_home = (position, aspect)
        with self.client.atomic():
            _place(self.client, position, look_at, np.array(state.document.up))
            camera.fov = FREE_FOV

    def _follow_window(self, state: State) -> None:
        """Fits the first view again when the canvas gets its final shape."""
        if self._at_home is None:
            return
        position, aspect = self._at_home
        camera = self.client.camera
        if np.abs(np.array(camera.position) - position).max() > ECHO_TOLERANCE:
            return  # The user has moved on, or the view is not there yet.
        if abs(camera.image_width / max(camera.image_height, 1) / aspect - 1.0) > 0.02:
            self.go_home(state)

    # What follows from a change of state.

    def show(self, state: State) -> None:
        """Brings the view in line with the state."""
        with self._lock:
            # The state may have moved on while this call waited for the lock.
            state = self._session.state
            scope = (state.document.mesh, len(state.document.photos))
            if self._framed != scope:
                self._framed = scope
                self._home = None
                if self.mode == "free":
                    self.go_home(state)
            if self.mode == "free":
                return
            entry = state.selected_photo
            if entry is None:
                self.free()
                return
            camera = entry.camera
            if camera is not self._stands_at:
                self._push(camera, state)
            self._show_background(state)

    def _push(self, camera: Camera, state: State) -> None:
        rotation, position = self._scene.frame.pose(camera)
        depth = float((-position) @ rotation[:, 2])
        if not depth > 0.05:
            depth = 1.0
        self._stands_at = camera
        self._settling_until = time.monotonic() + SETTLE_S
        with self.client.atomic():
            _place(
                self.client,
                position,
                position + depth * rotation[:, 2],
                -rotation[:, 1],
            )
        self._show_background(state)

    def _show_background(self, state: State) -> None:
        entry = state.selected_photo
        view = self.client.camera
        if entry is None or view.image_width < 2 or view.image_height < 2:
            return
        scale = min(1.0, MAX_BACKGROUND_PX / max(view.image_width, view.image_height))
        width, height = (
            round(view.image_width * scale),
            round(view.image_height * scale),
        )
        K = entry.camera.K
        key = (id(entry.photo), width, height, K.tobytes(), state.dark)
        if key == self._background:
            return
        self._background = key
        focal = fitting_focal(entry.camera, width, height)
        photo = entry.photo.resized(MAX_BACKGROUND_PX)
        camera = entry.camera.resized(photo.width, photo.height)
        warped = warped_photo(
            photo.pixels, camera, focal, width, height, SURROUND[state.dark]
        )
        with self.client.atomic():
            view.fov = 2.0 * np.arctan(0.5 * height / focal)
            self.client.scene.set_background_image(
                warped, format="jpeg", jpeg_quality=88
            )

    # What the browser reports.

    async def _on_camera(self, view: viser.CameraHandle) -> None:
        with self._lock:
            state = self._session.state
            if self.mode == "free":
                self._follow_window(state)
                return
            self._show_background(state)
            now = time.monotonic()
            entry = state.selected_photo
            if entry is None or state.run.status != "idle":
                return
            rotation = vtf.SO3(view.wxyz).as_matrix()
            moved = self._scene.frame.with_pose(
                entry.camera, rotation, np.array(view.position)
            )
            if _apart(self._scene.frame, moved, entry.camera) < ECHO_TOLERANCE:
                self._settling_until = 0.0
                return
            if now < self._settling_until:
                return
            if now - self._last_move > GESTURE_PAUSE_S:
                self._gesture += 1
            self._last_move = now
            gesture = ("view", self.client.client_id, self._gesture)
            self._stands_at = moved
            index = state.selected
            self._session.change(
                f"Move camera {index + 1}", with_entry(index, camera=moved), gesture
            )

    def _hide(self, *names: str) -> None:
        """Hides shared nodes for this browser alone, and shows the others again.

        A node of the client of the same name lies over the server's.
        """
        for handle in self._hidden:
            handle.remove()
        self._hidden = [
            self.client.scene.add_frame(name, show_axes=False, visible=False)
            for name in names
        ]


def backdrop(dark: bool) -> np.ndarray:
    """A quiet gradient behind the scene, (256, 8, 3) bytes."""
    top, bottom = (
        ((44, 49, 58), (17, 19, 23)) if dark else ((250, 250, 251), (214, 219, 226))
    )
    shade = np.linspace(0.0, 1.0, 256)[:, None, None]
    column = (1.0 - shade) * np.array(top) + shade * np.array(bottom)
    return np.repeat(np.rint(column).astype(np.uint8), 8, axis=1)


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


def fitting_focal(camera: Camera, width: int, height: int) -> float:
    """Focal length, in canvas pixels, with which the whole photo is in the canvas."""
    K = camera.K
    x = max(K[0, 2] + 0.5, camera.width - 0.5 - K[0, 2]) / K[0, 0]
    y = max(K[1, 2] + 0.5, camera.height - 0.5 - K[1, 2]) / K[1, 1]
    return FIT * min(0.5 * width / x, 0.5 * height / y)


def warped_photo(
    pixels: np.ndarray,
    camera: Camera,
    focal: float,
    width: int,
    height: int,
    around: tuple[int, int, int] = SURROUND[True],
) -> np.ndarray:
    """The photo as a camera with centred principal point and square pixels sees it.

    Canvas pixel (x, y), centre of the first at 0, shows the ray
    ((x - (w - 1) / 2) / focal, (y - (h - 1) / 2) / focal, 1).
    """
    C = np.array(
        [[focal, 0, 0.5 * (width - 1)], [0, focal, 0.5 * (height - 1)], [0, 0, 1]]
    )
    M = (C @ np.linalg.inv(camera.K))[:2]
    return cv2.warpAffine(
        pixels,
        M,
        (width, height),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=around,
    )
