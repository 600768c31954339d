"""A textured mesh with one texture coordinate a vertex: vertices doubled along seams."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from photoreg.geometry.mesh import Mesh
from photoreg.texture import kernels
from photoreg.texture.bake import TexturedMesh

FAR_OFF = 16.0
"""Coordinates larger than so many diagonals of the mesh are written from its middle."""


def origin_to_write(mesh: Mesh) -> Float[np.ndarray, "3"]:
    """Where coordinates in single precision start: the world's origin, or the middle."""
    middle = mesh.bounds.mean(axis=0)
    if np.abs(middle).max() < FAR_OFF * mesh.diagonal:
        return np.zeros(3)
    return middle


def split_at_seams(
    textured: TexturedMesh,
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 2"], Int[np.ndarray, "m 3"]]:
    """Vertices doubled along seams; the mesh's own come first, in their order.

    Returns:
        The mesh's vertex that each new vertex is, its texture coordinate (v upwards),
        and the faces in new vertices.
    """
    atlas, n = textured.atlas, len(textured.vertices)
    owner = np.asarray(atlas.uv_vertex)
    used = np.zeros(len(owner), dtype=bool)
    used[atlas.uv_faces] = True
    rows = np.flatnonzero(used)
    # The first coordinate of each vertex stays with it; the others are appended.
    vertices, first = np.unique(owner[rows], return_index=True)
    position = np.full(len(owner), -1, dtype=np.int64)
    position[rows[first]] = vertices
    others = rows[position[rows] < 0]
    position[others] = n + np.arange(len(others))
    vertex_index = np.concatenate([np.arange(n), owner[others]])
    uv = np.zeros((len(vertex_index), 2))
    uv[position[rows]] = atlas.uv[rows]
    return vertex_index, uv, position[atlas.uv_faces].astype(np.int32)


def source_files(textured: TexturedMesh) -> list[Path]:
    """The file of the mesh that was textured, which stays as it is."""
    source = textured.mesh.source
    return [] if source is None else [source.path]


def vertex_colours(textured: TexturedMesh) -> UInt8[np.ndarray, "n 3"]:
    """The texture's colour at each vertex, the mean over its charts; grey off all faces."""
    owner = np.asarray(textured.atlas.uv_vertex)
    sampled = kernels.sample(textured.texture, textured.atlas.uv)
    n = len(textured.vertices)
    count = np.bincount(owner, minlength=n)
    sums = np.column_stack(
        [np.bincount(owner, weights=sampled[:, i], minlength=n) for i in range(3)]
    )
    colours = np.full((n, 3), 128.0)
    colours[count > 0] = sums[count > 0] / count[count > 0, None]
    return np.rint(colours).astype(np.uint8)
