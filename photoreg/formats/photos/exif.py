"""What EXIF and XMP say about a photo: its turn, its lens, whether it was cropped.

EXIF is often wrong, so nothing of it is an error: what cannot be is passed over, and
what can be doubted is said with the value.
"""

import dataclasses
import re
from collections.abc import Callable

import numpy as np
from PIL import ExifTags, Image

from photoreg.formats.photos.lens_database import known_lens
from photoreg.imaging.photo import KnownLens

FILM_DIAGONAL_MM = float(np.hypot(36.0, 24.0))
SHORTEST_MM, LONGEST_MM = 8.0, 2000.0
"""Of 35 mm equivalents that can be: shorter lenses are fisheyes or mistakes."""

MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""EXIF's units of the sensor's resolution, in millimetres."""

SAME_SHAPE = 0.01
"""Relative difference of width / height that resizing to whole pixels makes."""

APPLE_PANORAMA = 6
"""Of EXIF's CustomRendered."""


@dataclasses.dataclass(frozen=True)
class Focal:
    """A focal length by EXIF."""

    px: float
    """In pixels of the file."""
    note: str
    """Where it is from and how sure it is, for people."""


@dataclasses.dataclass(frozen=True)
class PhotoFacts:
    """What a photo's metadata says."""

    orientation: int = 1
    """EXIF's, 1 to 8."""
    focal: Focal | None = None
    is_cropped: bool = False
    """Whether a part was cut off after it was taken, as far as EXIF tells."""
    lens: KnownLens | None = None
    """The lens that took it, where EXIF names one that lensfun knows."""
    projection: str = ""
    """What it is if it is no picture in perspective: "a panorama (...)"; or nothing."""
    is_adobe_rgb: bool = False
    """Whether the camera says, without a profile, that the colours are Adobe RGB."""


def facts_of(
    exif: Image.Exif, xmp: bytes, width: int, height: int, is_raw: bool = False
) -> PhotoFacts:
    """What the metadata of a photo says.

    Args:
        exif: Its EXIF; empty if there is none.
        xmp: Its XMP, likewise.
        width: Of the pixels as stored.
        height: Of the pixels as stored.
        is_raw: Whether it is developed from RAW: a border that cameras cut off is left,
            and neither resized nor cropped.
    """
    orientation = _tag(exif.get, ExifTags.Base.Orientation)
    try:
        details = exif.get_ifd(ExifTags.IFD.Exif)
        get, interop = details.get, None
        # Older Pillow looks for what is not there.
        if ExifTags.IFD.Interop in details:
            interop = exif.get_ifd(ExifTags.IFD.Interop).get(1)
    except Exception:  # noqa: BLE001 - broken EXIF is common, and only a hint.
        get, interop = {}.get, None
    crop = _crop(get, width, height, is_raw)
    focal = _focal(get, crop)
    return PhotoFacts(
        orientation=int(orientation)
        if orientation and orientation in range(1, 9)
        else 1,
        focal=focal,
        is_cropped=crop is None or crop.is_cropped,
        lens=_lens(exif, get, focal, crop),
        projection=_projection(get, xmp),
        is_adobe_rgb=str(interop).strip("\0 ") == "R03",
    )


def is_turned_by(orientation: int) -> bool:
    """Whether an EXIF orientation swaps width and height."""
    return orientation >= 5


def _tag(get: Callable, tag: int) -> float | None:
    """A number of EXIF, if it is one that is finite and positive."""
    try:
        value = float(get(tag))
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return value if np.isfinite(value) and value > 0.0 else None


@dataclasses.dataclass(frozen=True)
class _Crop:
    """How the file's pixels follow from those that were taken."""

    width: float
    """Of the photo as taken, in pixels of the file."""
    height: float
    is_cropped: bool
    is_resized: bool
    scale: float
    """Pixels of the file per pixel of the photo as taken."""


def _crop(get: Callable, width: int, height: int, is_raw: bool) -> _Crop | None:
    """How the photo was cropped since it was taken; None if that cannot be determined."""
    taken = [
        _tag(get, tag)
        for tag in (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)
    ]
    if None in taken or min(taken) < 16:  # pyright: ignore[reportArgumentType]
        return _Crop(width, height, False, False, 1.0)
    taken_w, taken_h = (float(side or 0.0) for side in taken)
    if (taken_w > taken_h) != (width > height):
        # Programs that turn the pixels leave these as they were.
        taken_w, taken_h = taken_h, taken_w
    if is_raw:
        is_border = abs(width / taken_w - 1.0) < 0.05 > abs(height / taken_h - 1.0)
        size = (taken_w, taken_h) if is_border else (width, height)
        return _Crop(*size, False, False, 1.0)
    if abs(width * taken_h / (height * taken_w) - 1.0) <= SAME_SHAPE:
        return _Crop(width, height, False, width != taken_w, width / taken_w)
    if width <= taken_w and height <= taken_h:
        return _Crop(taken_w, taken_h, True, False, 1.0)
    return None


def _focal(get: Callable, crop: _Crop | None) -> Focal | None:
    if crop is None:
        return None  # Cut and enlarged: nothing ties its pixels to the lens.
    diagonal_px = float(np.hypot(crop.width, crop.height))
    by_film = _tag(get, ExifTags.Base.FocalLengthIn35mmFilm)
    if by_film is not None and not SHORTEST_MM <= by_film <= LONGEST_MM:
        by_film = None
    focal_mm = _tag(get, ExifTags.Base.FocalLength)
    by_sensor = _by_sensor(get, focal_mm, diagonal_px, crop)
    zoom = _tag(get, ExifTags.Base.DigitalZoomRatio) or 1.0
    zoom = zoom if 1.0 < zoom <= 100.0 else 1.0
    notes = []
    if by_film is not None and by_sensor is not None and by_film == focal_mm:
        # The lens's own focal length written as its equivalent: a crop sensor's tells.
        ratio = by_sensor / by_film
        by_film = None if not 0.8 < ratio < 1.25 else by_film
    if by_film is not None:
        equivalent, where, sure = by_film, "35 mm equivalent", "± 5 %"
        if by_sensor is not None:
            ratio = by_sensor / by_film
            known_ratios = (1.0, 1.0 / zoom, zoom)
            if not any(0.8 < ratio / known < 1.25 for known in known_ratios):
                sure = f"unsure: the sensor's resolution says {by_sensor:.0f} mm"
    elif by_sensor is not None:
        equivalent, where, sure = by_sensor * zoom, "sensor resolution", "± 5 %"
    else:
        return None
    if zoom > 1.0:
        sure = f"unsure: digital zoom {zoom:.3g}×"
    if crop.is_resized:
        notes.append("resized")
    if crop.is_cropped:
        notes.append("cropped")
    words = ", ".join([where, *notes, sure])
    return Focal(equivalent / FILM_DIAGONAL_MM * diagonal_px, f"by EXIF ({words})")


def _lens(
    exif: Image.Exif, get: Callable, focal: Focal | None, crop: _Crop | None
) -> KnownLens | None:
    """The lens, where the photo is whole and EXIF tells enough to look it up."""
    focal_mm = _tag(get, ExifTags.Base.FocalLength)
    if focal is None or focal_mm is None or crop is None or crop.is_cropped:
        return None
    make, model, lens_model = (
        str(value or "").encode("ascii", "ignore").decode().strip("\0 ")
        for value in (
            exif.get(ExifTags.Base.Make),
            exif.get(ExifTags.Base.Model),
            get(ExifTags.Base.LensModel),
        )
    )
    size = crop.width, crop.height
    return known_lens(make, model, lens_model, focal_mm, focal.px, size)


def _by_sensor(
    get: Callable, focal_mm: float | None, diagonal_px: float, crop: _Crop
) -> float | None:
    """The 35 mm equivalent by focal length and sensor resolution, if these can be."""
    per_unit = _tag(get, ExifTags.Base.FocalPlaneXResolution)
    unit_mm = MM_PER_UNIT.get(
        int(_tag(get, ExifTags.Base.FocalPlaneResolutionUnit) or 2)
    )
    if focal_mm is None or per_unit is None or unit_mm is None:
        return None
    focal_px = focal_mm / unit_mm * per_unit * crop.scale
    equivalent = focal_px / diagonal_px * FILM_DIAGONAL_MM
    # Wrong units make sensors the size of a pinhead or of a wall.
    sensor_mm = diagonal_px / (per_unit * crop.scale) * unit_mm
    can_be = SHORTEST_MM <= equivalent <= LONGEST_MM and 3.0 <= sensor_mm <= 80.0
    return equivalent if can_be else None


_PANORAMA = re.compile(
    rb"ProjectionType\s*(?:=\s*[\"']|>)\s*([A-Za-z]+)|FullPanoWidthPixels"
)
_FISHEYE = re.compile(rb"ModelType\s*(?:=\s*[\"']|>)\s*fisheye", re.IGNORECASE)


def _projection(get: Callable, xmp: bytes) -> str:
    match = _PANORAMA.search(xmp)
    if match:
        kind = (match[1] or b"GPano").decode().lower()
        if kind not in ("perspective", "rectilinear"):
            return (
                f"a fisheye ({kind})" if kind == "fisheye" else f"a panorama ({kind})"
            )
    if _tag(get, ExifTags.Base.CustomRendered) == APPLE_PANORAMA:
        return "a panorama"
    lens = str(get(ExifTags.Base.LensModel) or "")
    if _FISHEYE.search(xmp) or re.search(r"fish[\s-]?eye", lens, re.IGNORECASE):
        return f"a fisheye{f' ({lens[:40].strip(chr(0))})' if lens else ''}"
    return ""
