"""How a scene is opened: the demo, one of a folder, one of files."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

from app.model.camera_moves import first_camera, up_of
from app.model.state import Document, PhotoEntry
from app.model.up_axis import guessed_up
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras
from photoreg.formats.cameras.registry import read_cameras
from photoreg.formats.meshes.read import MESH_SUFFIXES, load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.formats.photos.registry import PHOTO_SUFFIXES
from photoreg.report.static_files import static_folder

DISPLAY_FACES = 150_000
"""Faces the page draws at most; WebGL in a browser takes 200,000 with ease."""

ROUGH_CAMERAS = "rough.json"
TRUE_CAMERAS = "cameras.json"


def demo_folder() -> Path:
    """The folder of the demo."""
    return static_folder() / "demo"


def open_folder(folder: Path) -> Document:
    """The scene of a folder as `photoreg synthesize` makes it.

    The mesh and the photos are told by their suffixes, photos in the order of their
    names; ``rough.json`` is where to start, ``cameras.json`` the truth beside it, or
    the start where there is no ``rough.json``.

    Raises:
        InputError: if the folder has no mesh or no photos, or a file is not valid.
    """
    if not folder.is_dir():
        raise InputError(f"The folder {folder} does not exist. Check the path.")
    files = sorted(path for path in folder.iterdir() if path.is_file())
    document = open_files(
        [p for p in files if p.suffix.lower() in MESH_SUFFIXES][:1]
        + [p for p in files if p.suffix.lower() in PHOTO_SUFFIXES]
    )
    if document.mesh is None or not document.photos:
        raise InputError(
            f"{folder} should hold a mesh ({', '.join(MESH_SUFFIXES)}) and photos "
            f"({', '.join(PHOTO_SUFFIXES)})."
        )
    rough, true = folder / ROUGH_CAMERAS, folder / TRUE_CAMERAS
    if rough.exists():
        file = read_cameras(rough, photos=photo_files(document))
        document = with_cameras_of_file(document, file, rough.name)
        if true.exists():
            truth = tuple(load_cameras(true).cameras.items())
            document = dataclasses.replace(document, truth=truth)
    elif true.exists():
        file = read_cameras(true, photos=photo_files(document))
        document = with_cameras_of_file(document, file, true.name)
    return document


def open_files(paths: Sequence[Path]) -> Document:
    """The scene of a mesh and photos, in any order, with first cameras.

    Raises:
        InputError: if there are two meshes, a file of neither kind, or an invalid one.
    """
    document = Document()
    photos = []
    for path in paths:
        suffix = path.suffix.lower()
        if suffix in MESH_SUFFIXES:
            if document.mesh is not None:
                raise InputError(
                    f"{path.name} is a second mesh; photos are laid onto one. "
                    "Join the meshes first."
                )
            mesh = load_mesh(path)
            shown = mesh.decimated(DISPLAY_FACES)
            document = dataclasses.replace(
                document, mesh=mesh, display_mesh=shown, up=guessed_up(shown)[0]
            )
        elif suffix in PHOTO_SUFFIXES:
            photos.append(path)
        else:
            raise InputError(
                f"{path.name} is neither a mesh ({', '.join(MESH_SUFFIXES)}) nor a "
                f"photo ({', '.join(PHOTO_SUFFIXES)})."
            )
    entries: list[PhotoEntry] = []
    for path in photos:
        photo = load_photo(path)
        if any(entry.name == photo.name for entry in entries):
            raise InputError(
                f"Two photos are called {photo.name}; photos are told by file name."
            )
        placed = tuple(entry.camera for entry in entries)
        camera = first_camera(document.mesh, photo, document.up, placed)
        entries.append(PhotoEntry(photo, camera))
    return dataclasses.replace(document, photos=tuple(entries))


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
