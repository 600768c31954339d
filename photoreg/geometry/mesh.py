"""A triangle mesh: check, normals, decimate, cast rays. The only module that knows embree."""

import dataclasses
import functools
from typing import Any, Literal

import numpy as np
import scipy.sparse
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse.csgraph import connected_components

from photoreg.checks import check_points
from photoreg.errors import InputError
from photoreg.geometry import decimation
from photoreg.sources import SourceFile

VisibilityMethod = Literal["normals", "rays", "depth"]
"""How points that the surface hides are found: by its normals alone, by rays, by a depth
buffer."""

_HASH_FACTORS = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64
)

MAX_COORDINATE = 1e15
"""Largest coordinate of a vertex: areas and volumes must not overflow."""

TOLERANCE = 1e-4
"""How far behind what hides it a point may lie and still be seen, relative to the mesh's
diagonal: its own face must not hide it, but the other side of a thin wall must. Embree's
single precision errs by 1e-5 at most from as far as a hundred diagonals."""


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in world axes; frozen, so what is derived from it is cached.

    Raises:
        InputError: at construction, if there are no faces, a vertex is not finite,
            a face names a vertex that does not exist, or all faces have no area.
    """

    vertices: Float[np.ndarray, "n 3"]
    """Vertex positions in model units, as in the file."""
    faces: Int[np.ndarray, "m 3"]
    """Vertex indices of each triangle, counter-clockwise seen from outside."""
    corner_uv: Float[np.ndarray, "m 3 2"] | None = None
    """The mesh's own texture coordinates of each face's corners (v upwards), if the
    file had them. By corner, because along a seam one vertex has several."""
    name: str = "mesh"
    """File name, for messages."""
    source: SourceFile | None = None
    """The file it was read from; None if it was made in memory."""
    own_texture: UInt8[np.ndarray, "h w 3"] | None = None
    """The texture that ``corner_uv`` is for, sRGB, if the file had one."""
    vertex_colours: UInt8[np.ndarray, "n 3"] | None = None
    """Colours of the vertices, sRGB, if the file had them."""
    own_normals: Float[np.ndarray, "n 3"] | None = None
    """Unit normals of the vertices, if the file had them: kept in exported files."""
    notes: tuple[str, ...] = ()
    """What of the file was left out or could only be guessed, a sentence each."""

    def __post_init__(self) -> None:
        if len(self.vertices) == 0:
            raise InputError(f"{self.name} has no vertices.")
        vertices = check_points(self.vertices, f"{self.name}: the vertex list")
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise InputError(
                f"{self.name} has no triangles ({len(vertices)} vertices only); "
                "photographs need a surface. Make a mesh of the points first."
            )
        if faces.min() < 0 or faces.max() >= len(vertices):
            wrong = faces.max() if faces.max() >= len(vertices) else faces.min()
            raise InputError(
                f"{self.name} has faces that name vertex {wrong}, but only "
                f"vertices 0 to {len(vertices) - 1} exist."
            )
        faces = np.ascontiguousarray(faces, dtype=np.int32)
        vertices.flags.writeable = False
        faces.flags.writeable = False
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        if not np.abs(vertices).max() < MAX_COORDINATE:
            raise InputError(
                f"{self.name} has coordinates up to {np.abs(vertices).max():.3g}; the "
                f"largest possible is {MAX_COORDINATE:g}. Is a vertex damaged?"
            )
        if not self.area > 0.0:
            raise InputError(
                f"{self.name} has no surface: every triangle has zero area."
            )

    def __getstate__(self) -> dict[str, Any]:
        # Cached properties hold embree's scene, which cannot be pickled.
        names = [field.name for field in dataclasses.fields(self)]
        return {name: self.__dict__[name] for name in names}

    @functools.cached_property
    def _face_cross(self) -> Float[np.ndarray, "m 3"]:
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return np.cross(b - a, c - a)

    @functools.cached_property
    def face_areas(self) -> Float[np.ndarray, "m"]:
        """Triangle areas in squared model units."""
        return 0.5 * np.linalg.norm(self._face_cross, axis=1)

    @functools.cached_property
    def face_normals(self) -> Float[np.ndarray, "m 3"]:
        """Unit outward normals; zero for a triangle without area."""
        return unit_rows(self._face_cross)

    @functools.cached_property
    def position_index(self) -> Int[np.ndarray, "n"]:
        """For each vertex the first vertex at the same position.

        Files with texture coordinates repeat a vertex along seams; the surface is
        one there all the same.
        """
        # Equal hashes of the bits bring equal positions together: sorting rows of three
        # numbers takes 15 times as long, 2 s for a million vertices. 0.0 makes -0.0 0.0.
        bits = (self.vertices + 0.0).view(np.uint64)
        mixed = (bits ^ (bits >> np.uint64(29))) * _HASH_FACTORS
        hashes = mixed.sum(axis=1, dtype=np.uint64)
        order = np.argsort(hashes, kind="stable")
        starts = np.flatnonzero(np.diff(hashes[order], prepend=~hashes[order[0]]))
        group = np.repeat(starts, np.diff(np.append(starts, len(order))))
        first = np.zeros(len(order), dtype=np.int64)
        first[order] = order[group]
        if (self.vertices[first] == self.vertices).all():
            return first
        # Two positions share a hash, which nobody will see: the long way.
        _, index, inverse = np.unique(
            self.vertices, axis=0, return_index=True, return_inverse=True
        )
        return index[inverse.ravel()]

    @functools.cached_property
    def face_part(self) -> Int[np.ndarray, "m"]:
        """Number of the part each face belongs to: those that hang together by edges."""
        corners = self.position_index[self.faces]
        start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
        key = np.minimum(start, end) * len(self.vertices) + np.maximum(start, end)
        order = np.argsort(key, kind="stable")
        face = order // 3
        same = key[order[1:]] == key[order[:-1]]
        m = len(self.faces)
        graph = scipy.sparse.coo_array(
            (np.ones(same.sum(), dtype=np.int8), (face[:-1][same], face[1:][same])),
            shape=(m, m),
        )
        return connected_components(graph, directed=False)[1].astype(np.int64)

    @functools.cached_property
    def is_border_face(self) -> Bool[np.ndarray, "m"]:
        """Whether a face has an edge that no other face has (seams do not count)."""
        position = self.position_index
        # Around a vertex without such an edge every neighbour comes twice, and twice the
        # same number is 0 under exclusive or: only the rest need be counted edge by
        # edge. Counting all would take a second a million faces.
        corners = position[self.faces]
        number = np.random.default_rng(0).integers(1, 1 << 62, len(position))
        parity = np.zeros(len(position), dtype=np.int64)
        for k in range(3):
            others = number[corners[:, k - 1]] ^ number[corners[:, k - 2]]
            np.bitwise_xor.at(parity, corners[:, k], others)
        near = (parity != 0)[corners]
        rows, sides = np.nonzero(near & np.roll(near, -1, axis=1))
        ends = np.stack([corners[rows, sides], corners[rows, (sides + 1) % 3]])
        keys = ends.min(axis=0) * len(position) + ends.max(axis=0)
        _, index, counts = np.unique(keys, return_inverse=True, return_counts=True)
        is_border = np.zeros(len(self.faces), dtype=bool)
        is_border[rows[counts[index.ravel()] == 1]] = True
        return is_border

    @functools.cached_property
    def vertex_normals(self) -> Float[np.ndarray, "n 3"]:
        """Area-weighted unit normals, smooth across texture seams."""
        corners = self.position_index[self.faces]
        sums = np.column_stack(
            [
                np.bincount(
                    corners.ravel(),
                    weights=np.repeat(self._face_cross[:, axis], 3),
                    minlength=len(self.vertices),
                )
                for axis in range(3)
            ]
        )
        return unit_rows(sums)[self.position_index]

    @property
    def normals_to_keep(self) -> Float[np.ndarray, "n 3"]:
        """The file's own normals, or else smooth ones."""
        return self.vertex_normals if self.own_normals is None else self.own_normals

    @functools.cached_property
    def area(self) -> float:
        """Surface area in squared model units."""
        return float(self.face_areas.sum())

    @functools.cached_property
    def centroid(self) -> Float[np.ndarray, "3"]:
        """Centroid of the surface (area-weighted)."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return self.face_areas @ ((a + b + c) / 3.0) / self.area

    @functools.cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the box around the used vertices."""
        is_used = np.zeros(len(self.vertices), dtype=bool)
        is_used[self.faces] = True
        used = self.vertices[is_used]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @functools.cached_property
    def diagonal(self) -> float:
        """Diagonal of the box around the mesh: the measure of all tolerances."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @functools.cached_property
    def _ray_frame(self) -> tuple[Any, np.ndarray, float]:
        # Embree works in float32: centre and scale the mesh to O(1) for it.
        origin, scale = self.bounds.mean(axis=0), 2.0 / self.diagonal
        vertices = np.ascontiguousarray((self.vertices - origin) * scale, dtype="f4")
        scene = rtcore_scene.EmbreeScene(robust=True)  # pyright: ignore[reportAttributeAccessIssue]
        # embreex wants an array that may be written to.
        TriangleMesh(scene, vertices, self.faces.copy())
        return scene, origin, scale

    def first_hits(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Casts rays; returns the face met first (-1: none) and its distance.

        Distances are in units of each direction's length; infinity where nothing
        is hit. Precision is float32 relative to the mesh's diagonal, about 1e-6. A ray
        that is NaN, as of a pixel where a lens shows nothing, hits nothing.
        """
        scene, origin, scale = self._ray_frame
        lengths = np.linalg.norm(directions, axis=1)
        if not np.isfinite(lengths).all():
            exists = np.isfinite(lengths)
            face = np.full(len(directions), -1)
            distance = np.full(len(directions), np.inf)
            face[exists], distance[exists] = self.first_hits(
                origins[exists], directions[exists]
            )
            return face, distance
        result = scene.run(
            np.ascontiguousarray((origins - origin) * scale, dtype=np.float32),
            np.ascontiguousarray(directions / lengths[:, None], dtype=np.float32),
            output=1,
        )
        face = result["primID"]
        distance = result["tfar"].astype(np.float64) / (scale * lengths)
        distance[face < 0] = np.inf
        return face, distance

    def is_unoccluded(
        self, points: Float[np.ndarray, "n 3"], viewpoint: Float[np.ndarray, "3"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether the segment from each surface point to ``viewpoint`` is free.

        The ray runs from the viewpoint to the point, short of it by ``TOLERANCE``
        times the mesh's diagonal, so the point's own face does not hide it.
        """
        scene, origin, scale = self._ray_frame
        start = (np.asarray(viewpoint) - origin) * scale
        rays = (points - origin) * scale - start
        lengths = np.linalg.norm(rays, axis=1)
        reach = np.maximum(lengths - 2.0 * TOLERANCE, 0.0)
        hit = scene.run(
            np.ascontiguousarray(np.broadcast_to(start, rays.shape), dtype=np.float32),
            np.ascontiguousarray(rays / lengths[:, None], dtype=np.float32),
            dists=reach.astype(np.float32),
            query="OCCLUDED",
        )
        return hit < 0

    def decimated(self, n_faces: int) -> "Mesh":
        """A coarser mesh of about ``n_faces`` faces for display; itself if small enough."""
        if len(self.faces) <= n_faces:
            return self
        faces = self.position_index[self.faces]
        vertices, faces = decimation.decimated(self.vertices, faces, n_faces)
        return Mesh(vertices, faces, name=self.name)


def unit_rows(rows: np.ndarray) -> np.ndarray:
    """Rows (n, 3) at length 1; rows of length 0 as they are."""
    """Rows divided by their length; zero stays zero."""
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.where(lengths > 0.0, lengths, 1.0)
