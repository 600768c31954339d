"""OBJ, with its MTL files and pictures."""

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import tinyobjloader

from photoreg.errors import InputError
from photoreg.formats.meshes.beside import find_beside
from photoreg.formats.meshes.contents import (
    MeshContents,
    Picture,
    colours_of,
    texture_picture,
)
from photoreg.formats.meshes.polygons import triangle_corners
from photoreg.formats.parsing import refuse_utf16
from photoreg.limits import Limits
from photoreg.sources import read_regular

_CURVED = (b"curv", b"curv2", b"surf", b"cstype", b"deg", b"bmat", b"step", b"con")
"""Statements that define free-form curves and surfaces."""

_KNOWN = (
    *(b"v", b"vt", b"vn", b"vp", b"f", b"l", b"p", b"o", b"g", b"s", b"mg"),
    *(b"usemtl", b"mtllib", b"usemap", b"maplib", b"bevel", b"c_interp", b"d_interp"),
    *(b"lod", b"shadow_obj", b"trace_obj", b"parm", b"end", *_CURVED),
)
"""Keywords that a line may begin with; others are reported."""

_COMMENT = re.compile(rb"(?m)^([ \t]*(?:v|vt|vn|f)[ \t][^#\r\n]*)(?<=[ \t])#[^\r\n]*")
"""A comment after numbers, which tinyobjloader does not expect. Its # starts a new word,
unlike that in the NaNs that MSVC writes (-1.#IND, 1.#QNAN)."""

_WORDS = {
    key: re.compile(rb"(?m)^[ \t]*%s[ \t][^\r\n]*[^-+.\deE\s]" % key)
    for key in (b"vt", b"vn")
}
"""A line of texture coordinates or normals with something that is not a number."""

_MOVED_TEXTURE = re.compile(r"\s-(?:s|o|t|mm)\s+(?:-?[\d.]+(?:[eE][-+]?\d+)?\s+)+")
"""Options of a texture in an MTL file that scale, shift, disturb or fade it."""
_UNMOVED = {"s": {1.0}, "o": {0.0}, "t": {0.0}, "mm": {0.0, 1.0}}
"""Values with which these options have no effect."""


@dataclasses.dataclass
class _Lines:
    """What the lines of the file say, counted without tinyobjloader."""

    vertices: list[bytes] = dataclasses.field(default_factory=list)
    n_faces: int = 0
    material_files: list[str] = dataclasses.field(default_factory=list)
    curved: str = ""
    n_lines_and_points: int = 0
    unknown: dict[bytes, int] = dataclasses.field(default_factory=dict)
    """Keywords that are not supported, and how many lines begin with each; among them
    ZBrush's vertex colours, which are in comments."""


def read_obj(path: Path, limits: Limits) -> MeshContents:
    """Reads an OBJ file.

    tinyobjloader reads faces and materials. Vertices are read here, to the last bit, and
    lines of vertices and faces are counted here, so that nothing is lost silently.

    Raises:
        InputError: if a line is not understood, a face refers to what does not exist, or
            the surface is not made of polygons.
    """
    # Other readers join a line that ends with a backslash to the next.
    text = read_regular(path).removeprefix(b"\xef\xbb\xbf").replace(b"\\\r\n", b" ")
    text = text.replace(b"\\\n", b" ").replace(b"\0", b" ")
    text = _COMMENT.sub(rb"\1", text)
    lines = _lines(text)
    if lines.curved:
        raise InputError(
            f"{path.name} holds a curved surface ({lines.curved}), not only polygons. "
            "Export it as a polygon mesh."
        )
    vertices, colours, colour_notes = _vertices(path.name, lines.vertices)
    materials, notes = _material_text(path, lines.material_files, limits)
    reader, config = tinyobjloader.ObjReader(), tinyobjloader.ObjReaderConfig()
    config.triangulate = False
    if not reader.ParseFromString(text.decode("utf-8", "replace"), materials, config):
        line = re.search(r"[Ll]ine (\d+)", reader.Error())
        raise InputError(
            f"{path.name} could not be read as a mesh: "
            f"{f'line {line[1]}' if line else 'a line'} is not understood, or refers to "
            "a vertex that does not exist. Export it again."
        )
    complaints = reader.Warning()
    if "out of bounds" in complaints:
        raise InputError(
            f"{path.name} has faces that refer to vertices, texture coordinates or "
            f"normals that do not exist ({_one_line(complaints)}). Is the file complete?"
        )
    meshes: list[Any] = [shape.mesh for shape in reader.GetShapes()]
    counts = _joined(mesh.num_face_vertices for mesh in meshes)
    if len(counts) != lines.n_faces:
        raise InputError(
            f"{path.name} has {lines.n_faces:,} lines of faces, but {len(counts):,} "
            "faces could be read; some have fewer than three corners or are not "
            "understood. Export it again, triangulated."
        )
    corners = _joined(mesh.vertex_indices() for mesh in meshes)
    if len(reader.GetAttrib().vertices) != 3 * len(vertices):
        raise InputError(
            f"{path.name} has {len(vertices):,} lines of vertices, but "
            f"{len(reader.GetAttrib().vertices) // 3:,} could be read. Export it again."
        )
    cut, polygon = triangle_corners(vertices, corners, counts, path.name)
    uv, normals, normal_note = None, None, []
    if _WORDS[b"vt"].search(text):
        notes.append(
            "Some texture coordinates are not numbers, so the mesh was read without texture "
            "coordinates."
        )
    else:
        uv = _corner_uv(reader, meshes, cut)
    if _WORDS[b"vn"].search(text):
        notes.append(
            "Some normals are not numbers, so the mesh was read without normals."
        )
    else:
        normals, normal_note = _normals(reader, meshes, corners, len(vertices))
    pictures, face_picture = [], None
    if uv is not None:
        pictures, face_picture, picture_notes = _pictures(path, reader, meshes, limits)
        notes += picture_notes
    notes += _left_out_of_materials(reader, meshes, bool(pictures))
    if face_picture is not None:
        face_picture = face_picture[polygon]
    if lines.n_lines_and_points:
        notes.append(
            f"{lines.n_lines_and_points:,} lines and points, which are not part of the "
            "surface, were left out."
        )
    notes += colour_notes
    if lines.unknown:
        notes.append(_unknown_note(lines.unknown))
    return MeshContents(
        vertices=vertices,
        faces=corners[cut],
        corner_uv=uv,
        pictures=pictures,
        face_picture=face_picture,
        vertex_colours=colours,
        vertex_normals=normals,
        notes=(*notes, *normal_note),
    )


def _lines(text: bytes) -> _Lines:
    found = _Lines()
    for line in text.splitlines():
        words = line.split(None, 1)
        if not words:
            continue
        key = words[0]
        if key == b"v":
            found.vertices.append(words[1] if len(words) > 1 else b"")
        elif key == b"f":
            found.n_faces += 1
        elif key == b"mtllib" and len(words) > 1:
            found.material_files.append(words[1].decode("utf-8", "replace").strip())
        elif key in (b"l", b"p"):
            found.n_lines_and_points += 1
        elif key in _CURVED:
            found.curved = found.curved or key.decode()
        elif key == b"#MRGB" or (key not in _KNOWN and not key.startswith(b"#")):
            found.unknown[key] = found.unknown.get(key, 0) + 1
    return found


def _vertices(
    name: str, rows: list[bytes]
) -> tuple[np.ndarray, np.ndarray | None, list[str]]:
    """Positions, colours where every vertex has some, and what was left out."""
    if not rows:
        return np.zeros((0, 3)), None, []
    widths = {len(row.split()) for row in rows}
    try:
        if len(widths) == 1:
            (width,) = widths
            table = np.array(b" ".join(rows).split(), dtype=np.float64)
            table = table.reshape(len(rows), width)
        else:
            width = min(widths)
            split = [row.split()[:width] for row in rows]
            table = np.array(split, dtype=np.float64)
    except ValueError as error:
        raise InputError(
            f"{name} could not be read as a mesh: a vertex has values "
            "that are not numbers. Export it again."
        ) from error
    if width < 3:
        raise InputError(
            f"{name} could not be read as a mesh: a vertex should have three numbers, "
            f"but one has {width}. Export it again."
        )
    if width == 7 and not (table[:, 3] == 1.0).all():
        # Not x y z w red green blue, but alpha after the colours.
        table, width = table[:, :6], 6
    if width == 4 and not (table[:, 3] == 1.0).all():
        raise InputError(
            f"{name} has vertices with a fourth coordinate other than 1 (weights of a "
            "rational surface). Export it as a polygon mesh."
        )
    if width not in (3, 4, 6, 7):
        raise InputError(
            f"{name} has vertices of {width} numbers; x, y and z are understood, and "
            "a weight or a colour after them. Export it again."
        )
    # x y z, or x y z w, and optionally followed by red, green, blue.
    colours = colours_of(table[:, -3:]) if width >= 6 else None
    note = "Only some of its vertices have colours, which were left out."
    notes = [note] if width < 6 <= max(widths) else []
    return np.ascontiguousarray(table[:, :3]), colours, notes


def _material_text(
    path: Path, names: list[str], limits: Limits
) -> tuple[str, list[str]]:
    """All MTL files of a mesh as one text, and what could not be read."""
    texts, notes = [], []
    for line in dict.fromkeys(names):
        # A name may contain spaces, or a line may hold several names.
        found, note = find_beside(path, line, "material file", limits)
        several = [
            find_beside(path, word, "material file", limits) for word in line.split()
        ]
        if found is None and all(one for one, _ in several):
            files = [one for one, _ in several if one is not None]
        elif found is None:
            notes.append(note)
            continue
        else:
            files = [found]
        for file in files:
            content = read_regular(file)
            refuse_utf16(file, content)
            texts.append(content.decode("utf-8", "replace"))
    text = "\n".join(texts).replace("\ufeff", "")
    moved = [line for line in text.splitlines() if _moves_texture(line)]
    for line in dict.fromkeys(moved):
        notes.append(
            f"Its material file scales, shifts or fades a texture ({_one_line(line)}), which "
            "programs read differently, so it was read without it. Apply that to the "
            "texture coordinates, or to the picture."
        )
        text = text.replace(line, "")
    return text, notes


def _moves_texture(line: str) -> bool:
    if line.split(None, 1)[:1] != ["map_Kd"]:
        return False
    for option in _MOVED_TEXTURE.findall(line):
        key, *numbers = option.split()
        if not {float(number) for number in numbers} <= _UNMOVED[key.removeprefix("-")]:
            return True
    return False


def _joined(parts: Iterable[Any]) -> np.ndarray:
    arrays = [np.array(part, dtype=np.int64) for part in parts]
    return np.concatenate([*arrays, np.zeros(0, dtype=np.int64)])


def _corner_uv(reader: Any, meshes: list[Any], cut: np.ndarray) -> np.ndarray | None:
    index = _joined(mesh.texcoord_indices() for mesh in meshes)
    table = np.array(reader.GetAttrib().texcoords, dtype=np.float64).reshape(-1, 2)
    if len(table) == 0 or not (index >= 0).any():
        return None
    # Faces without coordinates, among others that have them, all map to one point.
    rows = np.vstack([table, [[0.0, 0.0]]])
    return rows[index][cut]


def _normals(
    reader: Any, meshes: list[Any], corners: np.ndarray, n: int
) -> tuple[np.ndarray | None, list[str]]:
    """One normal per vertex: the mean where it has several, along hard edges."""
    index = _joined(mesh.normal_indices() for mesh in meshes)
    table = np.array(reader.GetAttrib().normals, dtype=np.float64).reshape(-1, 3)
    if len(table) == 0 or not (index >= 0).all():
        return None, []
    pairs = np.unique(np.column_stack([corners, index]), axis=0)
    normals = np.zeros((n, 3))
    np.add.at(normals, pairs[:, 0], table[pairs[:, 1]])
    lone = np.unique(np.column_stack([pairs[:, 0], table[pairs[:, 1]]]), axis=0)
    note = "Where a vertex has several normals, along hard edges, their mean is kept."
    return normals, [note] if len(lone) > len(np.unique(pairs[:, 0])) else []


def _pictures(
    path: Path, reader: Any, meshes: list[Any], limits: Limits
) -> tuple[list[Picture], np.ndarray | None, list[str]]:
    """The pictures of the materials, which of them each face shows, and what is missing."""
    of_face = _joined(mesh.material_ids for mesh in meshes)
    pictures: list[Picture] = []
    number: dict[str, int] = {}
    of_material, notes, plain = [], [], {}
    for i, material in enumerate(reader.GetMaterials()):
        name = material.diffuse_texname
        if name and (of_face == i).any() and name not in number:
            number[name] = -1
            file, note = find_beside(path, name, "texture", limits)
            if file is not None:
                picture, note = texture_picture(file, name, limits)
                if picture is not None:
                    number[name] = len(pictures)
                    pictures.append(picture)
            notes += [note] if note else []
        of_material.append(number.get(name, -1))
        plain[i] = np.rint(255.0 * np.clip(material.diffuse, 0.0, 1.0))
    if not pictures:
        return [], None, notes
    for i, shown in enumerate(of_material):
        if shown < 0:
            of_material[i] = len(pictures)
            pictures.append(np.full((8, 8, 3), plain[i], dtype=np.uint8))
    return pictures, np.array([*of_material, -1])[of_face], notes


def _left_out_of_materials(
    reader: Any, meshes: list[Any], has_pictures: bool
) -> list[str]:
    """Colours of the materials in use that were not read."""
    known = reader.GetMaterials()
    used = [
        known[i]
        for i in np.unique(_joined(mesh.material_ids for mesh in meshes))
        if 0 <= i < len(known)
    ]
    notes = []
    for material in used:
        others = material.ambient_texname, material.emissive_texname
        name = next((other for other in others if other), "")
        if name and not material.diffuse_texname:
            notes.append(
                f"The texture {name} does not hold the surface's colours (map_Kd) but ambient "
                "or emitted light, and was left out."
            )
    if not has_pictures and len({tuple(m.diffuse) for m in used}) > 1:
        notes.append("The colours of its materials (Kd) were left out.")
    return notes


def _unknown_note(unknown: dict[bytes, int]) -> str:
    n_lines = sum(unknown.values())
    words = [word.decode("ascii", "backslashreplace")[:20] for word in unknown][:3]
    return (
        f"{n_lines:,} lines that begin with {', '.join(map(repr, words))}"
        f"{' and others' if len(unknown) > 3 else ''} are not understood and were left out."
    )


def _one_line(text: str) -> str:
    return re.sub(r"\s+", " ", text).strip(" .")[:120]
