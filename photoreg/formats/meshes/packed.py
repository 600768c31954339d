"""A mesh with the files that it names, in one: what the app keeps of a dropped OBJ.

Browsers bring files without their folders, and a project knows one file a mesh. So the
mesh, its MTL files and its pictures are put into one zip, each where the mesh looks for
it, under a suffix of its own.
"""

import contextlib
import dataclasses
import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from photoreg.errors import InputError
from photoreg.formats.archives import unzipped
from photoreg.formats.meshes.headers import HEADER_BYTES
from photoreg.names import presentable
from photoreg.sources import open_for_reading, read_regular
from photoreg.words import nfc

PACKED_SUFFIX = ".meshzip"

_OBJ_NAMES = re.compile(rb"(?m)^[ \t]*mtllib[ \t]+([^\r\n]+)")
_PLY_NAMES = re.compile(rb"(?mi)^comment[ \t]+TextureFile[ \t]+([^\r\n]+)")
_MTL_NAMES = re.compile(r"(?mi)^\s*(?:map_\w+|bump|disp|decal|norm|refl)\s+([^\r\n]+)")
_OPTION = re.compile(r"-\w+(?:\s+(?:on|off|[-+.\d][-+.\deE]*))*\s+")


def named_by(mesh: Path, material_files: Iterable[Path] = ()) -> set[str]:
    """Names of the files that a mesh, or an MTL file of it, names; without folders.

    Args:
        mesh: An OBJ or PLY file; others hold all that is theirs.
        material_files: MTL files; those that the mesh does not name are passed over.
    """
    suffix, lines = mesh.suffix.lower(), []
    if suffix == ".obj":
        lines = _OBJ_NAMES.findall(read_regular(mesh))
    elif suffix == ".ply":
        with open_for_reading(mesh) as file:
            head = file.read(HEADER_BYTES).partition(b"end_header")[0]
        lines = _PLY_NAMES.findall(head)
    names = _plain_names(line.decode("utf-8", "replace") for line in lines)
    for path in material_files:
        if _key(path.name) in names:
            text = read_regular(path).decode("utf-8", "replace")
            names |= _plain_names(_MTL_NAMES.findall(text))
    return names


def _plain_names(lines: Iterable[str]) -> set[str]:
    """The last part of each name; a name may have spaces, or options before it."""
    names = set()
    for line in lines:
        whole = _OPTION.sub("", line.strip())
        for name in (line, whole, *whole.split()):
            names.add(_key(name))
    return names


def _key(name: str) -> str:
    plain = name.strip().strip('"').replace("\\", "/").rpartition("/")[2]
    return presentable(nfc(plain)).casefold()


def belonging(mesh: Path, others: Sequence[Path]) -> list[Path]:
    """Which of other files a mesh names."""
    names = named_by(mesh, [p for p in others if p.suffix.lower() == ".mtl"])
    return [path for path in others if _key(path.name) in names]


def pack(mesh: Path, beside: Sequence[Path], target: Path) -> None:
    """Writes a mesh and the files that belong to it as one.

    Args:
        mesh: The mesh.
        beside: Files that it names. Each goes where it lies from the mesh, or, if that is
            elsewhere, beside it.
        target: Where the file goes, of suffix ``PACKED_SUFFIX``.
    """
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:
        archive.write(mesh, mesh.name)
        for place, path in {_place(mesh, path): path for path in beside}.items():
            archive.write(path, place)


def _place(mesh: Path, path: Path) -> str:
    try:
        return path.relative_to(mesh.parent).as_posix()
    except ValueError:
        return path.name


@dataclasses.dataclass(frozen=True)
class Unpacked:
    """The files of a packed mesh, while they are there."""

    mesh: Path
    files: list[Path]
    """All, the mesh among them."""


@contextlib.contextmanager
def unpacked(path: Path, suffixes: Sequence[str]) -> Iterator[Unpacked]:
    """Unpacks a packed mesh for a while.

    Raises:
        InputError: if it is damaged, or holds no single mesh.
    """
    with tempfile.TemporaryDirectory(prefix="photoreg-") as name:
        files = unzipped(path, Path(name), lambda _: True)
        meshes = [file for file in files if file.suffix.lower() in suffixes]
        if len(meshes) != 1:
            raise InputError(
                f"{path.name} should hold one mesh, but holds {len(meshes)}. Give the "
                "mesh and its files themselves."
            )
        yield Unpacked(meshes[0], files)
