"""Coarser meshes for display: edges collapsed, or vertices merged where that stalls."""

import fast_simplification
import numpy as np
from jaxtyping import Float, Int

OPEN_SHARE = 0.1
"""From this share of edges with one face only, a mesh is pieces more than a surface.
Collapsing edges keeps the border of each piece: 93 s of a processor, and hardly less."""
CLUSTERED_SHARE = 4.0
"""Such a mesh is first merged to so many times the faces wanted, which joins pieces."""
SLACK = 1.1
"""A little more than the faces wanted is no stall."""


def decimated(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], n_faces: int
) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, "l 3"]]:
    """Vertices and faces of a mesh of about ``n_faces`` faces, or fewer.

    Quadric edge collapse; a mesh of loose pieces is clustered on a grid as well.

    References:
        M. Garland and P. Heckbert, "Surface Simplification Using Quadric Error
        Metrics", SIGGRAPH 1997, DOI 10.1145/258734.258849; J. Rossignac and P. Borrel,
        "Multi-resolution 3D approximations for rendering complex scenes", 1993, DOI
        10.1007/978-3-642-78114-8_29.
    """
    if _open_share(faces, len(vertices)) > OPEN_SHARE:
        vertices, faces = _clustered(vertices, faces, int(CLUSTERED_SHARE * n_faces))
    if len(faces) > n_faces:
        # A writable copy: the compiled code refuses a read-only array.
        vertices, faces = fast_simplification.simplify(
            vertices.copy(), faces, target_count=n_faces
        )[:2]
    if len(faces) > SLACK * n_faces:
        vertices, faces = _clustered(vertices, faces, n_faces)
    return vertices, faces


def _open_share(faces: np.ndarray, n_vertices: int) -> float:
    """Share of the edges that belong to one face only."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys = np.sort(ends[:, 0].astype(np.int64) * n_vertices + ends[:, 1])
    begins = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    counts = np.diff(np.append(begins, len(keys)))
    return float((counts == 1).mean())


def _clustered(
    vertices: np.ndarray, faces: np.ndarray, n_faces: int
) -> tuple[np.ndarray, np.ndarray]:
    """One vertex for each cell of a grid, of a size that leaves ``n_faces`` or fewer."""
    low = vertices.min(axis=0)
    corners = vertices[faces]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(np.linalg.norm(sides, axis=1).sum())
    extent = float((vertices.max(axis=0) - low).max())
    # A surface has about two faces for each cell it passes through.
    cell = max(np.sqrt(2.0 * area / n_faces), 1e-6 * extent)
    while len(faces) > n_faces:
        places = np.floor((vertices - low) / cell).astype(np.int64)
        size = places.max(axis=0) + 1
        key = (places[:, 0] * size[1] + places[:, 1]) * size[2] + places[:, 2]
        _, index = np.unique(key, return_inverse=True)
        count = np.bincount(index)
        merged = np.column_stack(
            [np.bincount(index, weights=axis) / count for axis in vertices.T]
        )
        kept = index[faces]
        a, b, c = kept.T
        kept = kept[(a != b) & (b != c) & (c != a)]
        # Of faces that have become the same one is enough, whichever way it is wound.
        _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
        vertices, faces = merged, kept[np.sort(first)]
        cell *= 1.05 * max(np.sqrt(len(faces) / n_faces), 1.0)
    return vertices, faces
