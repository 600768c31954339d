"""Kinds of files that browsers bring, told by suffix."""

from pathlib import Path

from photoreg.formats.cameras.registry import CAMERA_SUFFIXES
from photoreg.formats.meshes.packed import PACKED_SUFFIX
from photoreg.formats.meshes.read import MESH_SUFFIXES
from photoreg.formats.photos.registry import PHOTO_SUFFIXES

MESH, PHOTO, CAMERAS, MATERIAL, UNREAD = range(5)
KINDS = (MESH_SUFFIXES, PHOTO_SUFFIXES, (*CAMERA_SUFFIXES, ".zip"), (".mtl",))
"""In the order in which they are opened: cameras are matched to photos that are there.
Materials are no files by themselves, but belong to a mesh."""


def kind_of(path: Path) -> int:
    """The place in ``KINDS``; ``UNREAD`` if it is none of them."""
    suffix = path.suffix.lower()
    if suffix == PACKED_SUFFIX:
        return MESH
    return next((i for i, kind in enumerate(KINDS) if suffix in kind), UNREAD)


def is_zip(path: Path) -> bool:
    """Whether files of all kinds may be in it."""
    return path.suffix.lower() == ".zip"
