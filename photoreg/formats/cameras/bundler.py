"""Bundler's bundle.out and its list of photos.

World to camera in OpenGL's axes (y up, looking along -z), one focal length, two radial
terms (k1 and k2), and the middle of the photo as principal point. The file holds neither
the photos' names, which are in a list beside it, nor their sizes, which come from the photos.

References:
    https://www.cs.cornell.edu/~snavely/bundler/bundler-v0.4-manual.html
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import (
    OPENGL_AXES,
    CameraSet,
    Saved,
    cameras_by_name,
    intrinsics,
    photo_name,
    without,
)
from photoreg.formats.parsing import (
    camera_of,
    lens_of,
    numbers,
    read_text,
    whole,
)
from photoreg.formats.photos.files import path_from, stored_size
from photoreg.formats.writing import write_files
from photoreg.geometry.camera import Camera

NUMBERS_A_CAMERA = 15


def list_path(path: Path) -> Path:
    """Where the list of photos of a bundle file is written."""
    return path.with_name(f"{path.stem}.list.txt")


def save_bundler(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    """Writes the bundle file, without points, and the list of photos.

    Neither has a place for a mark.

    Raises:
        OutputError: if they cannot be written there.
    """
    lines, names, losses = [], [], []
    for name, camera in cameras.cameras.items():
        camera, lost = without(
            name,
            camera,
            "Bundler",
            "skew",
            "aspect",
            "principal point",
            lens_terms=("k1", "k2"),
        )
        losses += lost
        rows = [
            [camera.K[0, 0], camera.lens.k1, camera.lens.k2],
            *(OPENGL_AXES @ camera.R_cam_world),
            OPENGL_AXES @ camera.t_cam_world,
        ]
        lines += [" ".join(repr(float(v)) for v in row) + "\n" for row in rows]
        photo = cameras.photos.get(name)
        names.append((path_from(path.parent, photo) if photo else name) + "\n")
    head = f"# Bundle file v0.3\n{len(cameras.cameras)} 0\n"
    contents = {path: head + "".join(lines), list_path(path): "".join(names)}
    return Saved(write_files(contents, cameras.files, overwrite), losses)


def load_bundler(path: Path, photos: dict[str, Path]) -> dict[str, Camera]:
    """Reads a bundle file with its list: <name>.list.txt or list.txt, also one up.

    Cameras that Bundler did not register (focal length 0) are left out.

    Raises:
        InputError: if a file is missing or not as it should be, or a photo is not
            found.
    """
    lines = read_text(path, "bundle file").splitlines()
    if not lines or not lines[0].startswith("# Bundle file"):
        raise InputError(f'{path.name} should begin with "# Bundle file v0.3".')
    words = _words(lines[1:])
    head = [next(words, ""), next(words, "")]
    n_cameras = whole(head[0], path.name, "the number of cameras")
    names = _photo_list(path)
    if n_cameras != len(names):
        raise InputError(
            f"{path.name} has {n_cameras} cameras, but its list of photos names "
            f"{len(names)}."
        )
    return cameras_by_name(_cameras(path, names, words, photos), path.name)


def _words(lines: list[str]) -> Iterator[str]:
    for line in lines:
        yield from line.split()


def _photo_list(path: Path) -> list[str]:
    places = [
        list_path(path),
        path.with_name("list.txt"),
        path.parent.parent / "list.txt",
    ]
    for place in places:
        if place.is_file():
            lines = read_text(place, "list of photos").splitlines()
            # Bundler's own lists have the photo's focal length after its name.
            return [
                re.sub(r"\s+0(\s+\S+)?$", "", line.strip())
                for line in lines
                if line.strip()
            ]
    raise InputError(
        f"{path.name} does not name its photos; the list of them, {places[0].name} or "
        "list.txt, is not beside it."
    )


def _cameras(
    path: Path, names: list[str], words: Iterator[str], photos: dict[str, Path]
) -> Iterator[tuple[str, Camera]]:
    for number, listed in enumerate(names, start=1):
        name = photo_name(listed)
        where = f"{path.name}, camera {number} ({name})"
        entry = [word for _, word in zip(range(NUMBERS_A_CAMERA), words, strict=False)]
        values = numbers(entry, NUMBERS_A_CAMERA, where, "its entry")
        focal = values[0]
        if focal == 0.0:
            continue
        photo = photos.get(name, path.parent / listed)
        if not photo.is_file():
            raise InputError(
                f"{where}: the photo is not beside the file; its size is needed. Give "
                "the photos too."
            )
        photos[name] = photo
        width, height = stored_size(photo)
        R = OPENGL_AXES @ np.reshape(values[3:12], (3, 3))
        t = OPENGL_AXES @ np.array(values[12:])
        K = intrinsics(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
        lens = lens_of(where, *values[1:3])
        yield name, camera_of(where, K, R, t, width, height, lens)
