"""The surface where a field is zero, as a closed triangle mesh (naive surface nets).

scikit-image's marching cubes serve nearly as well (tried on the shell: as close to the
surface, 29 faces of 20,480 with an angle below one degree, of which these nets have
none). They would save forty lines here, and bring five packages more to everybody who
installs photoreg, for scenes that are made in tests; and all of these would change.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

Field = Callable[[np.ndarray], np.ndarray]
"""Values (n,) at points (n, 3): negative inside, positive outside, about a distance."""


def surface_net(
    field: Field, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], cell: float
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Vertices and outward faces of ``field`` = 0 within a box that encloses it.

    One vertex in each cell that the surface passes, one quad across each grid edge
    that it cuts: evener triangles than marching cubes gives. The vertices are then
    drawn onto the surface along the field's gradient.

    References:
        Gibson, "Constrained elastic surface nets", 1998.
    """
    shape = np.ceil((high - low) / cell).astype(int) + 1
    axes = [low[axis] + cell * np.arange(shape[axis]) for axis in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = field(grid).reshape(shape)
    inside = values < 0.0
    cells = shape - 1
    sums, counts = np.zeros((*cells, 3)), np.zeros(cells)
    quads = []
    for axis in range(3):
        other_1, other_2 = (axis + 1) % 3, (axis + 2) % 3
        first = np.take(inside, np.arange(cells[axis]), axis=axis)
        second = np.take(inside, np.arange(1, shape[axis]), axis=axis)
        start = np.argwhere(first != second)
        end = start.copy()
        end[:, axis] += 1
        value_1, value_2 = values[tuple(start.T)], values[tuple(end.T)]
        crossing = start.astype(np.float64)
        crossing[:, axis] += value_1 / (value_1 - value_2)
        around = []
        for step_1, step_2 in ((0, 0), (-1, 0), (-1, -1), (0, -1)):
            neighbour = start.copy()
            neighbour[:, other_1] += step_1
            neighbour[:, other_2] += step_2
            np.add.at(sums, tuple(neighbour.T), crossing)
            np.add.at(counts, tuple(neighbour.T), 1.0)
            around.append(np.ravel_multi_index(tuple(neighbour.T), tuple(cells)))
        # The four cells go round the edge; leaving the inside along +axis looks out.
        ring = np.column_stack(around)
        leaving = inside[tuple(start.T)]
        quads.append(np.where(leaving[:, None], ring, ring[:, ::-1]))
    used = np.flatnonzero(counts.ravel() > 0.0)
    vertices = low + cell * (sums.reshape(-1, 3)[used] / counts.ravel()[used, None])
    number = np.full(counts.size, -1)
    number[used] = np.arange(len(used))
    a, b, c, d = number[np.vstack(quads)].T
    vertices = _drawn_to_zero(field, vertices, cell)
    # Each quad is cut along its shorter diagonal.
    across_ac = np.linalg.norm(vertices[a] - vertices[c], axis=1)
    across_bd = np.linalg.norm(vertices[b] - vertices[d], axis=1)
    by_ac = (across_ac <= across_bd)[:, None]
    halves_1 = np.where(by_ac, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    halves_2 = np.where(by_ac, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    return vertices, np.vstack([halves_1, halves_2])


def gradient(
    field: Field, points: Float[np.ndarray, "n 3"], step: float
) -> Float[np.ndarray, "n 3"]:
    """The field's gradient by central differences."""
    columns = []
    for axis in range(3):
        offset = np.zeros(3)
        offset[axis] = step
        columns.append((field(points + offset) - field(points - offset)) / (2.0 * step))
    return np.column_stack(columns)


def _drawn_to_zero(field: Field, vertices: np.ndarray, cell: float) -> np.ndarray:
    """Vertices moved onto the surface, each by less than half a cell a step."""
    for _ in range(2):
        slope = gradient(field, vertices, 0.05 * cell)
        steepness = np.maximum(np.einsum("nd,nd->n", slope, slope), 0.04)
        move = -(field(vertices) / steepness)[:, None] * slope
        length = np.linalg.norm(move, axis=1, keepdims=True)
        vertices = vertices + move * np.minimum(
            1.0, 0.4 * cell / np.maximum(length, 1e-12)
        )
    return vertices
