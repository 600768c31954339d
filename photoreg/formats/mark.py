"""The mark by which photoreg knows its own files: it may write over those unasked."""

import json
import re
import struct
import zlib
from pathlib import Path

from photoreg.sources import open_for_reading

GENERATOR = "photoreg"
COMMENT = "made by photoreg"
USDZ_LAYER = "photoreg.usdc"
"""Name of the first file in a USDZ."""

_HEAD_BYTES = 4096
_MAX_GLTF_BYTES = 1 << 24
_LINE = re.compile(rb"(#|comment|<!--) made by photoreg( -->)?|[\w,]+,made by photoreg")
_JSON = re.compile(rb'\s*\{\s*"(format"\s*:\s*"photoreg-|generator"\s*:\s*"photoreg")')
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER_END = 33
"""Bytes of the signature and of the header chunk, which comes first in every PNG."""
_JPEG_START = b"\xff\xd8"
_ZIP_START, _ZIP_NAME_AT = b"PK\3\4", 30


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


_PNG_MARK = _png_chunk(b"tEXt", b"Software\0" + GENERATOR.encode())
_JPEG_MARK = b"\xff\xfe" + struct.pack(">H", len(COMMENT) + 2) + COMMENT.encode()


def marked_picture(encoded: bytes) -> bytes:
    """A PNG with photoreg as its software, or a JPEG with a comment; pixels stay.

    Anything else is returned as it is.
    """
    if encoded.startswith(_PNG_SIGNATURE):
        at, mark = _PNG_HEADER_END, _PNG_MARK
    elif encoded.startswith(_JPEG_START):
        at, mark = len(_JPEG_START), _JPEG_MARK
    else:
        return encoded
    return encoded[:at] + mark + encoded[at:]


def is_marked(path: Path) -> bool:
    """Whether a file says that photoreg made it.

    It does so at its beginning, as its format permits: by its "format" or "generator"
    in JSON and glTF, as a comment line, as a table's last column, by a PNG's software, by
    a JPEG's comment, by the name of a USDZ's first file.

    Raises:
        OSError: if it cannot be read.
    """
    with open_for_reading(path) as file:
        head = file.read(_HEAD_BYTES)
        if head.startswith(b"glTF"):
            file.seek(0)
            return _is_marked_gltf(file.read(_MAX_GLTF_BYTES))
    if head.startswith(_PNG_SIGNATURE):
        return head.startswith(_PNG_MARK, _PNG_HEADER_END)
    if head.startswith(_JPEG_START):
        return head.startswith(_JPEG_MARK, len(_JPEG_START))
    if head.startswith(_ZIP_START):
        return head.startswith(USDZ_LAYER.encode(), _ZIP_NAME_AT)
    lines = head.splitlines()[:5]
    return _JSON.match(head) is not None or any(map(_LINE.fullmatch, lines))


def _is_marked_gltf(content: bytes) -> bool:
    try:
        (length,) = struct.unpack_from("<I", content, 12)
        document = json.loads(content[20 : 20 + length])
        return document["asset"]["generator"] == GENERATOR
    except (struct.error, ValueError, TypeError, KeyError, RecursionError):
        return False
