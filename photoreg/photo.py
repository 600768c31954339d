"""A photograph: pixels as displayed, optional mask, and what EXIF knows of the lens."""

import dataclasses
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from PIL import ExifTags, Image, ImageOps

from photoreg.checks import check_input_file
from photoreg.errors import InputError
from photoreg.limits import Limits
from photoreg.sources import SourceFile, source_file

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
MIN_SIDE_PX = 16

STRIP_ROWS = 256
"""Rows that are converted at once."""


@dataclasses.dataclass(frozen=True, eq=False)
class Photo:
    """A photograph as displayed: EXIF orientation is already applied.

    Raises:
        InputError: at construction, if the pixels are not (h, w, 3) bytes, the
            photo is smaller than 16 px on a side, or the mask has another size.
    """

    name: str
    """File name; cameras are matched to photos by it."""
    pixels: UInt8[np.ndarray, "h w 3"]
    """sRGB, row 0 at the top."""
    mask: Bool[np.ndarray, "h w"] | None = None
    """True where the photo counts; None: everywhere."""
    exif_focal_px: float | None = None
    """Focal length in pixels by EXIF, a starting value; None if EXIF does not tell."""
    source: SourceFile | None = None
    """The file it was read from; None if it was made in memory."""

    def __post_init__(self) -> None:
        pixels = self.pixels
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
            raise InputError(
                f"{self.name}: pixels should be (height, width, 3) bytes, but are "
                f"{pixels.shape} {pixels.dtype}."
            )
        if min(pixels.shape[:2]) < MIN_SIDE_PX:
            raise InputError(
                f"{self.name} is {self.width}x{self.height} px; a photo should be at "
                f"least {MIN_SIDE_PX} px on each side."
            )
        if self.mask is not None and self.mask.shape != pixels.shape[:2]:
            raise InputError(
                f"{self.name}: the mask is {self.mask.shape[1]}x{self.mask.shape[0]} px, "
                f"but the photo is {self.width}x{self.height} px."
            )

    @property
    def width(self) -> int:
        """Width in pixels, as displayed."""
        return self.pixels.shape[1]

    @property
    def height(self) -> int:
        """Height in pixels, as displayed."""
        return self.pixels.shape[0]

    def resized(self, max_side_px: int) -> "Photo":
        """The photo reduced (area-averaged) so that no side exceeds ``max_side_px``."""
        scale = max_side_px / max(self.width, self.height)
        if scale >= 1.0:
            return self
        size = (max(1, round(self.width * scale)), max(1, round(self.height * scale)))
        mask = self.mask
        if mask is not None:
            mask = (
                cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
                > 0
            )
        return dataclasses.replace(
            self,
            pixels=cv2.resize(self.pixels, size, interpolation=cv2.INTER_AREA),
            mask=mask,
            exif_focal_px=None
            if self.exif_focal_px is None
            else self.exif_focal_px * size[0] / self.width,
            source=None,
        )


def load_photo(path: Path | str, limits: Limits | None = None) -> Photo:
    """Loads a JPEG, PNG or TIFF; applies EXIF orientation; alpha becomes the mask.

    Args:
        path: The file.
        limits: How large it may be; None: as the environment says.

    Raises:
        InputError: if the file is missing, empty, not a picture, truncated, too
            small (under 16 px a side) or too large (by default over 120 megapixels).
    """
    limits = limits or Limits.of_environment()
    path = check_input_file(Path(path), "photo", limits.file_mb)
    try:
        with warnings.catch_warnings():
            # Size is checked below, with our own limit and sentence.
            warnings.simplefilter("ignore")
            with Image.open(path, formats=("JPEG", "PNG", "TIFF")) as image:
                if image.width * image.height > limits.photo_pixels:
                    raise InputError(
                        f"{path.name} has {image.width}x{image.height} pixels; the limit "
                        f"is {limits.photo_megapixels:g} megapixels. Reduce it first."
                    )
                focal_px = _exif_focal_px(image)
                ImageOps.exif_transpose(image, in_place=True)
                return Photo(
                    path.name,
                    _srgb_bytes(image, path.name),
                    _alpha_mask(image),
                    focal_px,
                    source_file(path),
                )
    except (InputError, MemoryError):
        raise
    except Image.DecompressionBombError as error:
        raise InputError(
            f"{path.name} has too many pixels; the limit is "
            f"{limits.photo_megapixels:g} megapixels. Reduce it first."
        ) from error
    except Exception as error:
        raise InputError(
            f"{path.name} could not be read as a JPEG, PNG or TIFF photo. "
            "Is it a picture, and complete?"
        ) from error


def _srgb_bytes(image: Image.Image, name: str) -> np.ndarray:
    pixels = np.zeros((image.height, image.width, 3), dtype=np.uint8)
    if not (image.mode.startswith("I") or image.mode == "F"):
        for rows, strip in _strips(image):
            pixels[rows] = np.asarray(strip.convert("RGB"))
        return pixels
    # Pillow's own conversion would clip, not scale.
    ranges = [_range(np.asarray(strip)) for _, strip in _strips(image)]
    lowest, highest = np.min(ranges), np.max(ranges)
    if not np.isfinite([lowest, highest]).all():
        raise InputError(
            f"{name} has pixels that are not finite numbers. Save it with whole "
            "numbers, of 8 or 16 bits."
        )
    if image.mode == "F" and highest <= 1.0:
        top = 1.0
    else:
        is_deep = image.mode.startswith("I;16") or highest > 255.0
        top = 65535.0 if is_deep else 255.0
    for rows, strip in _strips(image):
        grey = np.asarray(strip, dtype=np.float32)
        pixels[rows] = np.clip(np.rint(grey / top * 255.0), 0, 255)[:, :, None]
    return pixels


def _range(grey: np.ndarray) -> tuple[float, float]:
    return float(grey.min()), float(grey.max())


def _alpha_mask(image: Image.Image) -> np.ndarray | None:
    if "A" not in image.getbands() and "transparency" not in image.info:
        return None
    mask = np.zeros((image.height, image.width), dtype=bool)
    for rows, strip in _strips(image):
        mask[rows] = np.asarray(strip.convert("RGBA"))[:, :, 3] >= 128
    return None if mask.all() else mask


def _strips(image: Image.Image) -> Iterator[tuple[slice, Image.Image]]:
    """The picture in pieces from its top: whole, each conversion is one more copy."""
    for top in range(0, image.height, STRIP_ROWS):
        bottom = min(top + STRIP_ROWS, image.height)
        yield slice(top, bottom), image.crop((0, top, image.width, bottom))


def _exif_focal_px(image: Image.Image) -> float | None:
    """Focal length in pixels from the 35 mm equivalent (diagonal 43.27 mm)."""
    try:
        lens = image.getexif().get_ifd(ExifTags.IFD.Exif)
        focal_35mm = float(lens.get(ExifTags.Base.FocalLengthIn35mmFilm, 0) or 0)
    except Exception:  # noqa: BLE001 - broken EXIF is common, and only a hint.
        return None
    if not 5.0 <= focal_35mm <= 2000.0:
        return None
    return focal_35mm / float(np.hypot(36.0, 24.0)) * float(np.hypot(*image.size))
