"""Charts of a mesh by projection along six axes.

Each face is projected along the axis that its smoothed normal is nearest to; connected
faces of one axis are a chart; where a chart would lie on itself, it is split.
"""

import numba as nb
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import rasterise

AXES = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]],
    dtype=np.float64,
)
"""Directions that charts are projected along."""
RIGHT = np.roll(AXES, 1, axis=1)
UP = np.cross(AXES, RIGHT)
NORMAL_SWEEPS = 8
LABEL_SWEEPS = 12
SMALL_CHART_FACES = 60
MIN_COSINE = 0.25
"""A face keeps its neighbours' axis as long as it is stretched by less than 4."""
MAX_LAYERS = 3


def project_charts(mesh: Mesh, padding: float) -> Float[np.ndarray, "m 3 2"]:
    """Texture coordinates by corner, square, to one scale, loosely laid out.

    Args:
        mesh: The surface.
        padding: Free space around charts, as a share of the layout's side.
    """
    faces = mesh.position_index[mesh.faces]
    neighbours = face_neighbours(faces)
    axis = _axis_of_faces(mesh, neighbours)
    layer = np.zeros(len(faces), dtype=np.int64)
    uv, side = _layout(mesh, _components(neighbours, axis), axis, padding)
    for _ in range(MAX_LAYERS):
        hidden = _hidden_faces(mesh, uv, axis, side)
        if not hidden.any():
            break
        layer[hidden] += 1
        chart = _components(neighbours, axis + len(AXES) * layer)
        uv, side = _layout(mesh, chart, axis, padding)
    return uv


def face_neighbours(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "m 3"]:
    """The face across each edge (corner i to i + 1); -1 where there is not just one."""
    n = int(faces.max()) + 1
    start, end = faces, np.roll(faces, -1, axis=1)
    key = (np.minimum(start, end).astype(np.int64) * n + np.maximum(start, end)).ravel()
    order = np.argsort(key, kind="stable")
    sorted_key = key[order]
    same = sorted_key[1:] == sorted_key[:-1]
    # Edges of exactly two faces: neither the key before nor the one after is the same.
    twin = same.copy()
    twin[1:] &= ~same[:-1]
    twin[:-1] &= ~same[1:]
    first, second = order[:-1][twin], order[1:][twin]
    neighbours = np.full(key.shape, -1, dtype=np.int32)
    neighbours[first] = second // 3
    neighbours[second] = first // 3
    return neighbours.reshape(-1, 3)


def _axis_of_faces(mesh: Mesh, neighbours: np.ndarray) -> Int[np.ndarray, "m"]:
    normals = mesh.face_normals
    smooth = normals * mesh.face_areas[:, None]
    # Noise of the scan would cut it into thousands of specks.
    for _ in range(NORMAL_SWEEPS):
        around = np.where((neighbours >= 0)[:, :, None], smooth[neighbours], 0.0)
        smooth = smooth + around.sum(axis=1)
        smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-300)
    wanted = np.argmax(smooth @ AXES.T, axis=1)
    cosines = normals @ AXES.T
    fits = cosines[np.arange(len(wanted)), wanted] > MIN_COSINE
    axis = np.where(fits, wanted, np.argmax(cosines, axis=1)).astype(np.int64)
    _smooth_labels(axis, neighbours, cosines, LABEL_SWEEPS)
    for _ in range(3):
        chart = _components(neighbours, axis)
        small = (np.bincount(chart) < SMALL_CHART_FACES)[chart]
        if not small.any():
            break
        _merge_small(axis, neighbours, cosines, small)
    return axis


@nb.njit(nogil=True, cache=True)
def _smooth_labels(axis, neighbours, cosines, n_sweeps):  # noqa: ANN001, ANN202
    """A face takes the axis that two of its neighbours share, if it fits."""
    for _ in range(n_sweeps):
        changed = False
        for face in range(len(axis)):
            for i in range(3):
                a, b = neighbours[face, i], neighbours[face, (i + 1) % 3]
                if a < 0 or b < 0:
                    continue
                label = axis[a]
                if (
                    label == axis[b]
                    and label != axis[face]
                    and cosines[face, label] > MIN_COSINE
                ):
                    axis[face] = label
                    changed = True
                    break
        if not changed:
            break


@nb.njit(nogil=True, cache=True)
def _merge_small(axis, neighbours, cosines, small):  # noqa: ANN001, ANN202
    """Faces of small charts join a larger neighbour that fits, from the rim inwards."""
    changed = True
    while changed:
        changed = False
        for face in range(len(axis)):
            if not small[face]:
                continue
            best, best_cosine = -1, MIN_COSINE
            for i in range(3):
                other = neighbours[face, i]
                if other >= 0 and not small[other]:
                    cosine = cosines[face, axis[other]]
                    if cosine > best_cosine:
                        best, best_cosine = axis[other], cosine
            if best >= 0:
                axis[face] = best
                small[face] = False
                changed = True


def _components(neighbours: np.ndarray, label: np.ndarray) -> Int[np.ndarray, "m"]:
    """Number of the connected part of equal label that each face belongs to."""
    face = np.repeat(np.arange(len(neighbours)), 3)
    other = neighbours.ravel()
    keep = other >= 0
    keep[keep] &= label[face[keep]] == label[other[keep]]
    graph = scipy.sparse.coo_array(
        (np.ones(keep.sum(), dtype=np.int8), (face[keep], other[keep])),
        shape=(len(neighbours), len(neighbours)),
    )
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _layout(
    mesh: Mesh, chart: np.ndarray, axis: np.ndarray, padding: float
) -> tuple[Float[np.ndarray, "m 3 2"], float]:
    """Charts side by side on shelves: coordinates in [0, 1], and the side's length.

    The length is in model units.
    """
    corners = mesh.vertices[mesh.faces]
    flat = np.stack(
        [
            np.einsum("mij,mj->mi", corners, RIGHT[axis]),
            np.einsum("mij,mj->mi", corners, UP[axis]),
        ],
        axis=2,
    )
    n_charts = int(chart.max()) + 1
    low, high = _chart_boxes(flat, chart, n_charts)
    flat -= low[chart][:, None]
    extent = high - low
    # Charts laid on their long side make low shelves of even height.
    tall = extent[:, 1] > extent[:, 0]
    turned = np.stack(
        [flat[:, :, 1], extent[chart, 0][:, None] - flat[:, :, 0]], axis=2
    )
    flat = np.where(tall[chart][:, None, None], turned, flat)
    extent[tall] = extent[tall][:, ::-1]

    pad = padding * np.sqrt(np.prod(extent, axis=1).sum())
    boxes = extent + 2.0 * pad
    width = max(np.sqrt(1.08 * np.prod(boxes, axis=1).sum()), boxes[:, 0].max())
    origin, height = _shelves(boxes, width, np.argsort(-boxes[:, 1], kind="stable"))
    flat += origin[chart][:, None] + pad
    side = max(width, height)
    return flat / side, float(side)


@nb.njit(nogil=True, cache=True)
def _chart_boxes(flat, chart, n_charts):  # noqa: ANN001, ANN202
    """Lowest and highest corner of each chart's box."""
    low = np.full((n_charts, 2), np.inf)
    high = np.full((n_charts, 2), -np.inf)
    for face in range(len(flat)):
        for corner in range(3):
            for k in range(2):
                value = flat[face, corner, k]
                low[chart[face], k] = min(low[chart[face], k], value)
                high[chart[face], k] = max(high[chart[face], k], value)
    return low, high


@nb.njit(nogil=True, cache=True)
def _shelves(boxes, width, order):  # noqa: ANN001, ANN202
    """Lower left corner of each box, placed row by row, and the height of all rows."""
    origin = np.zeros_like(boxes)
    x, y, shelf = 0.0, 0.0, 0.0
    for box in order:
        if x + boxes[box, 0] > width * (1.0 + 1e-9):
            x, y, shelf = 0.0, y + shelf, 0.0
        origin[box, 0], origin[box, 1] = x, y
        x += boxes[box, 0]
        shelf = max(shelf, boxes[box, 1])
    return origin, y + shelf


def _hidden_faces(
    mesh: Mesh, uv: np.ndarray, axis: np.ndarray, side: float
) -> np.ndarray:
    """Faces that lie under another face of their own chart."""
    size = 2048
    corners = mesh.vertices[mesh.faces]
    height = np.einsum("mij,mj->mi", corners - mesh.bounds.mean(axis=0), AXES[axis])
    # 1 / z is what the rasteriser interpolates and compares: make it the height.
    nearness = 1.5 + height / mesh.diagonal
    w = 1.0 / nearness
    x = uv[:, :, 0] * size - 0.5
    y = uv[:, :, 1] * size - 0.5
    points = np.stack([x * w, y * w, w], axis=2).reshape(-1, 3)
    faces = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    P = np.eye(3, 4)
    top, depth = rasterise(points, faces, P, 0.1, size, size)
    center_x = np.clip(np.rint(x.mean(axis=1)).astype(np.int64), 0, size - 1)
    center_y = np.clip(np.rint(y.mean(axis=1)).astype(np.int64), 0, size - 1)
    above = 1.0 / depth[center_y, center_x] - nearness.mean(axis=1)
    cosine = (mesh.face_normals * AXES[axis]).sum(axis=1)
    steep = 1.0 / np.maximum(cosine, 0.05)
    other = top[center_y, center_x]
    steeper = np.maximum(steep, steep[other])
    # The texel's centre is not the face's: on a slope its height differs a little.
    tolerance = 2.0 * (1.0 + steeper) * side / size / mesh.diagonal
    return (other >= 0) & (above > tolerance)
