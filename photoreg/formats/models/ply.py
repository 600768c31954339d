"""PLY, binary: with a texture beside it, or with colours at the vertices.

Coordinates are doubles, vertices and faces in the mesh's own order, normals at the
vertices. Texture coordinates belong to the corners of the faces, as MeshLab has them,
so no vertex is doubled; "comment TextureFile" names the picture.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from photoreg.formats.mark import COMMENT
from photoreg.formats.models.encode_texture import (
    PICTURE_SUFFIX,
    PictureKind,
    encode_picture,
)
from photoreg.formats.models.split_vertices import source_files, vertex_colours
from photoreg.formats.writing import NOTHING, Content, check_suffix, write_files
from photoreg.geometry.mesh import Mesh
from photoreg.texture.bake import TexturedMesh

_POINT = [(axis, "<f8") for axis in "xyz"] + [(f"n{axis}", "<f4") for axis in "xyz"]
_COLOUR = [(channel, "u1") for channel in ("red", "green", "blue")]
_FACE = [("n", "u1"), ("vertex_indices", "<i4", 3)]
_CORNERS = [("n_uv", "u1"), ("texcoord", "<f4", 6)]


def save_textured_ply(
    path: Path | str,
    textured: TexturedMesh,
    picture: PictureKind = "png",
    overwrite: bool = False,
    beside: Mapping[Path, Content] = NOTHING,
) -> list[Path]:
    """Writes PLY and picture, which is named after the PLY, spaces as underscores.

    Args:
        path: Where the PLY goes.
        textured: What `bake_texture` returned.
        picture: How the texture is written; JPEG is several times smaller.
        overwrite: Whether files without photoreg's mark may be replaced.
        beside: Other files that are written with it, all or none.

    Returns:
        The two files, and others.

    Raises:
        OutputError: if they cannot be written there.
    """
    path, image = ply_files(check_suffix(path, (".ply",)), picture)
    vertices = _vertices(textured, _POINT)
    faces = np.zeros(len(textured.faces), dtype=np.dtype(_FACE + _CORNERS))
    faces["n"], faces["vertex_indices"] = 3, textured.faces
    faces["n_uv"], faces["texcoord"] = 6, textured.corner_uv.reshape(-1, 6)
    header = _header(vertices, faces, f"comment TextureFile {image.name}\n")
    return write_files(
        {
            path: header + vertices.tobytes() + faces.tobytes(),
            image: encode_picture(textured.texture, picture),
            **beside,
        },
        source_files(textured),
        overwrite,
    )


def ply_files(path: Path, picture: PictureKind) -> list[Path]:
    """The files that `save_textured_ply` writes: PLY, picture."""
    safe = re.sub(r"\s", "_", path.stem)
    return [path, path.with_name(safe + PICTURE_SUFFIX[picture])]


def save_coloured_ply(
    path: Path | str,
    textured: TexturedMesh,
    overwrite: bool = False,
    beside: Mapping[Path, Content] = NOTHING,
) -> list[Path]:
    """Writes PLY with the texture's colour at each vertex.

    Args:
        path: Where it goes.
        textured: What `bake_texture` returned.
        overwrite: Whether a file without photoreg's mark may be replaced.
        beside: Other files that are written with it, all or none.

    Returns:
        The file, and others.

    Raises:
        OutputError: if it cannot be written there.
    """
    path = check_suffix(path, (".ply",))
    vertices = _vertices(textured, _POINT + _COLOUR)
    colours = vertex_colours(textured)
    for i, (channel, _) in enumerate(_COLOUR):
        vertices[channel] = colours[:, i]
    faces = np.zeros(len(textured.faces), dtype=np.dtype(_FACE))
    faces["n"], faces["vertex_indices"] = 3, textured.faces
    content = _header(vertices, faces) + vertices.tobytes() + faces.tobytes()
    return write_files({path: content, **beside}, source_files(textured), overwrite)


def save_mesh(path: Path | str, mesh: Mesh, overwrite: bool = False) -> list[Path]:
    """Writes a mesh's vertices and faces, exactly, as PLY.

    Args:
        path: Where it goes (.ply).
        mesh: The mesh.
        overwrite: Whether a file without photoreg's mark may be replaced.

    Returns:
        The file.

    Raises:
        OutputError: if it cannot be written there, or another file is there.
    """
    path = check_suffix(path, (".ply",))
    return write_files({path: ply_bytes(mesh)}, overwrite=overwrite)


def ply_bytes(mesh: Mesh) -> bytes:
    """The file of `save_mesh`."""
    is_single = np.array_equal(mesh.vertices, mesh.vertices.astype(np.float32))
    number = "<f4" if is_single else "<f8"
    vertices = np.zeros(len(mesh.vertices), [(axis, number) for axis in "xyz"])
    for i, axis in enumerate("xyz"):
        vertices[axis] = mesh.vertices[:, i]
    faces = np.zeros(len(mesh.faces), dtype=np.dtype(_FACE))
    faces["n"], faces["vertex_indices"] = 3, mesh.faces
    return _header(vertices, faces) + vertices.tobytes() + faces.tobytes()


def _vertices(textured: TexturedMesh, fields: list[tuple[str, str]]) -> np.ndarray:
    vertices = np.zeros(len(textured.vertices), dtype=np.dtype(fields))
    for i, axis in enumerate("xyz"):
        vertices[axis] = textured.vertices[:, i]
        vertices[f"n{axis}"] = textured.mesh.normals_to_keep[:, i]
    return vertices


def _header(vertices: np.ndarray, faces: np.ndarray, comment: str = "") -> bytes:
    types = {"<f8": "double", "<f4": "float", "|u1": "uchar"}
    lines = [
        f"ply\nformat binary_little_endian 1.0\ncomment {COMMENT}\n",
        comment,
        f"element vertex {len(vertices)}\n",
        *(
            f"property {types[vertices.dtype[name].str]} {name}\n"
            for name in vertices.dtype.names or ()
        ),
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n",
    ]
    if "texcoord" in (faces.dtype.names or ()):
        lines.append("property list uchar float texcoord\n")
    return "".join([*lines, "end_header\n"]).encode()
