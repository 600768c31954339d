"""Every photo format that is read: its name, its suffixes, and how its files begin.

What a file is, its first bytes tell: an iPhone's HEIC is often called ``.jpg``. The
suffixes are for choosing files. The page, the command line, messages and the README's
list all come from here.
"""

import dataclasses
from pathlib import Path

from photoreg.sources import open_for_reading

HEAD_BYTES = 64


@dataclasses.dataclass(frozen=True)
class PhotoFormat:
    """A format of photo files."""

    name: str
    """What people call it."""
    suffixes: tuple[str, ...]
    """In small letters, the usual one first."""
    pillow_names: tuple[str, ...] = ()
    """What Pillow calls it and what it is then read by; empty: LibRaw reads it."""
    is_for_all: bool = True
    """Whether most programs that photos are handed on to read it."""
    orientation_is_exif: bool = True
    """Whether EXIF alone turns the photo, so that programs differ in heeding it; in the
    others turning is a part of the format, which all decoders do."""

    @property
    def is_raw(self) -> bool:
        """Whether it holds what the sensor saw, to be developed."""
        return not self.pillow_names


JPEG = PhotoFormat("JPEG", (".jpg", ".jpeg"), ("JPEG", "MPO"))
PNG = PhotoFormat("PNG", (".png",), ("PNG",))
TIFF = PhotoFormat("TIFF", (".tif", ".tiff"), ("TIFF",))
WEBP = PhotoFormat("WebP", (".webp",), ("WEBP",), is_for_all=False)
HEIF = PhotoFormat(
    "HEIC", (".heic", ".heif", ".hif"), ("HEIF",), False, orientation_is_exif=False
)
AVIF = PhotoFormat("AVIF", (".avif",), ("AVIF",), False, orientation_is_exif=False)
JXL = PhotoFormat("JPEG XL", (".jxl",), ("JXL",), False, orientation_is_exif=False)
RAW = PhotoFormat(
    "RAW",
    (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf"),
    (),
    False,
    orientation_is_exif=False,
)

PHOTO_FORMATS = (JPEG, PNG, TIFF, WEBP, HEIF, AVIF, JXL, RAW)
PHOTO_SUFFIXES = tuple(suffix for known in PHOTO_FORMATS for suffix in known.suffixes)

OTHERS = {
    b"GIF8": "a GIF",
    b"BM": "a BMP",
    b"8BPS": "a Photoshop file",
    b"%PDF": "a PDF",
    b"v/1\x01": "an OpenEXR file",
    b"#?RADIANCE": "a Radiance HDR file",
    b"\0\0\0\x0cjP  ": "a JPEG 2000",
    b"\xff\x4f\xff\x51": "a JPEG 2000",
    b"IIU\0": "a Panasonic RAW (RW2)",
    b"IIRO": "an Olympus RAW (ORF)",
    b"IIRS": "an Olympus RAW (ORF)",
    b"FOVb": "a Sigma RAW (X3F)",
    b"<svg": "an SVG",
}
"""Beginnings of pictures that are not read."""

_HEVC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
_AVIF_BRANDS = {b"avif", b"avis"}


def formats_in_words() -> str:
    """The formats that are read: "JPEG, PNG, ..., RAW (DNG, CR2, ...)"."""
    words = []
    for known in PHOTO_FORMATS:
        kinds = ", ".join(suffix[1:].upper() for suffix in known.suffixes)
        words.append(f"{known.name} ({kinds})" if known.is_raw else known.name)
    return ", ".join(words[:-1]) + f" and {words[-1]}"


def is_photo(path: Path) -> bool:
    """Whether a file is a photo by its suffix."""
    return path.suffix.lower() in PHOTO_SUFFIXES


def format_of(path: Path) -> PhotoFormat | None:
    """The format of an existing file by its first bytes; None if it is none of ours.

    RAW files that are TIFFs by their beginning (DNG, NEF, ARW) are told apart by their
    suffix.
    """
    head = head_of(path)
    if head.startswith(b"\xff\xd8\xff"):
        return JPEG
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return PNG
    if head.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
        is_raw = head[8:10] == b"CR" or path.suffix.lower() in RAW.suffixes
        return RAW if is_raw else TIFF
    if head.startswith(b"RIFF") and head[8:12] == b"WEBP":
        return WEBP
    if head.startswith(b"FUJIFILMCCD-RAW"):
        return RAW
    if head.startswith((b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n")):
        return JXL
    if head[4:8] == b"ftyp":
        length = min(max(int.from_bytes(head[:4], "big"), 16), HEAD_BYTES)
        brands = {head[8:12], *(head[i : i + 4] for i in range(16, length, 4))}
        if b"crx " in brands:
            return RAW
        if brands & _AVIF_BRANDS:
            return AVIF
        if brands & _HEVC_BRANDS:
            return HEIF
    return None


def head_of(path: Path) -> bytes:
    """The first bytes of a file."""
    with open_for_reading(path) as file:
        return file.read(HEAD_BYTES)


def unread_kind(path: Path) -> str:
    """What a file in none of our formats is, if known: "a GIF"; or nothing."""
    head = head_of(path)
    return next((w for start, w in OTHERS.items() if head.startswith(start)), "")
