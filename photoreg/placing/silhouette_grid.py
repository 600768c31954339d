"""Which views of a mesh have an outline like a given one: all views, all turns at once.

The object is looked at from viewpoints spread evenly over a sphere. Each silhouette is kept
as a polar map about its middle, scaled by its size; a turn in the photo's plane is then a
shift of the map, and the overlap of two silhouettes for all turns is one product of
Fourier transforms.
"""

import dataclasses

import numba as nb
import numpy as np
from jaxtyping import Bool, Float

from photoreg.geometry.camera import Camera, centred_intrinsics
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry

N_VIEWPOINTS = 600
"""Eight degrees apart: within reach of the fit that follows."""
N_FACES = 4_000
SIDE_PX = 96
RADII, ANGLES = 28, 90
REACH = 2.6
"""Radius that a polar map reaches, over the root of the mean square radius: a disc's rim
is at 1.4, the ends of a rod at 1.7."""
RUNG = 1.15
"""Ratio of neighbouring distances: within one, a silhouette hardly changes its shape."""
NEAREST = 1.15
"""Least distance of a viewpoint from the middle, over the radius of the mesh."""


@dataclasses.dataclass(frozen=True, eq=False)
class PolarMap:
    """A silhouette about its middle."""

    cover: Float[np.ndarray, "r a"]
    """Share covered of each cell; angles from the x axis towards the y axis."""
    middle: Float[np.ndarray, "2"]
    """In ideal coordinates (x / z, y / z)."""
    radius: float
    """Root of the mean square distance from the middle, in ideal coordinates."""


@dataclasses.dataclass(frozen=True, eq=False)
class GridPose:
    """A pose whose silhouette is like the one looked for."""

    overlap: float
    """Common area over joint area of both polar maps, 0 to 1."""
    R_cam_world: Float[np.ndarray, "3 3"]
    t_cam_world: Float[np.ndarray, "3"]


def cell_areas() -> Float[np.ndarray, "r"]:
    """Area of the cells of each radius, up to a factor."""
    return np.arange(RADII) + 0.5


@nb.njit(cache=True, nogil=True)
def polar_cover(  # noqa: ANN201
    cover: np.ndarray, column: float, row: float, radius: float
):
    """Bilinear values (RADII, ANGLES) of a cover (h, w) on circles about a pixel.

    Args:
        cover: Share covered of each pixel, float32; beyond it nothing is.
        column: Of the middle, in pixels.
        row: Likewise.
        radius: Of the silhouette, in pixels: circles reach ``REACH`` times as far.
    """
    height, width = cover.shape
    out = np.zeros((RADII, ANGLES))
    for a in range(ANGLES):
        cosine = np.cos(2.0 * np.pi * a / ANGLES)
        sine = np.sin(2.0 * np.pi * a / ANGLES)
        for r in range(RADII):
            length = (r + 0.5) / RADII * REACH * radius
            x, y = column + length * cosine, row + length * sine
            if not (0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0):
                continue
            i, j = min(int(x), width - 2), min(int(y), height - 2)
            s, t = x - i, y - j
            above = (1.0 - s) * cover[j, i] + s * cover[j, i + 1]
            below = (1.0 - s) * cover[j + 1, i] + s * cover[j + 1, i + 1]
            out[r, a] = (1.0 - t) * above + t * below
    return out


def polar_map(cover: Float[np.ndarray, "h w"], camera: Camera) -> PolarMap | None:
    """The polar map of what a camera without skew or lens sees; None if it is nothing."""
    total = float(cover.sum())
    if not total > 0.0:
        return None
    height, width = cover.shape
    x, y = np.arange(width), np.arange(height)
    columns, rows = cover.sum(axis=0), cover.sum(axis=1)
    middle = np.array([(columns * x).sum(), (rows * y).sum()]) / total
    square = (columns * (x - middle[0]) ** 2).sum() + (
        rows * (y - middle[1]) ** 2
    ).sum()
    radius_px = max(1.0, float(np.sqrt(square / total)))
    polar = polar_cover(np.asarray(cover, np.float32), middle[0], middle[1], radius_px)
    return PolarMap(
        polar, (middle - camera.K[:2, 2]) / camera.focal_px, radius_px / camera.focal_px
    )


def overlaps(
    one: Float[np.ndarray, "r a"], others: Float[np.ndarray, "n r a"]
) -> Float[np.ndarray, "n a"]:
    """Common area over joint area of a polar map and others, turned by each angle."""
    areas = cell_areas()[:, None]
    spectrum = np.fft.rfft(one * areas, axis=-1)
    common = np.fft.irfft(
        (spectrum * np.conj(np.fft.rfft(others, axis=-1))).sum(axis=-2), ANGLES, axis=-1
    )
    total = (one * areas).sum() + (others * areas).sum(axis=(-2, -1))
    return common / np.maximum(total[:, None] - common, 1e-9)


class SilhouetteGrid:
    """The silhouettes of a mesh from all around; drawn when they are asked for."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh.decimated(N_FACES)
        self.middle = mesh.bounds.mean(axis=0)
        offsets = self.mesh.vertices[self.mesh.faces].reshape(-1, 3) - self.middle
        self.radius = float(np.linalg.norm(offsets, axis=1).max())
        self._R = [_facing(direction) for direction in fibonacci_sphere(N_VIEWPOINTS)]
        self._maps: dict[tuple[int, int], PolarMap | None] = {}

    def _map(self, viewpoint: int, rung: int) -> PolarMap | None:
        key = viewpoint, rung
        if key not in self._maps:
            camera = self._camera(viewpoint, rung)
            covered = render_geometry(self.mesh, camera).covered
            self._maps[key] = polar_map(covered.astype(np.float32), camera)
        return self._maps[key]

    def _distance(self, rung: int) -> float:
        return self.radius * NEAREST * RUNG**rung

    def _camera(self, viewpoint: int, rung: int) -> Camera:
        """A camera in which the sphere around the mesh just fits."""
        distance = self._distance(rung)
        tangent = self.radius / np.sqrt(distance**2 - self.radius**2)
        focal_px = (0.5 * SIDE_PX - 2.0) / tangent
        K = centred_intrinsics(focal_px, SIDE_PX, SIDE_PX)
        R = self._R[viewpoint]
        t = np.array([0.0, 0.0, distance]) - R @ self.middle
        return Camera(K, R, t, SIDE_PX, SIDE_PX)

    def _fitting(self, viewpoint: int, radius: float, rung: int) -> int:
        """The rung from which a silhouette is as large as one of ``radius``."""
        for _ in range(2):
            found = self._map(viewpoint, rung)
            if found is None:
                return rung
            ratio = found.radius / radius
            rung = max(0, rung + round(np.log(ratio) / np.log(RUNG)))
        return rung

    def poses(
        self, covered: Bool[np.ndarray, "h w"], camera: Camera, n: int
    ) -> list[GridPose]:
        """The poses in which the mesh covers most nearly what is covered, best first.

        No two of them are nearer to each other than ``APART_DEG``.

        Args:
            covered: The object in a photo.
            camera: Of the photo, at the size of ``covered``; its pose counts for nothing.
            n: How many at most.
        """
        R_centred, target = _centred(covered, camera)
        if target is None:
            return []
        rung, rungs = self._fitting(0, target.radius, 5), []
        for viewpoint in range(N_VIEWPOINTS):
            rung = self._fitting(viewpoint, target.radius, rung)
            rungs.append(rung)
        maps = [self._map(viewpoint, rung) for viewpoint, rung in enumerate(rungs)]
        kept = [i for i, one in enumerate(maps) if one is not None]
        covers = np.stack([one.cover for one in maps if one is not None])
        scores = overlaps(target.cover, covers)
        ranked = np.argsort(-scores.ravel(), kind="stable")
        chosen: list[GridPose] = []
        for flat in ranked[: 40 * n]:
            i, turn = divmod(int(flat), ANGLES)
            viewpoint = kept[i]
            seen = maps[viewpoint]
            assert seen is not None
            roll = _about_z(2.0 * np.pi * turn / ANGLES)
            R_virtual = roll @ self._R[viewpoint]
            R = R_centred.T @ R_virtual
            if any(angle_deg(R, other.R_cam_world) < APART_DEG for other in chosen):
                continue
            distance = self._distance(rungs[viewpoint]) * seen.radius / target.radius
            # The silhouette's middle onto the middle of what is covered.
            shift = target.middle - roll[:2, :2] @ seen.middle
            middle = R_centred.T @ (distance * np.array([*shift, 1.0]))
            chosen.append(
                GridPose(float(scores.ravel()[flat]), R, middle - R @ self.middle)
            )
            if len(chosen) == n:
                break
        return chosen


APART_DEG = 9.0
"""Poses nearer than this lead to the same end: the viewpoints' own spacing, and a bit."""


def angle_deg(R_a: Float[np.ndarray, "3 3"], R_b: Float[np.ndarray, "3 3"]) -> float:
    """Angle of the turn between two rotations, in degrees."""
    cosine = 0.5 * ((R_a * R_b).sum() - 1.0)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def fibonacci_sphere(n: int) -> Float[np.ndarray, "n 3"]:
    """Unit vectors spread evenly over the sphere."""
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])


def _facing(direction: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """A rotation, world to camera, that looks along -``direction``."""
    up = np.eye(3)[np.argmin(np.abs(direction))]
    return Camera.look_at(direction, np.zeros(3), up, 1.0, 16, 16).R_cam_world


def _about_z(angle_rad: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _centred(
    covered: np.ndarray, camera: Camera
) -> tuple[Float[np.ndarray, "3 3"], PolarMap | None]:
    """The photo turned so that the object is in its middle, and the polar map there.

    In perspective an object off the middle looks longer than it would in it.
    """
    rows, columns = np.nonzero(covered)
    if len(rows) == 0:
        return np.eye(3), None
    middle = np.array([[columns.mean(), rows.mean()]])
    _, ray = camera.rays(middle)
    axis = camera.R_cam_world @ ray[0]
    right = np.cross([0.0, 1.0, 0.0], axis)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(axis, right), axis])
    reach = np.hypot(columns - middle[0, 0], rows - middle[0, 1]).max() + 2.0
    focal_px = camera.focal_px * (0.5 * SIDE_PX - 2.0) / reach
    K = centred_intrinsics(focal_px, SIDE_PX, SIDE_PX)
    virtual = Camera(K, np.eye(3), np.zeros(3), SIDE_PX, SIDE_PX)
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX].reshape(2, -1)
    ideal = (np.stack([x, y]) - K[0, 2]) / focal_px
    seen = R.T @ np.vstack([ideal, np.ones(ideal.shape[1])])
    plain = dataclasses.replace(camera, R_cam_world=np.eye(3), t_cam_world=np.zeros(3))
    pixels = plain.project(seen.T)
    nearest = np.nan_to_num(np.rint(pixels), nan=-1.0).astype(int)
    inside = plain.contains(nearest.astype(float))
    cover = np.zeros(len(nearest), np.float32)
    cover[inside] = covered[nearest[inside, 1], nearest[inside, 0]]
    return R, polar_map(cover.reshape(SIDE_PX, SIDE_PX), virtual)
