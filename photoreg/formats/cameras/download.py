"""Cameras of any format as one file for a download, with the photos if wanted."""

import dataclasses
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from photoreg.errors import InputError, OutputError
from photoreg.formats.archives import unzipped, zipped
from photoreg.formats.cameras.camera_set import CameraSet, FormatName
from photoreg.formats.cameras.registry import camera_format, for_programs, write_cameras
from photoreg.formats.meshes.packed import PACKED_SUFFIX
from photoreg.formats.meshes.read import MESH_SUFFIXES
from photoreg.formats.photos.files import is_turned
from photoreg.formats.photos.registry import PHOTO_FORMATS
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo

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
    "realityscan": ".",
    "alicevision": "cameras.sfm",
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
    undistorted: bool = False,
) -> CamerasDownload:
    """Cameras as one file: zipped if there are several.

    Args:
        name: The format.
        cameras: By photo file name.
        photos: Their photos. Those that EXIF turns are given upright, as the cameras
            have them, and those of formats that few programs read (HEIC, RAW) as JPEG;
            all others as the files they are.
        mesh: What the cameras look at; MeshLab's project names it.
        with_photos: Put photos and mesh into the zip, so that it opens as it is. Formats
            that name no photos leave them out all the same.
        undistorted: Give photos and cameras without lenses instead: each photo that has
            one as PNG, as an ideal lens would have taken it, transparent where it shows
            nothing. They always go along, for no others fit these cameras.

    Raises:
        InputError: if the cameras cannot be written in this format.
        OutputError: if there is no room for the files.
    """
    chosen = camera_format(name)
    if undistorted:
        cameras, photos = _without_lenses(cameras, photos)
        with_photos = True
    with tempfile.TemporaryDirectory(prefix="photoreg-") as directory:
        folder = Path(directory)
        copies: dict[str, Path] = {}
        losses: list[str] = []
        # MeshLab's padded copies are made of the photos, wanted or not.
        if undistorted or (
            chosen.is_beside_photos and (with_photos or name == "meshlab")
        ):
            where = folder / PHOTO_FOLDERS.get(name, ".")
            where.mkdir(exist_ok=True)
            names = _names_for_all(photos)
            copies = {
                names[p.name]: _upright_copy(p, where / names[p.name]) for p in photos
            }
            cameras = {names.get(photo, photo): c for photo, c in cameras.items()}
            losses += [
                f"{old} is given as {new}: hardly any program reads the original."
                for old, new in names.items()
                if old != new
            ]
        scans = _mesh_copies(mesh, folder) if name == "meshlab" and with_photos else []
        place = folder / PLACES[name]
        place.parent.mkdir(parents=True, exist_ok=True)
        written, lost = CameraSet(cameras, copies, scans[0] if scans else None), []
        if not copies:
            # Without upright copies, the photos that people have are meant.
            stored = {p.name: at for p in photos if (at := _file_of(p)) is not None}
            written, lost = for_programs(chosen, written, stored)
        saved = write_cameras(place, written, name)
        files = list(saved.files)
        if with_photos:
            files += [*copies.values(), *scans]
        losses += saved.losses + lost
        if len(files) == 1:
            return CamerasDownload(files[0].name, files[0].read_bytes(), losses)
        return CamerasDownload(
            f"cameras-{name}.zip", zipped(folder, sorted(set(files))), losses
        )


def _without_lenses(
    cameras: Mapping[str, Camera], photos: Sequence[Photo]
) -> tuple[dict[str, Camera], list[Photo]]:
    """Cameras without lenses, and the photos that ideal lenses would have taken."""
    ideal: dict[str, Camera] = {}
    flat = []
    for photo in photos:
        camera = cameras[photo.name]
        if not camera.lens.is_ideal:
            new = Path(photo.name).with_suffix(".png").name
            photo = dataclasses.replace(undistorted_photo(photo, camera), name=new)
        if photo.name in ideal:
            raise InputError(
                f"Two photos would become {photo.name}; rename one, so that they differ "
                "in more than their suffix."
            )
        ideal[photo.name] = camera.pinhole
        flat.append(photo)
    return ideal, flat


def _file_of(thing: Photo | Mesh | None) -> Path | None:
    """The file that a photo or a mesh was read from, if it is there."""
    if thing is None or thing.source is None or not thing.source.path.is_file():
        return None
    return thing.source.path


def _names_for_all(photos: Sequence[Photo]) -> dict[str, str]:
    """The name under which each photo is given: as JPEG where few programs read it."""
    rare = {s for f in PHOTO_FORMATS if not f.is_for_all for s in f.suffixes}
    taken = {photo.name.casefold() for photo in photos}
    names = {}
    for name in (photo.name for photo in photos):
        names[name] = name
        if Path(name).suffix.lower() in rare:
            new = Path(name).with_suffix(".jpg").name
            names[name] = f"{name}.jpg" if new.casefold() in taken else new
            taken.add(names[name].casefold())
    return names


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
            pixels = photo.pixels
            if photo.mask is not None and path.suffix == ".png":
                alpha = np.where(photo.mask, np.uint8(255), np.uint8(0))
                pixels = np.dstack([pixels, alpha])
            Image.fromarray(pixels).save(path, quality=97, subsampling=0)
    except ValueError as error:
        raise InputError(
            f"{photo.name} should end in .jpg, .png or .tif, so that it can be written."
        ) from error
    except OSError as error:
        raise OutputError(
            f"{photo.name} could not be copied: {error.strerror or error}."
        ) from error
    return path


def _mesh_copies(mesh: Mesh | None, folder: Path) -> list[Path]:
    """The mesh's file, first, and those that it names, as far as they are known."""
    source = _file_of(mesh)
    if source is None:
        return []
    if source.suffix.lower() == PACKED_SUFFIX:
        files = unzipped(source, folder, lambda _: True)
        return sorted(files, key=lambda path: path.suffix.lower() not in MESH_SUFFIXES)
    try:
        return [Path(shutil.copyfile(source, folder / source.name))]
    except OSError as error:
        raise OutputError(
            f"{source.name} could not be copied: {error.strerror or error}."
        ) from error
