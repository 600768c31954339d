"""Photos as files beside cameras: their displayed size, and paths to them."""

import os
from collections.abc import Mapping
from pathlib import Path

from photoreg.checks import check_input_file
from photoreg.errors import InputError
from photoreg.formats.photos.decoding import PhotoHeader, read_header
from photoreg.formats.photos.registry import is_photo
from photoreg.words import nfc


def displayed_size(path: Path) -> tuple[int, int]:
    """Width and height of a photo as displayed, from its header alone.

    Raises:
        InputError: if it is not a photo that can be read.
    """
    return photo_header(path).displayed_size


def stored_size(path: Path) -> tuple[int, int]:
    """Width and height of a photo as stored, whatever EXIF says, from its header alone.

    Raises:
        InputError: if it is not a photo that can be read.
    """
    header = photo_header(path)
    return header.width, header.height


def is_turned(path: Path) -> bool:
    """Whether EXIF asks for the photo to be shown turned from how it is stored.

    Raises:
        InputError: if it is not a photo that can be read.
    """
    return photo_header(path).orientation != 1


def photo_header(path: Path) -> PhotoHeader:
    """Size and turn of a photo, from its header alone.

    Raises:
        InputError: if it is not a photo that can be read.
    """
    return read_header(check_input_file(path, "photo"))


def photo_of_stem(
    stem: str, folder: Path, photos: Mapping[str, Path]
) -> tuple[str, Path] | None:
    """Name and path of the photo ``stem`` with any suffix, given or in ``folder``."""
    beside = sorted(folder.iterdir()) if folder.is_dir() else []
    for name, path in [*photos.items(), *((path.name, path) for path in beside)]:
        if nfc(Path(name).stem) == nfc(stem) and is_photo(Path(name)):
            return nfc(name), path
    return None


def photo_beside(path: Path, photos: Mapping[str, Path]) -> tuple[str, Path]:
    """Name and path of the photo with the stem of a camera file, given or beside it.

    Raises:
        InputError: if there is none.
    """
    found = photo_of_stem(path.stem, path.parent, photos)
    if found is None:
        raise InputError(
            f"{path.name}: its photo {path.stem}.* is not beside it; its size is needed. "
            "Give the photos too."
        )
    return found


def path_from(folder: Path, path: Path) -> str:
    """``path`` as seen from ``folder``, with slashes; absolute on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.resolve().as_posix()
