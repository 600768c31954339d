"""A triangle mesh: check, normals, decimate, cast rays. The only module that knows embree."""

import contextlib
import dataclasses
import functools
from typing import Any

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from jaxtyping import Bool, Float, Int, UInt8

from photoreg import decimation
from photoreg.checks import check_points
from photoreg.errors import InputError
<<<<<<< HEAD
from photoreg.sources import SourceFile
=======
from photoreg.limits import Limits
from photoreg.mesh_headers import check_announced, check_counts
from photoreg.sources import SourceFile, open_for_reading, read_regular, source_file
>>>>>>> 59a6e63 (Words and files of others stay words and files: no script runs from a project, and nothing but a regular file is opened)

_HASH_FACTORS = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64
)

MAX_COORDINATE = 1e15
"""Largest coordinate of a vertex: areas and volumes must not overflow."""


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
                "photographs need a surface. Triangulate the point cloud first."
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
                f"{self.name} has coordinates up to {np.abs(vertices).max():.3g}; up to "
                f"{MAX_COORDINATE:g} can be reckoned with. Is a vertex damaged?"
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
        is hit. Precision is float32 relative to the mesh's diagonal, about 1e-6.
        """
        scene, origin, scale = self._ray_frame
        lengths = np.linalg.norm(directions, axis=1)
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
        self,
        points: Float[np.ndarray, "n 3"],
        viewpoint: Float[np.ndarray, "3"],
        tolerance: float = 1e-3,
    ) -> Bool[np.ndarray, "n"]:
        """Whether the segment from each surface point to ``viewpoint`` is free.

        The ray runs from the viewpoint to the point, short of it by ``tolerance``
        times the mesh's diagonal, so the point's own face does not hide it.
        """
        scene, origin, scale = self._ray_frame
        start = (np.asarray(viewpoint) - origin) * scale
        rays = (points - origin) * scale - start
        lengths = np.linalg.norm(rays, axis=1)
        reach = np.maximum(lengths - 2.0 * tolerance, 0.0)
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


<<<<<<< HEAD
def unit_rows(rows: np.ndarray) -> np.ndarray:
    """Rows divided by their length; zero stays zero."""
=======
def load_mesh(path: Path | str, limits: Limits | None = None) -> Mesh:
    """Loads OBJ, PLY, STL, GLB or OFF; units, axes and vertex order are untouched.

    Args:
        path: The file. What it names, an MTL or a texture, is read only from its folder.
        limits: How large it may be; None: as the environment says.

    Raises:
        InputError: if the file is missing, empty, unreadable, of another kind, too
            large, or holds no usable surface.
    """
    limits = limits or Limits.of_environment()
    path = check_input_file(Path(path), "mesh", limits.file_mb)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"{path.name} is not a mesh file photoreg reads: the suffix should be one "
            f"of {', '.join(MESH_SUFFIXES)}."
        )
    check_announced(path, limits)
    loaded = _read(path, limits)
    vertices, faces = np.asarray(loaded.vertices), np.asarray(loaded.faces)
    corner_uv = _corner_uv(loaded)
    if path.suffix.lower() == ".obj" and corner_uv is not None:
        # Kept in the file's order, a vertex has one texture coordinate even where the
        # file gives it several; only split by coordinate are the corners right.
        split = _read(path, limits, maintain_order=False)
        corner_uv = None
        if np.array_equal(split.vertices[split.faces], vertices[faces]):
            corner_uv = _corner_uv(split)
    if path.suffix.lower() == ".ply" and corner_uv is not None:
        vertices, faces = _as_in_ply(loaded, vertices, faces)
    normals = _vertex_normals(loaded, len(vertices))
    colours = _vertex_colours(loaded)
    if colours is not None and len(colours) != len(vertices):
        colours = None
    if path.suffix.lower() == ".stl":
        # An STL repeats each corner; the same position is the same vertex.
        vertices, index = np.unique(vertices, axis=0, return_inverse=True)
        faces = index.reshape(-1)[faces]
        normals = colours = None
    texture = None if corner_uv is None else _texture(loaded, limits)
    source = source_file(path)
    return Mesh(
        vertices, faces, corner_uv, path.name, source, texture, colours, normals
    )


class _OwnFolder(FilePathResolver):
    """What a mesh names, an MTL file or a texture: regular files of its own folder."""

    def __init__(self, path: Path, limits: Limits) -> None:
        super().__init__(str(path))
        self._limits = limits

    def absolute(self, name: str) -> Path:
        """The path of a name; it counts as read."""
        path = super().absolute(name)
        note_input(path)
        return path

    def get(self, name: str) -> bytes:
        """The content of a file that the mesh names.

        Raises:
            InputError: if it is not a file or too large.
            ValueError: if it is outside of the mesh's own folder.
            OSError: if it is not there or cannot be read.
        """
        for candidate in (name.strip(), name.strip().lstrip("/"), Path(name).name):
            with contextlib.suppress(ValueError):
                path = self.absolute(candidate)
                if path.exists():
                    check_input_file(path, "file", self._limits.file_mb)
                    return read_regular(path)
        self.absolute(name)
        raise FileNotFoundError(name)


def _read(path: Path, limits: Limits, maintain_order: bool = True) -> trimesh.Trimesh:
    try:
        with warnings.catch_warnings():
            # numpy warns of what it then refuses, or reads up to.
            warnings.simplefilter("ignore")
            with open_for_reading(path) as file:
                loaded = trimesh.load(
                    file,
                    file_type=path.suffix.lower()[1:],
                    resolver=_OwnFolder(path, limits),
                    process=False,
                    maintain_order=maintain_order,
                )
            if isinstance(loaded, trimesh.Scene):
                _check_scene(loaded, path.name, limits)
                loaded = _joined(loaded)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise InputError(
            f"{path.name} could not be read as a mesh: {_reason(error)}. Is the file "
            "complete?"
        ) from error
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        count = len(getattr(loaded, "vertices", ()))
        raise InputError(
            f"{path.name} has no triangles ({count} vertices only); photographs need "
            "a surface. Triangulate the point cloud first."
        )
    check_counts(path.name, len(loaded.vertices), len(loaded.faces), limits)
    return loaded


def _joined(scene: trimesh.Scene) -> trimesh.Trimesh:
    """All of a scene as one mesh, with the normals of the file, which trimesh drops."""
    joined = scene.to_mesh()
    places, normals = [], []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        part: Any = scene.geometry[name]
        own = part._cache.cache.get("vertex_normals")
        if own is None:
            return joined
        places.append(part.vertices @ matrix[:3, :3].T + matrix[:3, 3])
        normals.append(_unit_rows(own @ np.linalg.pinv(matrix[:3, :3])))
    if places:
        together = np.concatenate(places)
        if together.shape == joined.vertices.shape and np.allclose(
            together, joined.vertices
        ):
            joined.vertex_normals = np.concatenate(normals)
    return joined


def _as_in_ply(
    loaded: trimesh.Trimesh, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of the file: trimesh doubles vertices along texture seams."""
    raw: Any = loaded.metadata.get("_ply_raw", {})
    try:
        table, lists = raw["vertex"]["data"], raw["face"]["data"]
        corners = next(
            lists[name]["f1"]
            for name in ("vertex_indices", "vertex_index")
            if name in lists.dtype.names
        )
        own = np.column_stack([np.ravel(table[axis]) for axis in "xyz"])
        same = corners.shape == faces.shape and np.array_equal(
            own[corners], vertices[faces]
        )
    except (KeyError, TypeError, IndexError, AttributeError, StopIteration, ValueError):
        return vertices, faces
    return (own, corners) if same else (vertices, faces)


def _check_scene(scene: trimesh.Scene, name: str, limits: Limits) -> None:
    """Raises InputError if a scene is too large once each part stands where it is used."""
    parts = [
        scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry
    ]
    check_counts(
        name,
        sum(len(getattr(part, "vertices", ())) for part in parts),
        sum(len(getattr(part, "faces", ())) for part in parts),
        limits,
    )


def _corner_uv(loaded: trimesh.Trimesh) -> np.ndarray | None:
    uv = getattr(loaded.visual, "uv", None)
    if uv is None or np.shape(uv) != (len(loaded.vertices), 2):
        return None
    return np.asarray(uv, dtype=np.float64)[loaded.faces]


def _texture(loaded: trimesh.Trimesh, limits: Limits) -> np.ndarray | None:
    """The picture of the material, whichever kind it is; None if it is of no use."""
    material = getattr(loaded.visual, "material", None)
    for name in ("image", "baseColorTexture"):
        picture = getattr(material, name, None)
        if picture is not None:
            if picture.width * picture.height > limits.photo_pixels:
                return None
            try:
                pixels = np.asarray(picture.convert("RGB"), dtype=np.uint8)
            except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
                # Truncated or damaged: the mesh is of use without it.
                return None
            # trimesh puts a small grey square for a material that is not there.
            return None if pixels.shape[:2] == (2, 2) else pixels
    return None


def _vertex_colours(loaded: trimesh.Trimesh) -> np.ndarray | None:
    visual: Any = loaded.visual
    if visual.kind != "vertex":
        return None
    colours = np.asarray(visual.vertex_colors, dtype=np.uint8)
    return colours[:, :3].copy() if len(colours) == len(loaded.vertices) else None


def _vertex_normals(loaded: trimesh.Trimesh, n: int) -> np.ndarray | None:
    """The normals of the file; None where it has none, or some without a direction."""
    normals = loaded._cache.cache.get("vertex_normals")
    raw = loaded.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    names = getattr(getattr(raw, "dtype", None), "names", None) or ()
    if normals is None and {"nx", "ny", "nz"} <= set(names):
        normals = np.column_stack(
            [np.ravel(raw[axis]) for axis in ("nx", "ny", "nz")]  # pyright: ignore[reportOptionalSubscript]
        )
    if normals is None or np.shape(normals) != (n, 3):
        return None
    unit = _unit_rows(np.asarray(normals, dtype=np.float64))
    return unit if (np.abs(np.linalg.norm(unit, axis=1) - 1.0) < 1e-6).all() else None


def _unit_rows(rows: np.ndarray) -> np.ndarray:
>>>>>>> 59a6e63 (Words and files of others stay words and files: no script runs from a project, and nothing but a regular file is opened)
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.where(lengths > 0.0, lengths, 1.0)
