"""PLY, as text or binary, with textures beside it."""

import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import plyfile

from photoreg.errors import InputError
from photoreg.formats.meshes.beside import find_beside
from photoreg.formats.meshes.contents import (
    MeshContents,
    Picture,
    colours_of,
    texture_picture,
)
from photoreg.formats.meshes.headers import HEADER_BYTES
from photoreg.formats.meshes.ply_text import as_binary
from photoreg.formats.meshes.polygons import triangle_corners
from photoreg.limits import Limits
from photoreg.sources import open_for_reading
from photoreg.words import listed

_CORNERS = ("vertex_indices", "vertex_index")
_WEDGE_UV, _WEDGE_PICTURE = "texcoord", "texnumber"
_VERTEX_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("s0", "t0"))
_COLOUR = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_READ = {
    "vertex": {
        *("x", "y", "z", "nx", "ny", "nz", "alpha", "diffuse_alpha"),
        *(name for names in (*_VERTEX_UV, *_COLOUR) for name in names),
    },
    "face": {*_CORNERS, _WEDGE_UV, _WEDGE_PICTURE},
}
"""Properties that are read, by element; alpha of the colours says nothing of them."""
_OTHER_SURFACES = ("tristrips", "polyhedron", "quad", "range_grid")


def read_ply(path: Path, limits: Limits) -> MeshContents:
    """Reads a PLY file with plyfile.

    Texture coordinates may be at the vertices or, as MeshLab writes them, at the corners
    of the faces, for one texture or several.

    Raises:
        InputError: if it is not a PLY mesh.
    """
    try:
        ply = _parsed(path)
    except plyfile.PlyParseError as error:
        raise InputError(
            f"{path.name} could not be read as a mesh: {str(error)[:160]}. Is the file "
            "complete?"
        ) from error
    elements = {element.name: element for element in ply.elements}
    for name in _OTHER_SURFACES:
        if name in elements and elements[name].count:
            raise InputError(
                f"{path.name} holds its surface as {name}, not as faces. Export it as a "
                "triangle mesh."
            )
    if "vertex" not in elements:
        raise InputError(f"{path.name} has no vertices.")
    table: Any = elements["vertex"].data
    vertices = _columns(table, ("x", "y", "z"))
    if vertices is None:
        raise InputError(
            f"{path.name} could not be read as a mesh: its vertices should have x, y and "
            f"z, but have {', '.join(table.dtype.names)}."
        )
    faces: Any = elements["face"].data if "face" in elements else None
    known: tuple[str, ...] = () if faces is None else faces.dtype.names
    lists = [name for name in _CORNERS if name in known]
    if faces is None or not lists:
        return MeshContents(vertices=vertices, faces=np.zeros((0, 3), dtype=int))
    corners, counts = _flat(faces[lists[0]])
    cut, polygon = triangle_corners(vertices, corners, counts, path.name)
    uv, notes = _corner_uv(table, faces, corners, counts, path.name)
    pictures: list[Picture] = []
    face_picture = None
    if uv is not None:
        uv = uv[cut]
        pictures, missing = _pictures(path, ply, limits)
        notes += [note for note in missing if note]
        if _WEDGE_PICTURE in known and pictures:
            number = np.asarray(faces[_WEDGE_PICTURE], dtype=np.int64)
            number = np.where((number >= 0) & (number < len(missing)), number, -1)
            face_picture = _numbers_of(missing)[number][polygon]
    return MeshContents(
        vertices=vertices,
        faces=corners[cut],
        corner_uv=uv,
        pictures=pictures,
        face_picture=face_picture,
        vertex_colours=_colours(table),
        vertex_normals=_columns(table, ("nx", "ny", "nz")),
        notes=(*notes, *_left_out(ply)),
    )


def _left_out(ply: plyfile.PlyData) -> list[str]:
    """What of the file is not read: a sentence, if there is anything."""
    words = []
    for element in ply.elements:
        known = _READ.get(element.name, ())
        names = [p.name for p in element.properties if p.name not in known]
        if element.name not in _READ and element.count:
            words.append(f"the elements {element.name}")
        elif element.name in _READ and names and element.count:
            words.append(f"{', '.join(names)} of its {element.name} elements")
    return [f"Left out of it were {listed(words)}."] if words else []


def _parsed(path: Path) -> plyfile.PlyData:
    """Reads all of a file.

    Raises:
        PlyParseError: if it is damaged.
        InputError: if it holds more than it announces.
    """
    # Triangles of one length each are read at once; other polygons one by one.
    lengths = {"face": {**dict.fromkeys(_CORNERS, 3), _WEDGE_UV: 6}}
    with open_for_reading(path) as file:
        if b"format ascii" not in file.read(HEADER_BYTES).partition(b"end_header")[0]:
            try:
                file.seek(0)
                ply = plyfile.PlyData.read(file, known_list_len=lengths, mmap="c")
            except plyfile.PlyParseError:
                file.seek(0)
                ply = plyfile.PlyData.read(file, mmap="")
            rest = file.read(HEADER_BYTES)
        else:
            file.seek(0)
            text = file.read()
            binary = as_binary(text)
            if binary is not None:
                with tempfile.TemporaryFile() as mapped:
                    mapped.write(binary[0])
                    mapped.seek(0)
                    return plyfile.PlyData.read(
                        mapped, known_list_len=binary[1], mmap="c"
                    )
            lines = io.StringIO(_without_empty_lines(text).decode("latin-1"))
            ply = plyfile.PlyData.read(lines)
            rest = lines.read(HEADER_BYTES)
    if rest.strip():
        raise InputError(
            f"{path.name} goes on behind the {sum(e.count for e in ply.elements):,} "
            "elements that it announces; it is damaged, or not all of it would be read. "
            "Export it again."
        )
    return ply


def _without_empty_lines(text: bytes) -> bytes:
    """Empty lines part nothing."""
    return b"".join(line for line in text.splitlines(keepends=True) if line.strip())


def _columns(table: Any, names: tuple[str, ...]) -> np.ndarray | None:
    if not set(names) <= set(table.dtype.names):
        return None
    return np.column_stack(
        [np.asarray(table[name], dtype=np.float64) for name in names]
    )


def _flat(lists: Any) -> tuple[np.ndarray, np.ndarray]:
    """All lists behind one another, and the length of each."""
    if lists.dtype != object:
        return lists.reshape(-1).astype(np.int64), np.full(len(lists), lists.shape[1])
    counts = np.array([len(row) for row in lists], dtype=np.int64)
    flat = np.concatenate(list(lists)) if len(lists) else np.zeros(0)
    return flat.astype(np.int64), counts


def _corner_uv(
    table: Any, faces: Any, corners: np.ndarray, counts: np.ndarray, name: str
) -> tuple[np.ndarray | None, list[str]]:
    """Texture coordinates of each corner of each polygon."""
    if faces is not None and _WEDGE_UV in faces.dtype.names:
        rows = faces[_WEDGE_UV]
        if rows.dtype != object:
            lengths = np.full(len(rows), rows.shape[1])
        else:
            lengths = np.array([len(row) for row in rows], dtype=np.int64)
        is_whole = lengths == 2 * counts
        if not (is_whole | (lengths == 0)).all():
            return None, [
                f"The texture coordinates of {name} do not belong to the corners of its "
                "faces (two numbers a corner), so it was read without them."
            ]
        uv = np.zeros((len(corners), 2))
        if is_whole.all() and rows.dtype != object:
            return rows.reshape(-1, 2).astype(np.float64), []
        if is_whole.any():
            flat = np.concatenate([rows[i] for i in np.flatnonzero(is_whole)])
            uv[np.repeat(is_whole, counts)] = flat.reshape(-1, 2)
            return uv, []
        return None, []
    for pair in _VERTEX_UV:
        at_vertices = _columns(table, pair)
        if at_vertices is not None:
            return at_vertices[corners], []
    return None, []


def _pictures(
    path: Path, ply: plyfile.PlyData, limits: Limits
) -> tuple[list[Picture], list[str]]:
    """The textures that are there, and for each that is named why it is not, or ""."""
    pictures, missing = [], []
    for comment in ply.comments:
        words = comment.split(None, 1)
        if len(words) == 2 and words[0].lower() == "texturefile":
            file, note = find_beside(path, words[1], "texture", limits)
            if file is not None:
                picture, note = texture_picture(file, words[1], limits)
                if picture is not None:
                    pictures.append(picture)
            missing.append(note)
    return pictures, missing


def _numbers_of(missing: list[str]) -> np.ndarray:
    """For each texture that is named its place among those that are there; -1 last."""
    is_there = np.array([not note for note in missing], dtype=bool)
    return np.append(np.where(is_there, np.cumsum(is_there) - 1, -1), -1)


def _colours(table: Any) -> np.ndarray | None:
    for names in _COLOUR:
        if set(names) <= set(table.dtype.names):
            return colours_of(np.column_stack([table[name] for name in names]))
    return None
