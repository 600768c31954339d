"""Textured OBJ: the mesh, its material file and its texture, side by side."""

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
from photoreg.formats.models.split_vertices import source_files
from photoreg.formats.writing import NOTHING, Content, check_suffix, write_files
from photoreg.texture.bake import TexturedMesh


def save_textured_obj(
    path: Path | str,
    textured: TexturedMesh,
    picture: PictureKind = "png",
    overwrite: bool = False,
    beside: Mapping[Path, Content] = NOTHING,
) -> list[Path]:
    """Writes OBJ, MTL and picture, all of them or none.

    Coordinates, vertex order and face order are the mesh's own. The material and the
    texture are named after the OBJ and referred to without a folder, with every
    space as an underscore: readers differ in how they take a name with spaces.

    Args:
        path: Where the OBJ goes.
        textured: What `bake_texture` returned.
        picture: How the texture is written; JPEG is several times smaller.
        overwrite: Whether files without photoreg's mark may be replaced.
        beside: Other files that are written with it, all or none.

    Returns:
        The files written: OBJ, MTL, picture, and others.

    Raises:
        OutputError: if they cannot be written there.
    """
    obj, mtl, image = obj_files(check_suffix(path, (".obj",)), picture)
    contents = {
        obj: _obj_bytes(textured, mtl.name),
        mtl: _mtl_bytes(image.name),
        image: encode_picture(textured.texture, picture),
        **beside,
    }
    return write_files(contents, source_files(textured), overwrite)


def obj_files(path: Path, picture: PictureKind) -> list[Path]:
    """The files that `save_textured_obj` writes: OBJ, MTL, picture."""
    safe = re.sub(r"\s", "_", path.stem)
    suffixes = (".mtl", PICTURE_SUFFIX[picture])
    return [path, *(path.with_name(safe + suffix) for suffix in suffixes)]


def _obj_bytes(textured: TexturedMesh, mtl_name: str) -> bytes:
    mesh, atlas = textured.mesh, textured.atlas
    corners = np.stack([mesh.faces, atlas.uv_faces, mesh.faces], axis=2) + 1
    return b"".join(
        [
            f"# {COMMENT}\n".encode(),
            f"mtllib {mtl_name}\n".encode(),
            # repr() is the shortest text that reads back as the same number.
            _rows("v {!r} {!r} {!r}\n", mesh.vertices),
            _rows("vt {:.7f} {:.7f}\n", atlas.uv),
            _rows("vn {:.6f} {:.6f} {:.6f}\n", mesh.normals_to_keep),
            b"usemtl textured\n",
            _rows("f {}/{}/{} {}/{}/{} {}/{}/{}\n", corners.reshape(-1, 9)),
        ]
    )


def _rows(template: str, rows: np.ndarray) -> bytes:
    # One format call a chunk is several times faster than one a row, and bounded.
    chunks = []
    for first in range(0, len(rows), 10_000):
        chunk = rows[first : first + 10_000]
        chunks.append((template * len(chunk)).format(*chunk.ravel().tolist()).encode())
    return b"".join(chunks)


def _mtl_bytes(picture_name: str) -> bytes:
    # Ambient and diffuse white and no highlight: viewers show the texture as it is.
    return (
        f"# {COMMENT}\n"
        "newmtl textured\n"
        "Ka 1.0 1.0 1.0\n"
        "Kd 1.0 1.0 1.0\n"
        "Ks 0.0 0.0 0.0\n"
        "d 1.0\n"
        "illum 1\n"
        f"map_Kd {picture_name}\n"
    ).encode()
