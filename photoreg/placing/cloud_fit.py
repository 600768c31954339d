"""A mesh fitted to points of unknown scale: many starts, nearest places, planes.

Iterated closest points with a scale, from viewpoints all around the mesh. Distances are
measured against how far a point is from the camera: against the mesh's size the best fit
would be a camera that dives into it.
"""

import dataclasses

import numba as nb
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rotations import rotation_matrix
from photoreg.geometry.sampling import sample_surface
from photoreg.placing.silhouette_grid import angle_deg, fibonacci_sphere

GRID = 72
"""Cells of the nearest-place grid along the longest side."""
MARGIN = 0.5
"""How far the grid goes beyond the mesh, over its longest side."""
N_SURFACE = 20_000
N_VIEWPOINTS, N_TURNS = 120, 18
FILLS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
"""Sizes of the mesh's sphere in the photo that are started from, over its longer side."""
N_POINTS = 250
STEPS, LAST_STEPS = 14, 12
FIRST_SCALE, LAST_SCALE = 0.1, 0.01
"""Scale of the robust cost at the first and the last step, over a point's distance."""
N_KEPT = 2_000
"""Starts that are fitted further: a wrong face often takes more points than the right one."""
SAME_DEG, SAME_DISTANCE = 4.0, 0.05
"""Ends nearer than this are one; the distance over that to the mesh's middle."""


@dataclasses.dataclass(frozen=True, eq=False)
class CloudPose:
    """Where a camera stands whose points lie on the mesh."""

    R_cam_world: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, "3"]
    scale: float
    """Model units to a unit of the points."""
    share: float
    """Share of the points that lie on the mesh, robustly."""


class CloudFit:
    """Fits one mesh to any number of point clouds."""

    def __init__(self, mesh: Mesh) -> None:
        samples = sample_surface(mesh, N_SURFACE, 0)
        self._points, self._normals = samples.points, samples.normals
        low, high = mesh.bounds
        self.middle = 0.5 * (low + high)
        self.radius = 0.5 * float(np.linalg.norm(high - low))
        longest = float((high - low).max())
        self._cell = longest * (1.0 + 2.0 * MARGIN) / GRID
        self._origin = low - MARGIN * longest
        sizes = np.ceil((high - low + 2.0 * MARGIN * longest) / self._cell).astype(int)
        cells = np.stack(np.meshgrid(*map(np.arange, sizes), indexing="ij"), axis=-1)
        places = self._origin + (cells + 0.5) * self._cell
        _, nearest = KDTree(self._points).query(places.reshape(-1, 3))
        self._nearest = nearest.reshape(sizes).astype(np.int32)

    def poses(
        self, points: Float[np.ndarray, "n 3"], focal_share: float, n: int
    ) -> list[CloudPose]:
        """Poses in which most points lie on the mesh, the best first.

        Args:
            points: In camera axes; at most ``N_POINTS`` are used.
            focal_share: Focal length over the photo's longer side.
            n: How many at most.
        """
        points = np.ascontiguousarray(points[:: max(1, len(points) // N_POINTS)])
        starts = self._starts(points, focal_share)
        for steps, first, last in (
            (STEPS, FIRST_SCALE, 3.0 * LAST_SCALE),
            (LAST_STEPS, 3.0 * LAST_SCALE, LAST_SCALE),
        ):
            scales = np.geomspace(first, last, steps)
            shares = _fit(
                points,
                starts,
                scales,
                self._nearest,
                self._origin,
                self._cell,
                self._points,
                self._normals,
            )
            order = np.argsort(-shares, kind="stable")[:N_KEPT]
            starts, shares = starts[order], shares[order]
        kept: list[CloudPose] = []
        for start, share in zip(starts, shares, strict=True):
            pose = _pose(start, float(share))
            reach = SAME_DISTANCE * float(np.linalg.norm(pose.center - self.middle))
            if not any(
                angle_deg(pose.R_cam_world, other.R_cam_world) < SAME_DEG
                and np.linalg.norm(pose.center - other.center) < reach
                for other in kept
            ):
                kept.append(pose)
            if len(kept) == n:
                break
        return kept

    def _starts(
        self, points: np.ndarray, focal_share: float
    ) -> Float[np.ndarray, "m 12"]:
        """Center, and the rotation to world axes times the scale, row by row."""
        forward = np.median(points / points[:, 2:], axis=0)
        forward /= np.linalg.norm(forward)
        depth = float(np.median(points @ forward))
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        # Rows: axes of a camera that looks straight at the points.
        to_middle = np.stack([right, np.cross(forward, right), forward])
        starts = []
        for direction in fibonacci_sphere(N_VIEWPOINTS):
            up = np.eye(3)[np.argmin(np.abs(direction))]
            x = np.cross(up, -direction)
            x /= np.linalg.norm(x)
            facing = np.stack([x, np.cross(-direction, x), -direction])
            for turn in range(N_TURNS):
                roll = rotation_matrix(
                    np.array([0.0, 0.0, 2.0 * np.pi * turn / N_TURNS])
                )
                R_world_cam = (roll @ facing).T @ to_middle
                for fill in FILLS:
                    distance = self.radius * 2.0 * focal_share / fill
                    distance = max(distance, 1.05 * self.radius)
                    center = self.middle + distance * direction
                    scale = (distance - 0.5 * self.radius) / depth
                    starts.append(
                        np.concatenate([center, (scale * R_world_cam).ravel()])
                    )
        return np.array(starts)


def _pose(start: np.ndarray, share: float) -> CloudPose:
    scale = float(np.linalg.norm(start[3:6]))
    return CloudPose(start[3:].reshape(3, 3).T / scale, start[:3], scale, share)


@nb.njit(cache=True, nogil=True)
def _fit(points, starts, scales, nearest, origin, cell, surface, normals):  # noqa: ANN001, ANN202
    """Moves every start in place; returns the robust share of points on the mesh."""
    n_starts, n = len(starts), len(points)
    shares = np.zeros(n_starts)
    A = np.zeros((7, 7))
    g = np.zeros(7)
    row = np.zeros(7)
    for s in range(n_starts):
        center = starts[s, :3].copy()
        M = starts[s, 3:].copy().reshape(3, 3)
        for step in range(len(scales) + 1):
            last = step == len(scales)
            sigma = scales[min(step, len(scales) - 1)]
            A[:] = 0.0
            g[:] = 0.0
            share = 0.0
            for k in range(n):
                dx = (
                    M[0, 0] * points[k, 0]
                    + M[0, 1] * points[k, 1]
                    + M[0, 2] * points[k, 2]
                )
                dy = (
                    M[1, 0] * points[k, 0]
                    + M[1, 1] * points[k, 1]
                    + M[1, 2] * points[k, 2]
                )
                dz = (
                    M[2, 0] * points[k, 0]
                    + M[2, 1] * points[k, 1]
                    + M[2, 2] * points[k, 2]
                )
                X, Y, Z = center[0] + dx, center[1] + dy, center[2] + dz
                u = (X - origin[0]) / cell
                v = (Y - origin[1]) / cell
                w = (Z - origin[2]) / cell
                if not (
                    0.0 <= u < nearest.shape[0]
                    and 0.0 <= v < nearest.shape[1]
                    and 0.0 <= w < nearest.shape[2]
                ):
                    continue
                q = nearest[int(u), int(v), int(w)]
                nx, ny, nz = normals[q, 0], normals[q, 1], normals[q, 2]
                if nx * dx + ny * dy + nz * dz >= 0.0:
                    continue
                far2 = dx * dx + dy * dy + dz * dz
                ex, ey, ez = X - surface[q, 0], Y - surface[q, 1], Z - surface[q, 2]
                r = nx * ex + ny * ey + nz * ez
                # Beside the surface, as beyond its border, the plane says nothing.
                beside2 = max(
                    ex * ex + ey * ey + ez * ez - r * r - 4.0 * cell * cell, 0.0
                )
                scale2 = sigma * sigma * far2
                weight = 1.0 / (1.0 + (r * r + beside2) / scale2) ** 2
                share += np.sqrt(weight)
                weight /= scale2
                row[0] = nx * dx + ny * dy + nz * dz
                row[1] = dy * nz - dz * ny
                row[2] = dz * nx - dx * nz
                row[3] = dx * ny - dy * nx
                row[4], row[5], row[6] = nx, ny, nz
                for i in range(7):
                    g[i] -= weight * row[i] * r
                    for j in range(i + 1):
                        A[i, j] += weight * row[i] * row[j]
            shares[s] = share / n
            if last or share < 3.0:
                break
            for i in range(7):
                for j in range(i):
                    A[j, i] = A[i, j]
                A[i, i] = A[i, i] * 1.001 + 1e-12
            x = np.linalg.solve(A, g)
            size = np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2 + x[3] ** 2)
            if size > 0.3:
                x *= 0.3 / size
            turn = _rotation(x[1:4])
            M = np.exp(x[0]) * (turn @ M)
            center += x[4:]
        starts[s, :3] = center
        starts[s, 3:] = M.ravel()
    return shares


@nb.njit(cache=True, nogil=True)
def _rotation(v):  # noqa: ANN001, ANN202
    angle = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    if angle < 1e-12:
        return np.eye(3) + K
    K /= angle
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
