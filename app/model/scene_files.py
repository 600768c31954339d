"""The files of what is open, and the cameras of one, matched to its photos."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path

from app.model.camera_moves import up_of
from app.model.state import Document
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import CameraFile

DISPLAY_FACES = 150_000
"""Faces the page draws at most; WebGL in a browser takes 200,000 with ease."""


def photo_files(document: Document) -> dict[str, Path]:
    """The files of the photos, by name, as far as they are there."""
    return {
        entry.name: entry.photo.source.path
        for entry in document.photos
        if entry.photo.source is not None and entry.photo.source.path.is_file()
    }


def mesh_file(document: Document) -> Path | None:
    """The file of the mesh, if it is there."""
    source = None if document.mesh is None else document.mesh.source
    return source.path if source is not None and source.path.is_file() else None


def with_cameras_of_file(document: Document, file: CameraFile, name: str) -> Document:
    """The document with cameras that were read, matched by photo name.

    Photos that the file does not have keep their cameras.

    Args:
        document: What is open.
        file: The cameras.
        name: Of the file, for the sentence of an error.

    Raises:
        InputError: if none of the photos has a camera there, or one is for a photo of
            another size.
    """
    if not document.photos:
        raise InputError(
            f"{name} has cameras for {first_names(file.cameras)}. Open these photos first, "
            "or together with it: cameras are matched to photos by file name."
        )
    known = [entry for entry in document.photos if file.of_photo(entry.name)]
    if not known:
        raise InputError(
            f"{name} has cameras for {first_names(file.cameras)}, but the photos are "
            f"{first_names(entry.name for entry in document.photos)}. Photos are matched by "
            "file name; rename them in the list above."
        )
    cameras = file.of_photos([entry.photo for entry in known])
    found = {entry.name: camera for entry, camera in zip(known, cameras, strict=True)}
    return dataclasses.replace(
        document,
        photos=tuple(
            dataclasses.replace(entry, camera=found.get(entry.name, entry.camera))
            for entry in document.photos
        ),
        up=(document.up_axis == "auto" and up_of(tuple(cameras))) or document.up,
    )


def first_names(names: Iterable[str], most: int = 5) -> str:
    """The first names, and how many more there are."""
    known = list(names)
    more = f" and {len(known) - most} more" if len(known) > most else ""
    return (", ".join(known[:most]) or "nothing") + more
