"""Which way faces look: one rule for everyone who asks what a camera sees.

Files are wound in every way: inside out, each face as it came, or each face twice, once
turned. At reading, faces that are joined are wound alike (`consistently_wound`). Which
of its two sides a part shows cannot be told of an open scan, or of a room, by its shape;
the cameras tell: they see the outside (`facing_cameras`). What is wound rightly is left
as it is, to the bit.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry

VOTE_WIDTH_PX = 256
FEW_BACKS = 0.01
"""Share of what cameras see that may be backs, seen through holes of a mesh whose winding
is right."""
CLEAR_MAJORITY = 0.75
"""Share of a part's area that says how it is wound; below, its volume does."""


def consistently_wound(mesh: Mesh) -> Mesh:
    """The mesh with joined faces wound alike, and two-sided parts made one-sided.

    Vertices stay as they are, and so do the faces' order and, where possible, their
    winding: a part is wound as most of it was, or, if it was wound at random, outwards
    as far as it bulges.

    Returns:
        The same object if there is nothing to do; else another, whose notes say what
        was done.
    """
    corners = mesh.position_index[mesh.faces]
    notes = list(mesh.notes)
    keep = _one_of_two_sides(mesh, corners)
    if not keep.all():
        notes.append(
            f"{int((~keep).sum()):,} of its faces are the other side of others (two-sided "
            "surfaces); one of each was kept."
        )
        mesh, corners = _subset(mesh, keep), corners[keep]
    edges = _joined_pairs(corners)
    if not edges.is_turned.any():
        return mesh if keep.all() else dataclasses.replace(mesh, notes=tuple(notes))
    turned, n_one_sided = _turned_alike(mesh, edges)
    if turned.any():
        notes.append(
            f"{int(turned.sum()):,} of its faces were wound the other way than their "
            "neighbours, and were turned."
        )
    if n_one_sided:
        notes.append(
            f"{n_one_sided:,} of its faces cannot be wound as their neighbours are: the "
            "surface crosses or closes on itself there, and was left as it is."
        )
    return dataclasses.replace(turned_at(mesh, turned), notes=tuple(notes))


def facing_cameras(mesh: Mesh, cameras: Sequence[Camera]) -> Mesh:
    """The mesh with the parts turned of which cameras see the backs more than the fronts.

    Returns:
        The same object where hardly any back is seen.
    """
    front, back = np.zeros((2, len(mesh.faces)))
    for camera in cameras:
        buffer = render_geometry(mesh, camera, min(camera.width, VOTE_WIDTH_PX))
        face = buffer.face_index[buffer.covered]
        view = camera.center - buffer.points[buffer.covered]
        facing = (mesh.face_normals[face] * view).sum(axis=1)
        front += np.bincount(face[facing > 0.0], minlength=len(front))
        back += np.bincount(face[facing < 0.0], minlength=len(back))
    if back.sum() <= FEW_BACKS * (front.sum() + back.sum()):
        return mesh
    part, votes = mesh.face_part, front - back
    turned = np.zeros(len(votes), dtype=bool)
    pairs = _joined_pairs(mesh.position_index[mesh.faces])
    if pairs.is_turned.any():
        # It was made in memory, not read.
        turned = _turned_alike(mesh, pairs)[0]
    of_part = np.bincount(part, weights=np.where(turned, -votes, votes))
    return turned_at(mesh, turned ^ (of_part[part] < 0.0))


def turned_at(mesh: Mesh, turned: Bool[np.ndarray, "m"]) -> Mesh:
    """The mesh with some faces wound the other way."""
    if not turned.any():
        return mesh
    order = np.where(turned[:, None], [0, 2, 1], [0, 1, 2])
    uv = mesh.corner_uv
    other = dataclasses.replace(
        mesh,
        faces=np.take_along_axis(mesh.faces, order, axis=1),
        corner_uv=None if uv is None else np.take_along_axis(uv, order[:, :, None], 1),
    )
    # Places and rays do not ask how faces are wound.
    for name in ("position_index", "face_part", "_ray_frame"):
        if name in mesh.__dict__:
            other.__dict__[name] = mesh.__dict__[name]
    return other


def _subset(mesh: Mesh, keep: Bool[np.ndarray, "m"]) -> Mesh:
    uv = mesh.corner_uv
    return dataclasses.replace(
        mesh, faces=mesh.faces[keep], corner_uv=None if uv is None else uv[keep]
    )


def _one_of_two_sides(
    mesh: Mesh, corners: Int[np.ndarray, "m 3"]
) -> Bool[np.ndarray, "m"]:
    """False at the later faces of parts all of whose faces are there twice, once turned.

    What has single faces too, as two blocks that touch, is no two-sided surface.
    """
    number = np.random.default_rng(0).integers(1, 1 << 62, int(corners.max()) + 1)
    at = number[corners]
    order = np.argsort(at.sum(axis=1), kind="stable")
    place = at.sum(axis=1)[order]
    again = np.concatenate([[False], place[1:] == place[:-1]])
    if not again.any():
        return np.ones(len(corners), dtype=bool)
    group = np.cumsum(~again) - 1
    # The same three places, in the one turn and in the other.
    turn = (at * np.roll(at, -1, axis=1) ** 2).sum(axis=1)[order]
    first = np.flatnonzero(~again)
    has_other = np.zeros(len(first), dtype=bool)
    np.logical_or.at(has_other, group, turn != turn[first][group])
    flat = (corners == np.roll(corners, 1, axis=1)).any(axis=1)
    is_two_sided = np.zeros(len(corners), dtype=bool)
    is_two_sided[order] = has_other[group]
    single = np.bincount(mesh.face_part, weights=~(is_two_sided | flat))
    is_later = np.zeros(len(corners), dtype=bool)
    is_later[order] = again
    return ~(is_later & is_two_sided & ~flat & (single == 0)[mesh.face_part])


@dataclasses.dataclass(frozen=True)
class _Pairs:
    """Faces joined along an edge that only they have."""

    one: Int[np.ndarray, "e"]
    other: Int[np.ndarray, "e"]
    is_turned: Bool[np.ndarray, "e"]
    """Whether both run along it in one direction: one of them is wound wrongly."""


def _joined_pairs(corners: Int[np.ndarray, "m 3"]) -> _Pairs:
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    key = np.minimum(start, end) * (int(corners.max()) + 1) + np.maximum(start, end)
    key[start == end] = -1
    order = np.argsort(key, kind="stable")
    key = key[order]
    same = key[1:] == key[:-1]
    pair = same & (key[1:] >= 0)
    pair[1:] &= ~same[:-1]
    pair[:-1] &= ~same[1:]
    first, second = order[:-1][pair], order[1:][pair]
    return _Pairs(first // 3, second // 3, start[first] == start[second])


def _turned_alike(mesh: Mesh, pairs: _Pairs) -> tuple[Bool[np.ndarray, "m"], int]:
    """Which faces to turn so that joined ones agree, and how many never can."""
    m = len(mesh.faces)
    # Each face as it is and turned: joined to its neighbour as that is, or turned.
    crossed = np.where(pairs.is_turned, m, 0)
    rows = np.concatenate([pairs.one, pairs.one + m])
    columns = np.concatenate([pairs.other + crossed, pairs.other + m - crossed])
    graph = scipy.sparse.coo_array(
        (np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * m, 2 * m)
    )
    label = connected_components(graph, directed=False)[1]
    as_is, turned = label[:m], label[m:]
    # The two windings of a part have two labels; the lower names the part.
    part = np.minimum(as_is, turned)
    candidate = as_is != part
    area = mesh.face_areas
    n = int(label.max()) + 1
    total = np.bincount(part, weights=area, minlength=n)
    against = np.bincount(part, weights=area * candidate, minlength=n)
    share = against / np.maximum(total, 1e-300)
    unclear = (share > 1.0 - CLEAR_MAJORITY) & (share < CLEAR_MAJORITY)
    is_back = np.where(unclear, _volumes(mesh, part, candidate, n) < 0.0, share > 0.5)
    one_sided = as_is == turned
    return (candidate ^ is_back[part]) & ~one_sided, int(one_sided.sum())


def _volumes(
    mesh: Mesh, part: Int[np.ndarray, "m"], turned: Bool[np.ndarray, "m"], n: int
) -> Float[np.ndarray, "n"]:
    """Volume between each part and its centroid, positive where it bulges outwards."""
    corners = mesh.vertices[mesh.faces]
    middle = corners.mean(axis=1)
    area = mesh.face_areas
    total = np.maximum(np.bincount(part, weights=area, minlength=n), 1e-300)
    centroid = np.column_stack(
        [np.bincount(part, weights=area * middle[:, k], minlength=n) for k in range(3)]
    )
    arm = middle - (centroid / total[:, None])[part]
    height = np.einsum("mi,mi->m", arm, mesh.face_normals) * area
    return np.bincount(part, weights=np.where(turned, -height, height), minlength=n)
