"""Polygons cut into triangles inside their outline."""

import mapbox_earcut
import numpy as np
from jaxtyping import Float, Int

from photoreg.errors import InputError


def triangle_corners(
    vertices: Float[np.ndarray, "n 3"],
    corners: Int[np.ndarray, "k"],
    counts: Int[np.ndarray, "p"],
    name: str,
) -> tuple[Int[np.ndarray, "m 3"], Int[np.ndarray, "m"]]:
    """Cuts polygons into triangles, wound as they are, in their order.

    A triangle is itself; a quadrangle is cut along a diagonal that lies inside; larger
    ones are cut by their ears in the plane that fits them best.

    Args:
        vertices: Vertex positions.
        corners: The vertices of all polygons, one polygon after the other.
        counts: How many corners each polygon has.
        name: File name, for messages.

    Returns:
        For each triangle the rows of ``corners`` that are its corners, and its polygon.

    Raises:
        InputError: if a polygon names a vertex that does not exist, has fewer than
            three corners, or cannot be cut.
    """
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
        wrong = corners.min() if corners.min() < 0 else corners.max()
        raise InputError(
            f"{name} has faces that name vertex {wrong}, but only vertices 0 to "
            f"{len(vertices) - 1} exist."
        )
    if len(counts) and counts.min() < 3:
        few = int(np.argmax(counts < 3))
        raise InputError(
            f"{name}: face {few + 1:,} has {counts[few]} corners; a face needs three. "
            "Remove lines and points from the surface and export it again."
        )
    first = np.cumsum(counts) - counts
    n_triangles = counts - 2
    row = np.cumsum(n_triangles) - n_triangles
    cut = np.zeros((int(n_triangles.sum()), 3), dtype=np.int64)
    is_triangle, is_quad = counts == 3, counts == 4
    cut[row[is_triangle]] = first[is_triangle, None] + [0, 1, 2]
    if is_quad.any():
        halves = _quad_halves(vertices[corners[first[is_quad, None] + np.arange(4)]])
        cut[row[is_quad]] = first[is_quad, None] + halves[:, 0]
        cut[row[is_quad] + 1] = first[is_quad, None] + halves[:, 1]
    for i in np.flatnonzero(counts > 4):
        ring = first[i] + np.arange(counts[i])
        ears = _ears(vertices[corners[ring]])
        if len(ears) != n_triangles[i]:
            raise InputError(
                f"{name}: face {i + 1:,}, a polygon of {counts[i]} corners, crosses "
                "itself or has no area, so it cannot be cut into triangles. Triangulate "
                "the mesh in the program that made it, and export it again."
            )
        cut[row[i] : row[i] + len(ears)] = ring[ears]
    return cut, np.repeat(np.arange(len(counts)), n_triangles)


def _quad_halves(quads: Float[np.ndarray, "n 4 3"]) -> Int[np.ndarray, "n 2 3"]:
    """Two triangles a quadrangle: along the diagonal that leaves both turned alike."""
    along_02 = np.array([[0, 1, 2], [0, 2, 3]])
    along_13 = np.array([[0, 1, 3], [1, 2, 3]])

    def agreement(halves: np.ndarray) -> np.ndarray:
        a, b, c = (quads[:, halves[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        return np.einsum("nd,nd->n", cross[:, 0], cross[:, 1])

    # Where both lie inside, the first one, as most programs cut.
    takes_13 = (agreement(along_02) < 0.0) & (agreement(along_13) > 0.0)
    return np.where(takes_13[:, None, None], along_13, along_02)


def _ears(ring: Float[np.ndarray, "k 3"]) -> Int[np.ndarray, "m 3"]:
    """Triangles of one polygon, wound as it is; not k - 2 where it crosses itself."""
    beside = np.roll(ring, -1, axis=0)
    # Newell's normal: right for polygons that are not convex, or not quite flat.
    normal = np.cross(ring - ring[0], beside - ring[0]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    if normal[axis] == 0.0:
        return np.zeros((0, 3), dtype=np.int64)
    flat = np.delete(ring - ring[0], axis, axis=1)
    flat /= np.abs(flat).max()
    cut = mapbox_earcut.triangulate_float64(
        flat, np.array([len(ring)], dtype=np.uint32)
    )
    ears = cut.reshape(-1, 3).astype(np.int64)
    doubled = _cross_2d(flat, ears)
    outline = _cross_2d(flat, np.column_stack(_fan(len(ring)))).sum()
    if abs(np.abs(doubled).sum() - abs(outline)) > 1e-9 * abs(outline):
        return np.zeros((0, 3), dtype=np.int64)
    is_turned = doubled * outline < 0.0
    ears[is_turned] = ears[is_turned][:, ::-1]
    return np.concatenate([ears, _flat_ears(len(ring), ears)])


def _fan(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros(k - 2, dtype=int), np.arange(1, k - 1), np.arange(2, k)


def _cross_2d(
    points: Float[np.ndarray, "k 2"], triangles: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m"]:
    """Twice the signed area of each triangle."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (
        c[:, 0] - a[:, 0]
    )


def _flat_ears(k: int, ears: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "d 3"]:
    """Triangles without area at corners on a straight edge, which earcut leaves out.

    They keep the neighbour on that edge, whose vertices these are, joined to the polygon.
    """
    left = list(range(k))
    flat = []
    for corner in np.setdiff1d(np.arange(k), ears):
        i = left.index(corner)
        flat.append((left[i - 1], corner, left[(i + 1) % len(left)]))
        del left[i]
    return np.array(flat, dtype=np.int64).reshape(-1, 3)
