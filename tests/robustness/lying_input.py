"""Files that lie, and what a reader should say of each: a case of the table."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from app.engine.read_job import UnpackRequest
from photoreg.formats.archives import unzipped
from photoreg.formats.cameras.registry import read_cameras
from photoreg.formats.meshes.packed import PACKED_SUFFIX
from photoreg.formats.meshes.read import MESH_SUFFIXES, load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.formats.photos.registry import PHOTO_SUFFIXES
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.limits import Limits

LIMITS = Limits(
    file_mb=1.0, camera_file_mb=1.0, faces_millions=0.05, photo_megapixels=0.2
)
"""Small, so that what is too large is quick to make."""


OUT = "unpacked"
"""Folder of what comes out of a zip."""


@dataclasses.dataclass(frozen=True)
class Case:
    """One file, and what its reader should say or give."""

    what: str
    """What is wrong with it."""
    name: str
    """File name."""
    content: bytes | Callable[[Path], object]
    """Its bytes, or what makes it, and what lies beside it, in a folder."""
    expected: str
    """A part of the sentence, or of the description of what was read."""
    told: str = ""
    """A part of what is told beside, where it is read."""


def read(case: Case, folder: Path) -> Any:
    """Makes the file and reads it as the app would."""
    path = folder / case.name
    if isinstance(case.content, bytes):
        path.write_bytes(case.content)
    else:
        case.content(path)
    return read_path(path)


def read_path(path: Path) -> Any:
    """Reads a mesh, a photo, or cameras, by the suffix."""
    suffix = path.suffix.lower()
    if suffix in (*MESH_SUFFIXES, PACKED_SUFFIX):
        return load_mesh(path, LIMITS)
    if suffix in PHOTO_SUFFIXES:
        return load_photo(path, LIMITS)
    if suffix == ".zip":
        return unpack(path)
    return read_cameras(path, photos=sorted(path.parent.glob("*.png")))


def unpack(archive: Path) -> list[Path]:
    """What the app takes out of a zip; asserts that nothing comes elsewhere."""
    folder = archive.parent / OUT
    shutil.rmtree(folder, ignore_errors=True)
    around = archive.parents[1]
    before = set(around.rglob("*"))
    paths = unzipped(
        archive, folder, UnpackRequest((), (), folder, frozenset(), False).wants
    )
    strays = {p for p in around.rglob("*") if not p.is_relative_to(folder)} - before
    assert not strays, f"files came elsewhere: {strays}"
    assert not any(path.is_symlink() for path in folder.rglob("*"))
    return paths


def described(value: Any) -> str:
    """What was read, in words."""
    if isinstance(value, Mesh):
        text = f"read: {len(value.faces)} triangles, {len(value.vertices)} vertices"
        extras = {
            "normals": value.own_normals,
            "texture": value.own_texture,
            "texture coordinates": value.corner_uv,
            "colours": value.vertex_colours,
        }
        return ", ".join([text, *(k for k, v in extras.items() if v is not None)])
    if isinstance(value, Photo):
        corner = tuple(int(v) for v in value.pixels[0, 0])
        mask = "" if value.mask is None else ", mask"
        return f"read: {value.width} x {value.height} px, first pixel {corner}{mask}"
    if isinstance(value, list):
        at = [path.parts.index(OUT) + 1 for path in value]
        names = ["/".join(path.parts[i:]) for i, path in zip(at, value, strict=True)]
        return f"read: {', '.join(names) or 'nothing'}"
    return f"read: {len(value.cameras)} cameras"
