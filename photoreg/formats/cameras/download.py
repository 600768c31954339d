"""Cameras of any format as one file for a download, with the photos if wanted."""

import dataclasses
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from PIL import Image

from photoreg.errors import InputError, OutputError
from photoreg.formats.archives import zipped
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import (
    FormatName,
    camera_format,
    for_programs,
    write_cameras,
)
from photoreg.formats.photos.files import is_turned
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo

PLACES: dict[FormatName, str] = {
    "photoreg": "cameras.json",
    "colmap": "sparse/0",
    "colmap-text": "sparse/0",
    "nerfstudio": "transforms.json",
    "meshlab": "cameras.mlp",
    "texrecon": ".",
    "opencv": "cameras.yml",
    "bundler": "bundle.out",
    "blender": "cameras.py",
}
"""Where in its zip each format puts the cameras."""

PHOTO_FOLDERS: dict[FormatName, str] = {"colmap": "images", "colmap-text": "images"}
"""Where its programs look for the photos, if not beside the cameras."""


@dataclasses.dataclass(frozen=True)
class CamerasDownload:
    """A file to take home."""

    name: str
    content: bytes
    losses: list[str]
    """A sentence for each thing that these cameras lose."""


def cameras_download(
    name: FormatName,
    cameras: Mapping[str, Camera],
    photos: Sequence[Photo],
    mesh: Mesh | None = None,
    with_photos: bool = True,
) -> CamerasDownload:
    """Cameras as one file: zipped if there are several.

    Args:
        name: The format.
        cameras: By photo file name.
        photos: Their photos. Those that EXIF turns are given upright, as the cameras
            have them; all others as the files they are.
        mesh: What the cameras look at; MeshLab's project names it.
        with_photos: Put photos and mesh into the zip, so that it opens as it is. Formats
            that name no photos leave them out all the same.

    Raises:
        InputError: if the cameras cannot be written in this format.
        OutputError: if there is no room for the files.
    """
    chosen = camera_format(name)
    with tempfile.TemporaryDirectory(prefix="photoreg-") as directory:
        folder = Path(directory)
        copies: dict[str, Path] = {}
        # MeshLab's padded copies are made of the photos, wanted or not.
        if chosen.is_beside_photos and (with_photos or name == "meshlab"):
            where = folder / PHOTO_FOLDERS.get(name, ".")
            where.mkdir(exist_ok=True)
            copies = {p.name: _upright_copy(p, where / p.name) for p in photos}
        scan = _mesh_copy(mesh, folder) if name == "meshlab" and with_photos else None
        place = folder / PLACES[name]
        place.parent.mkdir(parents=True, exist_ok=True)
        written, lost = CameraSet(cameras, copies, scan), []
        if not copies:
            # Without upright copies, the photos that people have are meant.
            stored = {p.name: at for p in photos if (at := _file_of(p)) is not None}
            written, lost = for_programs(chosen, written, stored)
        saved = write_cameras(place, written, name)
        files = list(saved.files)
        if with_photos:
            files += [path for path in (*copies.values(), scan) if path is not None]
        losses = saved.losses + lost
        if len(files) == 1:
            return CamerasDownload(files[0].name, files[0].read_bytes(), losses)
        return CamerasDownload(
            f"cameras-{name}.zip", zipped(folder, sorted(set(files))), losses
        )


def _file_of(thing: Photo | Mesh | None) -> Path | None:
    """The file that a photo or a mesh was read from, if it is there."""
    if thing is None or thing.source is None or not thing.source.path.is_file():
        return None
    return thing.source.path


def _upright_copy(photo: Photo, path: Path) -> Path:
    """The photo's file, or, if EXIF turns it or it is not there, a new one."""
    source = _file_of(photo)
    if source is not None and (
        is_turned(source) or source.suffix.lower() != path.suffix.lower()
    ):
        source = None
    try:
        if source is not None:
            shutil.copyfile(source, path)
        else:
            Image.fromarray(photo.pixels).save(path, quality=97, subsampling=0)
    except ValueError as error:
        raise InputError(
            f"{photo.name} should end in .jpg, .png or .tif, so that it can be written."
        ) from error
    except OSError as error:
        raise OutputError(
            f"{photo.name} could not be copied: {error.strerror or error}."
        ) from error
    return path


def _mesh_copy(mesh: Mesh | None, folder: Path) -> Path | None:
    source = _file_of(mesh)
    if source is None:
        return None
    try:
        return Path(shutil.copyfile(source, folder / source.name))
    except OSError as error:
        raise OutputError(
            f"{source.name} could not be copied: {error.strerror or error}."
        ) from error
