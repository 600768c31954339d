"""First cameras, focal length changes, and the frame in which the page draws.

Pure geometry: no viser, no state.
"""

import dataclasses

import numpy as np

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo

FIRST_FIELD_OF_VIEW_DEG = 50.0
"""Field of view over the longer side of a photo whose EXIF does not tell."""

FRAME_SHARE = 0.8
"""Share of the frame that the object may fill in a first camera."""

STEP_ASIDE_DEG = 20.0
"""How far apart first cameras stand, seen from the object."""

FRUSTUM_WIDTH = 1.1
"""Diagonal of the photo in a frustum, in page units (the mesh's diagonal is 2)."""


@dataclasses.dataclass(frozen=True)
class DisplayFrame:
    """World axes to the page's and back: x_page = (x_world - origin) * scale.

    viser drops pose changes below 1e-5 of the value, and its keys move two units a
    second: the object must be of size O(1) around the origin, whatever its units.
    """

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0

    @classmethod
    def of(cls, mesh: Mesh) -> "DisplayFrame":
        """The frame in which the mesh's box has a diagonal of 2 about the origin."""
        x, y, z = (float(v) for v in mesh.bounds.mean(axis=0))
        return cls((x, y, z), 2.0 / mesh.diagonal)

    def to_page(self, points: np.ndarray) -> np.ndarray:
        """Points in world axes to the page's."""
        return (np.asarray(points) - np.array(self.origin)) * self.scale

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points in the page's axes to world axes."""
        return np.asarray(points) / self.scale + np.array(self.origin)

    def pose(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """A camera's R_page_cam and its centre in the page's axes."""
        return camera.R_cam_world.T, self.to_page(camera.center)

    def with_pose(
        self, camera: Camera, R_page_cam: np.ndarray, position: np.ndarray
    ) -> Camera:
        """The camera moved to a pose given in the page's axes."""
        R = R_page_cam.T
        return dataclasses.replace(
            camera, R_cam_world=R, t_cam_world=-R @ self.to_world(position)
        )


def guessed_focal_px(photo: Photo) -> float:
    """The focal length that a first camera has where EXIF does not tell, in pixels."""
    half = np.tan(np.radians(FIRST_FIELD_OF_VIEW_DEG) / 2)
    return 0.5 * max(photo.width, photo.height) / float(half)


def first_camera(
    mesh: Mesh | None,
    photo: Photo,
    up: tuple[float, float, float],
    others: tuple[Camera, ...] = (),
) -> Camera:
    """A sensible camera for a new photo: in front of the object, object in frame.

    The first stands level, along the axis in which the object is thinnest (scans lie
    broadside); the next step aside from the first, 20 degrees each.
    """
    focal_px = photo.exif_focal_px
    if focal_px is None:
        focal_px = guessed_focal_px(photo)
    up_axis = np.array(up) / np.linalg.norm(up)
    if mesh is None:
        target, toward = np.zeros(3), _horizontal(np.array([0.0, 0.0, 1.0]), up_axis)
        points = np.concatenate([np.eye(3), -np.eye(3)])
    else:
        target = mesh.bounds.mean(axis=0)
        points = mesh.vertices[:: max(1, len(mesh.vertices) // 20_000)]
        if others:
            toward = _horizontal(others[0].center - target, up_axis)
        else:
            extent = mesh.bounds[1] - mesh.bounds[0]
            # Of two equally thin axes the later: cameras look along z by habit.
            axis = 2 - int(np.argmin((extent + 1e9 * np.abs(up_axis))[::-1]))
            toward = _horizontal(np.eye(3)[axis], up_axis)
    toward = _turned(toward, up_axis, np.radians(STEP_ASIDE_DEG) * len(others))
    facing = Camera.look_at(
        target + toward, target, up_axis, focal_px, photo.width, photo.height
    )
    x, y, z = ((points - target) @ facing.R_cam_world.T).T
    distance = max(
        float((np.abs(x) * focal_px / (0.5 * FRAME_SHARE * photo.width) - z).max()),
        float((np.abs(y) * focal_px / (0.5 * FRAME_SHARE * photo.height) - z).max()),
    )
    camera = Camera.look_at(
        target + distance * toward, target, up_axis, focal_px, photo.width, photo.height
    )
    known = photo.known_lens
    return camera if known is None else camera.with_lens(known.lens)


def with_focal(
    camera: Camera, focal_px: float, keep_size_at: np.ndarray | None = None
) -> Camera:
    """The camera with another focal length.

    With ``keep_size_at`` (a world point, the object's centre) the camera also moves
    along its axis so that the object keeps its size in the photo: f / Z stays, which
    is eq. 4 of the paper.

    Raises:
        InputError: if the focal length is not positive and finite.
    """
    if not np.isfinite(focal_px) or focal_px <= 0.0:
        raise InputError(
            f"A focal length should be a positive number of pixels, not {focal_px:g}."
        )
    ratio = focal_px / camera.focal_px
    K = camera.K.copy()
    K[0, :2] *= ratio
    K[1, 1] *= ratio
    t = camera.t_cam_world.copy()
    if keep_size_at is not None:
        depth = float(camera.to_camera(keep_size_at[None])[0, 2])
        t[2] += max(depth, 0.0) * (ratio - 1.0)
    return dataclasses.replace(camera, K=K, t_cam_world=t)


def rolled(camera: Camera, angle_deg: float) -> Camera:
    """The camera turned about its own axis, clockwise as seen in the photo."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    roll = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return dataclasses.replace(
        camera,
        R_cam_world=roll @ camera.R_cam_world,
        t_cam_world=roll @ camera.t_cam_world,
    )


def orbited(camera: Camera, anchor: np.ndarray, turn: np.ndarray) -> Camera:
    """The camera carried about ``anchor``, a world point, by the rotation ``turn``.

    It keeps its distance, and the anchor its place in the photo.
    """
    R = camera.R_cam_world @ turn.T
    centre = anchor + turn @ (camera.center - anchor)
    return dataclasses.replace(camera, R_cam_world=R, t_cam_world=-R @ centre)


def orbit_axes(toward: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Axes of the orbit about the object, as columns: level, upwards, to the camera.

    Args:
        toward: From the object to the camera.
        up: Upwards.
    """
    up = up / np.linalg.norm(up)
    level = _horizontal(toward, up)
    return np.column_stack([np.cross(up, level), up, level])


def nudged(
    camera: Camera, anchor: np.ndarray, right_px: float, down_px: float, nearer: float
) -> Camera:
    """The camera moved so that ``anchor`` moves by so many pixels in the photo.

    Args:
        camera: The camera; it keeps its directions.
        anchor: A world point before the camera, such as the object's centre.
        right_px: Pixels that the anchor moves to the right.
        down_px: Pixels that it moves downwards.
        nearer: Share of its depth by which it comes nearer after that.

    Raises:
        InputError: if the anchor is not in front of the camera.
    """
    at = camera.to_camera(anchor[None])[0]
    if not at[2] > 0.0:
        raise InputError(
            "The object is behind this camera. Turn the camera towards it first."
        )
    way = np.linalg.solve(camera.K, (right_px, down_px, 0.0)) * at[2]
    moved = (at + way) * (1.0 - nearer)
    return dataclasses.replace(camera, t_cam_world=camera.t_cam_world + moved - at)


def frustum_corners(camera: Camera) -> np.ndarray:
    """Corners of the photo in camera axes, (4, 3), in page units, from top left."""
    right, bottom = camera.width - 0.5, camera.height - 0.5
    pixels = np.array(
        [[-0.5, -0.5, 1], [right, -0.5, 1], [right, bottom, 1], [-0.5, bottom, 1]]
    )
    corners = pixels @ np.linalg.inv(camera.K).T
    return corners * (FRUSTUM_WIDTH / np.linalg.norm(corners[2] - corners[0]))


def up_of(cameras: tuple[Camera, ...]) -> tuple[float, float, float] | None:
    """Upwards as most of the photos have it: the mean of their -y axes."""
    if not cameras:
        return None
    mean = -np.mean([camera.R_cam_world[1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(mean))
    if length < 0.3:
        return None
    x, y, z = (float(v) for v in mean / length)
    return x, y, z


def _horizontal(direction: np.ndarray, up: np.ndarray) -> np.ndarray:
    flat = direction - up * (direction @ up)
    length = np.linalg.norm(flat)
    if length < 1e-6 * max(float(np.linalg.norm(direction)), 1e-300):
        spare = np.eye(3)[int(np.argmin(np.abs(up)))]
        flat = spare - up * (spare @ up)
        length = np.linalg.norm(flat)
    return flat / length


def _turned(direction: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' rotation of ``direction`` about the unit ``axis``."""
    return (
        direction * np.cos(angle)
        + np.cross(axis, direction) * np.sin(angle)
        + axis * (axis @ direction) * (1.0 - np.cos(angle))
    )
