"""The scene that a command is given: mesh, photos and cameras, and the notes about them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from photoreg.cli.console import print_notes
from photoreg.formats.cameras.cameras_json import CameraFile
from photoreg.formats.meshes.read import load_mesh
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.registration.scene_files import load_scene

MeshPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]

PhotoPaths = Annotated[
    tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PHOTO")
]


def surface_told(path: Path) -> Mesh:
    """The mesh of a file; prints a note for each thing that was left out."""
    surface = load_mesh(path)
    print_notes(f"{surface.name}: {note}" for note in surface.notes)
    return surface


def load_told(
    mesh: Path, photos: Sequence[Path], cameras: Path
) -> tuple[Mesh, list[Photo], CameraFile, list[Camera]]:
    """Mesh, photos, the file of cameras and one camera a photo; prints what is noted."""
    scene = load_scene(mesh, photos, cameras)
    print_notes(scene.notes)
    return scene.mesh, list(scene.photos), scene.file, list(scene.cameras)
