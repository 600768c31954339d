"""Nine numbers that move a camera, chosen so that they do not fight each other.

Turning a camera about its own centre and shifting it look alike in the photo. Here
the object turns about a pivot (the middle of what the photo sees of it) in camera
axes, the pivot shifts in camera axes, and the focal length changes by a factor. All
are in units of the prior: 1 is one interval of the pre-registration, so the numbers
have no units and the prior's normal matrix is the identity.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.rotations import left_jacobian, rotation_matrix, rotation_vector
from photoreg.parameters.bounds import PriorScales, farthest_from
from photoreg.parameters.freedom import NOTHING_HELD, Freedom, Held

N_INCREMENTS = 9
NAMES = (
    "rotation about the photo's x axis",
    "rotation about the photo's y axis",
    "rotation in the photo's plane",
    "sideways position",
    "vertical position",
    "distance",
    "focal length",
    "principal point x",
    "principal point y",
)
"""What each increment moves, in plain words, in order."""

N_GEOMETRY = 36
"""Length of the vector in which a camera goes to the kernels; see ``geometry``."""


@dataclasses.dataclass(frozen=True, eq=False)
class Increments:
    """The map from nine numbers to a camera, around one base camera."""

    base: Camera
    """The camera at zero: the pre-registration."""
    pivot: Float[np.ndarray, "3"]
    """World point that the rotation leaves where it is."""
    scales: PriorScales
    held: Held = NOTHING_HELD
    """What stays as the base has it, to the last bit: its numbers move nothing, and so
    are always 0."""

    @property
    def distance(self) -> float:
        """Distance from the base camera's centre to the pivot, in model units."""
        return float(np.linalg.norm(self.base.center - self.pivot))

    @property
    def units(self) -> Float[np.ndarray, "9"]:
        """Size of one unit of each number: rad, rad, rad, 3 x model units, log, px, px.

        0 where nothing may move.
        """
        s = self.scales
        units = np.array(
            [float(np.deg2rad(s.rotation_deg))] * 3
            + [s.translation * self.distance] * 3
            + [s.focal]
            + [
                s.principal_point * self.base.width,
                s.principal_point * self.base.height,
            ]
        )
        return np.where(self.is_free, units, 0.0)

    @property
    def limits(self) -> Float[np.ndarray, "9"]:
        """Largest size of each number: within, every vector is a camera."""
        units, most = self.units, farthest_from(self.base, self.distance)
        return np.divide(most, units, out=np.full(9, np.inf), where=units > 0.0)

    @property
    def is_free(self) -> Bool[np.ndarray, "9"]:
        """Which numbers may move something."""
        held = self.held
        return ~np.array(
            [held.pose] * 6 + [held.focal] + [held.principal_point] * 2, dtype=bool
        )

    def camera(self, x: Float[np.ndarray, "9"]) -> Camera:
        """The camera at ``x``."""
        step = np.asarray(x) * self.units
        base = self.base
        R = rotation_matrix(step[:3]) @ base.R_cam_world
        pivot_cam = base.R_cam_world @ self.pivot + base.t_cam_world + step[3:6]
        K = base.K.copy()
        K[:2, :2] *= np.exp(step[6])
        K[:2, 2] += step[7:9]
        if self.held.pose:
            return dataclasses.replace(base, K=K)
        return Camera(K, R, pivot_cam - R @ self.pivot, base.width, base.height)

    def of_camera(self, camera: Camera) -> Float[np.ndarray, "9"]:
        """The numbers of a camera of the same photo.

        Ratio of focal lengths and skew stay the base's; other cameras are met as
        well as nine numbers can.
        """
        base = self.base
        turn = rotation_vector(camera.R_cam_world @ base.R_cam_world.T)
        shift = (
            camera.R_cam_world @ self.pivot
            + camera.t_cam_world
            - base.R_cam_world @ self.pivot
            - base.t_cam_world
        )
        log_focal = np.log(camera.focal_px / base.focal_px)
        step = np.concatenate(
            [turn, shift, [log_focal], camera.K[:2, 2] - base.K[:2, 2]]
        )
        free = self.is_free
        return np.where(free, step, 0.0) / np.where(free, self.units, 1.0)

    def geometry(
        self, x: Float[np.ndarray, "9"], width: int, height: int
    ) -> Float[np.ndarray, "36"]:
        """The camera at ``x``, for a photo resampled to width x height, for kernels.

        Layout: R (9, row by row), pivot in camera axes (3), fx, skew, fy, cx, cy (5),
        derivative of the rotation vector's action (9, row by row, in units of x),
        unit of translation, unit of log focal, units of the principal point (2), pivot
        in world axes (3), zeros.
        """
        camera = self.camera(x).resized(width, height)
        K, units = camera.K, self.units
        vector = np.zeros(N_GEOMETRY)
        vector[0:9] = camera.R_cam_world.ravel()
        vector[9:12] = camera.R_cam_world @ self.pivot + camera.t_cam_world
        vector[12:17] = K[0, 0], K[0, 1], K[1, 1], K[0, 2], K[1, 2]
        vector[17:26] = (
            left_jacobian(np.asarray(x)[:3] * units[:3]) * units[0]
        ).ravel()
        vector[26:28] = units[3], units[6]
        vector[28] = units[7] * width / self.base.width
        vector[29] = units[8] * height / self.base.height
        vector[30:33] = self.pivot
        return vector


def free_directions(
    increments: Sequence[Increments], freedom: Freedom
) -> Float[np.ndarray, "p q"]:
    """One column a number that moves by itself: 1 at each of its rows, else 0.

    The rows are the nine numbers of each camera. What is held has no column; a shared
    focal length has one, with a 1 for each camera that shares it.
    """
    free = np.concatenate([one.is_free for one in increments])
    columns = []
    for row in np.flatnonzero(free):
        camera, which = divmod(int(row), N_INCREMENTS)
        column = np.zeros(len(free))
        if NAMES[which] != "focal length":
            column[row] = 1.0
        elif freedom.leads(camera):
            group = np.array(freedom.group(camera))
            column[group * N_INCREMENTS + which] = 1.0
        else:
            continue
        columns.append(column)
    return np.column_stack(columns)
