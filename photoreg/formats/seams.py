"""A textured mesh with one texture coordinate a vertex: vertices doubled along seams."""

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from photoreg.texture import TexturedMesh


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


def vertex_colours(textured: TexturedMesh) -> UInt8[np.ndarray, "n 3"]:
    """The texture's colour at each vertex, the mean over its charts; grey off all faces."""
    height, width = textured.texture.shape[:2]
    uv, owner = textured.atlas.uv, np.asarray(textured.atlas.uv_vertex)
    x = np.clip(uv[:, 0] * width - 0.5, 0.0, width - 1.0).astype(np.float32)
    y = np.clip((1.0 - uv[:, 1]) * height - 0.5, 0.0, height - 1.0).astype(np.float32)
    sampled = _bilinear(textured.texture, x, y)
    n = len(textured.vertices)
    count = np.bincount(owner, minlength=n)
    sums = np.column_stack(
        [np.bincount(owner, weights=sampled[:, i], minlength=n) for i in range(3)]
    )
    colours = np.full((n, 3), 128.0)
    colours[count > 0] = sums[count > 0] / count[count > 0, None]
    return np.rint(colours).astype(np.uint8)


def _bilinear(
    picture: UInt8[np.ndarray, "h w 3"],
    x: Float[np.ndarray, "k"],
    y: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "k 3"]:
    # OpenCV's remap takes fewer than 32,768 rows at a time.
    parts = [
        cv2.remap(
            picture,
            x[i : i + 30_000, None],
            y[i : i + 30_000, None],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for i in range(0, len(x), 30_000)
    ]
    return np.concatenate(parts)[:, 0].astype(np.float64)
