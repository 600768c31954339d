"""The photo that is looked through, in one browser: behind the scene, or within it.

In *Move the camera* it is the background, warped to the canvas. In *Look through* it is a plane that stands
beyond the object, where K says, so that any zoom shows both together. Either way it is
undistorted, as browsers draw the mesh without a lens.
"""

import dataclasses
import itertools
import json
from collections.abc import Callable

import cv2
import numpy as np
import viser
import viser.transforms as vtf

from app.model.markup import mounted
from app.model.state import PhotoEntry, State
from app.scene.canvas import (
    SURROUND,
    backdrop,
    brightened,
    far_depth,
    fitting_focal,
    photo_plane,
    view_angle,
    warped_photo,
    without_skew,
)
from app.scene.nodes import SceneNodes
from app.web.controls import put, put_jpeg
from photoreg.geometry.camera import Camera
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo

MAX_BACKGROUND_PX = 1600
MAX_PLANE_PX = 4096


@dataclasses.dataclass(frozen=True)
class Plane:
    """The photo as it stands in the scene in *Look through*."""

    root: viser.SceneNodeHandle
    image: viser.ImageHandle
    photo: object
    """What it shows, to tell whether that has changed."""


class PhotoView:
    """What one browser has behind its mesh; sends only what changed."""

    def __init__(self, client: viser.ClientHandle, scene: SceneNodes) -> None:
        self.client = client
        self._scene = scene
        self._background: object = None
        self._plane: Plane | None = None
        self._canvas = (0, 0)
        self._small: tuple[Photo, Photo] | None = None
        self._script = client.gui.add_html("")
        self._fit = "null"
        self._count = itertools.count()

    @property
    def has_plane(self) -> bool:
        """Whether the photo stands in the scene already."""
        return self._plane is not None

    @property
    def fits_canvas(self) -> bool:
        """Whether the plane was last shown on a canvas of the size of now."""
        view = self.client.camera
        return (view.image_width, view.image_height) == self._canvas

    def show_none(self, dark: bool) -> None:
        """The free view's background."""
        self._set_background(("free", dark), lambda: backdrop(dark))

    def show_behind(self, state: State, entry: PhotoEntry) -> None:
        """Move: the photo as the background, glued to the canvas."""
        view = self.client.camera
        if view.image_width < 2 or view.image_height < 2:
            return
        scale = min(1.0, MAX_BACKGROUND_PX / max(view.image_width, view.image_height))
        width = round(view.image_width * scale)
        height = round(view.image_height * scale)
        focal = fitting_focal(entry.camera, width, height)
        view.fov = view_angle(focal, height)
        picture, gain = _shown(state, entry), state.photo_gain

        def warped() -> np.ndarray:
            photo = (
                self._reduced(entry.photo)
                if picture is None
                else Photo(entry.name, _decoded(picture))
            )
            camera = entry.camera.resized(photo.width, photo.height)
            if picture is None:  # The worker's is undistorted already.
                photo = undistorted_photo(photo, camera)
            around = SURROUND[state.dark]
            pixels = photo.pixels
            if picture is None:
                pixels = brightened(pixels, gain)
            return warped_photo(pixels, camera, focal, width, height, around)

        shown = entry.photo if picture is None else picture
        optics = entry.camera.K.tobytes(), entry.camera.lens
        look = state.dark, gain
        self._set_background(("move", shown, width, height, optics, look), warped)

    def _reduced(self, photo: Photo) -> Photo:
        """The photo as small as a background may be, kept: the lens changes often."""
        if self._small is None or self._small[0] is not photo:
            self._small = (photo, photo.resized(MAX_BACKGROUND_PX))
        return self._small[1]

    def show_plane(self, state: State, entry: PhotoEntry, zoom: float) -> None:
        """Look through: the photo as a plane in the scene, beyond the object."""
        camera, frame, mesh = entry.camera, self._scene.frame, state.document.mesh
        around = np.full((4, 4, 3), SURROUND[state.dark], dtype=np.uint8)
        self._set_background(("inspect", state.dark), lambda: around)
        rotation, position = frame.pose(camera)
        picture = _shown(state, entry)
        gain = state.photo_gain
        own = entry.photo, camera.lens, gain
        shown = own if picture is None else picture
        plane = self._plane
        bounds = np.array([[-1.0] * 3, [1.0] * 3]) if mesh is None else mesh.bounds
        width, height, centre = photo_plane(camera, far_depth(frame, camera, bounds))
        if plane is None:
            root = self.client.scene.add_frame("/through", show_axes=False)
            image = self.client.scene.add_image(
                "/through/photo",
                _plane_pixels(entry, gain),
                width,
                height,
                format="jpeg",
                jpeg_quality=90,
                cast_shadow=False,
                receive_shadow=False,
            )
            plane = Plane(root, image, own)
        if plane.photo != shown:
            if picture is None:
                plane.image.image = _plane_pixels(entry, gain)
            else:
                put_jpeg(plane.image, picture)
        with self.client.atomic():
            plane.root.wxyz = vtf.SO3.from_matrix(rotation).wxyz
            plane.root.position = position
            put(plane.image, "render_width", width)
            put(plane.image, "render_height", height)
            plane.image.position = centre
        self._plane = Plane(plane.root, plane.image, shown)
        view = self.client.camera
        self._canvas = (view.image_width, view.image_height)
        view.fov = self.view_angle(camera, zoom)
        self._inspect(round(float(np.degrees(self.view_angle(camera))), 9))

    def remove_plane(self) -> None:
        """Ends *Look through*: the wheel and the mouse work as before, too."""
        if self._plane is not None:
            self._plane.root.remove()
            self._plane = None
        self._inspect(None)

    def view_angle(self, camera: Camera, zoom: float = 1.0) -> float:
        """Vertical field of view, in radians, that shows 1/zoom of the photo."""
        view = self.client.camera
        width, height = max(view.image_width, 2), max(view.image_height, 2)
        focal = fitting_focal(camera, width, height)
        return view_angle(focal * zoom, height)

    def _set_background(self, key: object, picture: Callable[[], np.ndarray]) -> None:
        """Sends the background that ``picture`` makes, unless it is there already."""
        if key == self._background:
            return
        self._background = key
        self.client.scene.set_background_image(
            picture(), format="jpeg", jpeg_quality=88
        )

    def _inspect(self, fit_deg: float | None) -> None:
        """Tells this browser which view angle shows the whole photo; None: not there."""
        fit = json.dumps(fit_deg)
        if self._fit == fit:
            return
        self._fit = fit
        # The number makes it new to the page, which hears only of what has changed.
        count = str(next(self._count))
        self._script.content = mounted("inspect", fit=fit, count=count)


def _shown(state: State, entry: PhotoEntry) -> bytes | None:
    """The worker's picture that takes the photo's place, a JPEG file; or none."""
    drawn = state.drawn
    if drawn is None or drawn.onto != entry.name or not entry.enabled:
        return None
    if state.through_style == "photo":
        return state.picture
    return drawn.normals_jpeg if state.through_style == "normals" else None


def _plane_pixels(entry: PhotoEntry, gain: float) -> np.ndarray:
    photo = entry.photo.resized(MAX_PLANE_PX)
    camera = entry.camera.resized(photo.width, photo.height)
    pixels = without_skew(undistorted_photo(photo, camera).pixels, camera)
    return brightened(pixels, gain)


def _decoded(jpeg: bytes) -> np.ndarray:
    data = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert data is not None, "The worker writes valid files."
    return cv2.cvtColor(data, cv2.COLOR_BGR2RGB)
