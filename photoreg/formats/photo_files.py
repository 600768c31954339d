"""Photos as files beside cameras: their displayed size, and paths to them."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path

from PIL import ExifTags, Image

from photoreg.checks import check_input_file
from photoreg.errors import InputError
from photoreg.photo import PHOTO_SUFFIXES


def displayed_size(path: Path) -> tuple[int, int]:
    """Width and height of a photo as displayed, from its header alone.

    Raises:
        InputError: if it is not a readable JPEG, PNG or TIFF.
    """
    width, height, orientation = _header(path)
    return (height, width) if orientation >= 5 else (width, height)


def is_turned(path: Path) -> bool:
    """Whether EXIF asks to show the photo otherwise than its pixels are stored.

    Raises:
        InputError: if it is not a readable JPEG, PNG or TIFF.
    """
    return _header(path)[2] != 1


def _header(path: Path) -> tuple[int, int, int]:
    check_input_file(path, "photo")
    try:
        with warnings.catch_warnings():
            # Only the header is read: a huge photo is no danger here.
            warnings.simplefilter("ignore")
            with Image.open(path, formats=("JPEG", "PNG", "TIFF")) as image:
                orientation = image.getexif().get(ExifTags.Base.Orientation, 1)
                return (
                    image.width,
                    image.height,
                    orientation if orientation in range(1, 9) else 1,
                )
    except Exception as error:
        raise InputError(
            f"{path.name} could not be read as a JPEG, PNG or TIFF photo. "
            "Is it a picture, and complete?"
        ) from error


def photo_of_stem(
    stem: str, folder: Path, photos: Mapping[str, Path]
) -> tuple[str, Path] | None:
    """Name and path of the photo ``stem`` with any suffix, given or in ``folder``."""
    beside = sorted(folder.iterdir()) if folder.is_dir() else []
    for name, path in [*photos.items(), *((path.name, path) for path in beside)]:
        if Path(name).stem == stem and Path(name).suffix.lower() in PHOTO_SUFFIXES:
            return name, path
    return None


def path_from(folder: Path, path: Path) -> str:
    """``path`` as seen from ``folder``, with slashes; absolute on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.resolve().as_posix()
