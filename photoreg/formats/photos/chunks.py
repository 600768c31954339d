"""What stands in the headers of photo files that their decoders do not hand on.

PNG chunks, the colour boxes of HEIF and AVIF, the size and turn of JPEG XL.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from photoreg.sources import open_for_reading

MAX_CHUNK_BYTES = 4096
"""Longer PNG chunks are passed over."""

PNG_END = b"\0\0\0\0IEND\xaeB\x60\x82"

MAX_BOX_BYTES = 16 << 20
"""Longer metadata boxes are not looked into."""


def png_chunks(path: Path) -> dict[bytes, bytes]:
    """The short chunks of a PNG that come before its pixels, by type."""
    chunks: dict[bytes, bytes] = {}
    with open_for_reading(path) as file:
        file.seek(8)
        while len(head := file.read(8)) == 8 and head[4:] != b"IDAT":
            length = int.from_bytes(head[:4], "big")
            if length <= MAX_CHUNK_BYTES:
                chunks[head[4:]] = file.read(length)
                file.seek(4, 1)
            else:
                file.seek(length + 4, 1)
    return chunks


def png_pixels_alone(content: bytes) -> bytes:
    """A PNG of only the header and the pixels of another one.

    Raises:
        ValueError: if a chunk is longer than the rest of the file.
    """
    kept, at = [content[:8]], 8
    while content[at + 4 : at + 8] != b"IEND":
        end = at + 12 + int.from_bytes(content[at : at + 4], "big")
        if end > len(content):
            raise ValueError("a chunk of the PNG is longer than the file")
        if content[at + 4 : at + 8] in (b"IHDR", b"IDAT"):
            kept.append(content[at:end])
        at = end
    return b"".join([*kept, PNG_END])


def heif_colours(path: Path) -> list[tuple[int, int]]:
    """Primaries and transfer (ITU-T H.273) of each nclx colour box in HEIF or AVIF."""
    with open_for_reading(path) as file:
        meta = next((body for kind, body in _boxes(file) if kind == b"meta"), b"")
    properties = _inside(_inside(meta[4:], b"iprp"), b"ipco")
    return [
        struct.unpack(">HH", body[4:8])
        for kind, body in _boxes_of(properties)
        if kind == b"colr" and body[:4] == b"nclx" and len(body) >= 8
    ]


def _boxes(file: IO[bytes]) -> Iterator[tuple[bytes, bytes]]:
    """The boxes of a file of ISO's base media format; long ones without content."""
    while len(head := file.read(8)) == 8:
        size, n_head = int.from_bytes(head[:4], "big"), 8
        if size == 1:
            size, n_head = int.from_bytes(file.read(8), "big"), 16
        rest = size - n_head
        if rest < 0:
            return  # Size 0: up to the end, which is pixels.
        if rest <= MAX_BOX_BYTES:
            yield head[4:], file.read(rest)
        else:
            yield head[4:], b""
            file.seek(rest, 1)


def _boxes_of(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(content):
        size = int.from_bytes(content[at : at + 4], "big")
        if size < 8:
            return
        yield content[at + 4 : at + 8], content[at + 8 : at + size]
        at += size


def _inside(content: bytes, kind: bytes) -> bytes:
    return next((body for found, body in _boxes_of(content) if found == kind), b"")


def jxl_header(path: Path) -> tuple[int, int, int] | None:
    """Width and height as stored, and orientation (as EXIF's), of a JPEG XL.

    None if the file is not one as far as it tells.

    References:
        ISO/IEC 18181-1, SizeHeader and ImageMetadata.
    """
    with open_for_reading(path) as file:
        start = file.read(256)
        if start.startswith(b"\0\0\0\x0cJXL "):
            file.seek(0)
            start = b""
            for kind, body in _boxes(file):
                if kind in (b"jxlc", b"jxlp"):
                    start = body[4 if kind == b"jxlp" else 0 :][:256]
                    break
                if not body and kind not in (b"jxlc", b"jxlp"):
                    continue
    if not start.startswith(b"\xff\x0a"):
        return None
    return _jxl_size(_Bits(start[2:]))


class _Bits:
    """Bits from the lowest of each byte on."""

    def __init__(self, content: bytes) -> None:
        self._left = int.from_bytes(content, "little")

    def take(self, count: int) -> int:
        value = self._left & ((1 << count) - 1)
        self._left >>= count
        return value


def _jxl_size(bits: _Bits) -> tuple[int, int, int]:
    lengths = (9, 13, 18, 30)
    is_small = bits.take(1)

    def side() -> int:
        return (
            8 * (bits.take(5) + 1) if is_small else bits.take(lengths[bits.take(2)]) + 1
        )

    height = side()
    ratio = bits.take(3)
    ratios = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))
    if ratio:
        numerator, denominator = ratios[ratio - 1]
        width = height * numerator // denominator
    else:
        width = side()
    all_default = bits.take(1)
    has_extra_fields = 0 if all_default else bits.take(1)
    return width, height, bits.take(3) + 1 if has_extra_fields else 1
