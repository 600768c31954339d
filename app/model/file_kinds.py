"""Kinds of files that browsers bring, told by suffix."""

from pathlib import Path

from photoreg.formats.cameras.find import CAMERA_SUFFIXES
from photoreg.formats.meshes.read import MESH_SUFFIXES
from photoreg.formats.photos.registry import PHOTO_SUFFIXES

MESH, PHOTO, CAMERAS = range(3)
KINDS = (MESH_SUFFIXES, PHOTO_SUFFIXES, (*CAMERA_SUFFIXES, ".zip"))
"""In the order in which they are opened: cameras are matched to photos that are there."""


def kind_of(path: Path) -> int:
    """The place in ``KINDS``; their number if it is none of them."""
    suffix = path.suffix.lower()
    return next((i for i, kind in enumerate(KINDS) if suffix in kind), len(KINDS))


def is_zip(path: Path) -> bool:
    """Whether files of all kinds may be in it."""
    return path.suffix.lower() == ".zip"
