"""How a scene is opened: the demo, one of a folder, one of files."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from app.model.camera_moves import first_camera
from app.model.scene_files import DISPLAY_FACES, photo_files, with_cameras_of_file
from app.model.state import Document, PhotoEntry
from app.model.up_axis import guessed_up
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.formats.cameras.registry import read_cameras
from photoreg.formats.meshes.read import MESH_SUFFIXES, load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.formats.photos.registry import PHOTO_SUFFIXES
from photoreg.report.static_files import static_folder

ROUGH_CAMERAS = "rough.json"

TRUE_CAMERAS = "cameras.json"


def demo_folder() -> Path:
    """The folder of the demo."""
    return static_folder() / "demo"


def open_folder(folder: Path) -> Document:
    """The scene of a folder as `photoreg synthesize` makes it.

    The mesh and the photos are recognised by their suffixes, photos in the order of their
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
                f"Two photos are called {photo.name}; each photo needs a file name of its own."
            )
        placed = tuple(entry.camera for entry in entries)
        camera = first_camera(document.mesh, photo, document.up, placed)
        entries.append(PhotoEntry(photo, camera))
    return dataclasses.replace(document, photos=tuple(entries))
