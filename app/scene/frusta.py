"""The cameras in the 3-D scene: a frustum a photo, and where each one started."""

import numpy as np
import viser
import viser.transforms as vtf

from app.model.camera_moves import DisplayFrame, frustum_corners
from app.model.state import PhotoEntry, State
from app.web.controls import put
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.imaging.undistort import undistorted_photo

SELECTED_COLOUR = (45, 190, 175)
FRUSTUM_COLOUR = (140, 150, 170)
GHOST_COLOUR = (120, 120, 130)
IMAGE_SIDE_PX = 640


class Frusta:
    """All cameras of the state."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._frusta: list[Frustum] = []
        self._ghosts: list[viser.LineSegmentsHandle] = []
        self._ghosts_of: tuple[Camera, ...] = ()

    def show(self, state: State, frame: DisplayFrame) -> None:
        """Makes the nodes as ``state`` has them; sends only what changed."""
        photos = state.photos
        while len(self._frusta) > len(photos):
            self._frusta.pop().remove()
        for i, entry in enumerate(photos):
            if i == len(self._frusta):
                self._frusta.append(Frustum(self._server, f"/cameras/{i}"))
            self._frusta[i].show(entry, frame, i == state.selected)
        starts = state.run.start if state.run.status != "idle" else ()
        self._show_ghosts(starts, frame)

    def _show_ghosts(self, cameras: tuple[Camera, ...], frame: DisplayFrame) -> None:
        """Thin outlines where the cameras were when the refinement started."""
        if cameras is self._ghosts_of:
            return
        self._ghosts_of = cameras
        for ghost in self._ghosts:
            ghost.remove()
        self._ghosts = []
        for i, camera in enumerate(cameras):
            rotation, position = frame.pose(camera)
            corners = frustum_corners(camera) @ rotation.T + position
            self._ghosts.append(
                self._server.scene.add_line_segments(
                    f"/cameras/start-{i}",
                    frustum_lines(position, corners),
                    colors=GHOST_COLOUR,
                    thickness=1.0,
                    thickness_units="screen",
                )
            )


class Frustum:
    """One photo in the scene: lines from the camera's centre, and the photo itself.

    Made from K by hand; viser's own frustum has no principal point. The photo is shown
    undistorted, as far as the lens is known.
    """

    def __init__(self, server: viser.ViserServer, name: str) -> None:
        self._scene = server.scene
        self._name = name
        self._root = server.scene.add_frame(name, show_axes=False)
        self._lines: viser.LineSegmentsHandle | None = None
        self._image: viser.ImageHandle | None = None
        self._photo: object = None
        self._K: np.ndarray | None = None
        self._lens: Lens | None = None

    def show(self, entry: PhotoEntry, frame: DisplayFrame, selected: bool) -> None:
        """Makes the nodes as ``entry`` has them."""
        camera = entry.camera
        rotation, position = frame.pose(camera)
        self._root.wxyz = vtf.SO3.from_matrix(rotation).wxyz
        self._root.position = position
        if (
            self._photo is not entry.photo
            or self._K is None
            or not np.array_equal(self._K, camera.K)
            or self._lens != camera.lens
        ):
            self._draw(entry)
        assert self._lines is not None
        assert self._image is not None
        colour = SELECTED_COLOUR if selected else FRUSTUM_COLOUR
        if not np.array_equal(self._lines.colors, colour):
            self._lines.colors = np.array(colour, dtype=np.uint8)
        put(self._lines, "thickness", 3.0 if selected else 1.6)
        put(self._image, "visible", entry.enabled)

    def _draw(self, entry: PhotoEntry) -> None:
        camera = entry.camera
        corners = frustum_corners(camera)
        lines = frustum_lines(np.zeros(3), corners)
        width = float(np.linalg.norm(corners[1] - corners[0]))
        height = float(np.linalg.norm(corners[3] - corners[0]))
        centre = corners.mean(axis=0)
        if self._lines is None:
            self._lines = self._scene.add_line_segments(
                f"{self._name}/lines",
                lines,
                colors=FRUSTUM_COLOUR,
                thickness=1.6,
                thickness_units="screen",
            )
        else:
            self._lines.points = lines.astype(np.float32)
        is_new = self._photo is not entry.photo or self._lens != camera.lens
        if is_new or self._image is None:
            small = entry.photo.resized(IMAGE_SIDE_PX)
            self._image = self._scene.add_image(
                f"{self._name}/photo",
                undistorted_photo(small, camera).pixels,
                width,
                height,
                format="jpeg",
                jpeg_quality=85,
                cast_shadow=False,
                receive_shadow=False,
                position=centre,
            )
        else:
            self._image.render_width = width
            self._image.render_height = height
            self._image.position = centre
        self._photo, self._K, self._lens = entry.photo, camera.K, camera.lens

    def remove(self) -> None:
        """Takes the nodes out of the scene."""
        self._root.remove()


def frustum_lines(apex: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Segments (8, 2, 3): apex to each corner, and around the corners."""
    spokes = [[apex, corner] for corner in corners]
    sides = [[corners[i], corners[(i + 1) % 4]] for i in range(4)]
    return np.array(spokes + sides)
