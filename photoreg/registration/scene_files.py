"""Mesh, photos and rough cameras from their files, as a refinement starts from them."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from photoreg.checks import inputs_read, note_input, noting_inputs
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import CameraFile
from photoreg.formats.cameras.registry import photos_by_name, read_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.registration.world import in_world_of_mesh


@dataclasses.dataclass(frozen=True, eq=False)
class LoadedScene:
    """What a refinement starts from."""

    mesh: Mesh
    photos: tuple[Photo, ...]
    file: CameraFile
    """The cameras as they were read, in the world of the mesh."""
    cameras: tuple[Camera, ...]
    """One a photo."""

    @property
    def notes(self) -> list[str]:
        """A sentence for each thing that was left out or had to be assumed."""
        return [
            *(f"{self.mesh.name}: {note}" for note in self.mesh.notes),
            *self.file.notes,
        ]


def cropped_by_exif(photos: Sequence[Photo], named: Sequence[str]) -> list[str]:
    """Names of photos that EXIF shows to be cropped and that nobody named."""
    return [p.name for p in photos if p.is_cropped and p.name not in named]


def load_scene(
    mesh: Path, photos: Sequence[Path], cameras: Path, *, has_textures: bool = False
) -> LoadedScene:
    """Reads a scene.

    Args:
        mesh: The mesh's file.
        photos: The photos' files.
        cameras: The cameras, in any format that is read.
        has_textures: Whether the mesh's own texture may be among the photos: it has no
            camera and is left out.

    Raises:
        InputError: if there is no photo, or a file cannot be used; one sentence says why.
    """
    if not photos:
        raise InputError("Give at least 1 photo, not 0.")
    by_name = photos_by_name(photos)
    with noting_inputs():
        surface = load_mesh(mesh)
        read_by_mesh = inputs_read()
    for path in read_by_mesh:
        note_input(path)
    file = read_cameras(cameras, photos=by_name)
    if has_textures:
        read = {path.resolve() for path in read_by_mesh}
        photos = [
            path
            for name, path in by_name.items()
            if file.of_photo(name) is not None or path.resolve() not in read
        ]
    pictures = tuple(load_photo(path) for path in photos)
    file = in_world_of_mesh(surface, pictures, file)
    return LoadedScene(surface, pictures, file, tuple(file.of_photos(pictures)))
