"""Photo files of the tests: profiles, a linear DNG and PNG chunks, written byte by byte.

Nothing here uses photoreg, so that the tests do not check it against itself.
"""

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import ExifTags, Image

D65 = (0.3127, 0.3290)
D50 = (0.3457, 0.3585)
SRGB = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), D65)
DISPLAY_P3 = ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), D65)
ADOBE_RGB = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06), D65)
PROPHOTO = ((0.7347, 0.2653), (0.1596, 0.8404), (0.0366, 0.0001), D50)
REC2020 = ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65)

Primaries = tuple[tuple[float, float], ...]


def details_of(exif: Image.Exif) -> dict[int, Any]:
    """The camera's own part of EXIF, to be filled; older Pillow keeps what it has read only."""
    return exif._ifds.setdefault(ExifTags.IFD.Exif, {})


def xyz_of_xy(xy: tuple[float, float]) -> np.ndarray:
    x, y = xy
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


def rgb_to_xyz(primaries: Primaries) -> np.ndarray:
    """Linear RGB to XYZ under the primaries' own white."""
    *rgb, white = (xyz_of_xy(xy) for xy in primaries)
    columns = np.stack(rgb, axis=1)
    return columns * np.linalg.solve(columns, white)


def bradford(source: tuple[float, float], target: tuple[float, float]) -> np.ndarray:
    cone = np.array(
        [
            [0.8951, 0.2664, -0.1614],
            [-0.7502, 1.7135, 0.0367],
            [0.0389, -0.0685, 1.0296],
        ]
    )
    ratio = (cone @ xyz_of_xy(target)) / (cone @ xyz_of_xy(source))
    return np.linalg.inv(cone) @ np.diag(ratio) @ cone


def srgb_to_light(values: np.ndarray) -> np.ndarray:
    return np.where(
        values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4
    )


def light_to_srgb(light: np.ndarray) -> np.ndarray:
    light = np.clip(light, 0.0, None)
    return np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055
    )


def coded(srgb: np.ndarray, primaries: Primaries, gamma: float | None) -> np.ndarray:
    """sRGB values (..., 3), 0 to 1, in another space; gamma None is sRGB's curve."""
    white = primaries[3]
    to_other = (
        np.linalg.inv(rgb_to_xyz(primaries)) @ bradford(D65, white) @ rgb_to_xyz(SRGB)
    )
    light = srgb_to_light(srgb) @ to_other.T
    if gamma is None:
        return light_to_srgb(light)
    return np.clip(light, 0.0, 1.0) ** (1.0 / gamma)


# ICC profiles.


def _fixed(*values: float) -> bytes:
    return b"".join(struct.pack(">i", round(v * 65536)) for v in values)


def _xyz_tag(xyz: np.ndarray) -> bytes:
    return b"XYZ \0\0\0\0" + _fixed(*xyz)


def _curve(gamma: float | None, version: int) -> bytes:
    if gamma is not None and version == 2:
        return struct.pack(">4sIIH", b"curv", 0, 1, round(gamma * 256))
    if gamma is not None:
        return struct.pack(">4sIHH", b"para", 0, 0, 0) + _fixed(gamma)
    if version == 2:
        table = np.rint(65535 * srgb_to_light(np.linspace(0, 1, 1024))).astype(">u2")
        return struct.pack(">4sII", b"curv", 0, 1024) + table.tobytes()
    return struct.pack(">4sIHH", b"para", 0, 3, 0) + _fixed(
        2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045
    )


def _text(words: str, version: int) -> bytes:
    if version == 2:
        ascii_ = words.encode() + b"\0"
        return struct.pack(">4sII", b"desc", 0, len(ascii_)) + ascii_ + bytes(78)
    utf16 = words.encode("utf-16-be")
    return struct.pack(">4sIII4sII", b"mluc", 0, 1, 12, b"enUS", len(utf16), 28) + utf16


def icc_profile(
    primaries: Primaries | None,
    gamma: float | None,
    version: int = 4,
    name: str = "made by a test",
    cicp: tuple[int, int] | None = None,
) -> bytes:
    """A matrix/TRC profile, or a grey one without primaries."""
    tags = {
        b"desc": _text(name, version),
        b"cprt": b"text\0\0\0\0none\0" if version == 2 else _text("none", 4),
        b"wtpt": _xyz_tag(np.array([0.9642, 1.0, 0.8249])),
    }
    if primaries is None:
        tags[b"kTRC"] = _curve(gamma, version)
    else:
        colorants = bradford(primaries[3], D50) @ rgb_to_xyz(primaries)
        for channel, column in zip(b"rgb", colorants.T, strict=True):
            tags[bytes([channel]) + b"XYZ"] = _xyz_tag(column)
            tags[bytes([channel]) + b"TRC"] = _curve(gamma, version)
    if cicp is not None:
        tags[b"cicp"] = b"cicp\0\0\0\0" + bytes([*cicp, 0, 1])
    body, table = b"", struct.pack(">I", len(tags))
    for tag, content in tags.items():
        at = 132 + 12 * len(tags) + len(body)
        table += struct.pack(">4sII", tag, at, len(content))
        body += content + bytes(-len(content) % 4)
    head = bytearray(128)
    head[0:4] = struct.pack(">I", 128 + len(table) + len(body))
    head[8] = version
    head[12:24] = b"mntr" + (b"GRAY" if primaries is None else b"RGB ") + b"XYZ "
    head[36:40] = b"acsp"
    head[68:80] = _fixed(0.9642, 1.0, 0.8249)
    return bytes(head) + table + body


# PNG.


def png_chunk(kind: bytes, content: bytes) -> bytes:
    crc = zlib.crc32(kind + content)
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", crc)


def png_16(values: np.ndarray, *chunks: bytes) -> bytes:
    """A PNG of 16 bits from values (h, w) or (h, w, 3)."""
    height, width = values.shape[:2]
    colour = 0 if values.ndim == 2 else 2
    rows = values.astype(">u2").reshape(height, -1)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    header = struct.pack(">IIBBBBB", width, height, 16, colour, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + png_chunk(b"IHDR", header)
        + b"".join(chunks)
        + png_chunk(b"IDAT", zlib.compress(raw))
        + png_chunk(b"IEND", b"")
    )


def png_with(pixels: np.ndarray, *chunks: bytes) -> bytes:
    """A PNG of 8 bits with more chunks after its header."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    content = file.getvalue()
    return content[:33] + b"".join(chunks) + content[33:]


def chrm(primaries: Primaries) -> bytes:
    *rgb, white = primaries
    numbers = [round(v * 100_000) for xy in (white, *rgb) for v in xy]
    return png_chunk(b"cHRM", struct.pack(">8I", *numbers))


def gama(gamma: float) -> bytes:
    return png_chunk(b"gAMA", struct.pack(">I", round(100_000 / gamma)))


# RAW.


def write_dng(
    path: Path,
    srgb: np.ndarray,
    orientation: int = 1,
    exposure: float = 1.0,
) -> None:
    """A linear DNG of sRGB values (h, w, 3), 0 to 1, with a red thumbnail at its front.

    The camera's colours are linear sRGB, its white balance is neutral.
    """
    xyz_to_camera = np.linalg.inv(rgb_to_xyz(SRGB))
    matrix = [(round(v * 10_000), 10_000) for v in xyz_to_camera.ravel()]
    thumbnail = np.zeros((24, 32, 3), np.uint8)
    thumbnail[:, :, 0] = 255
    raw = np.rint(65535 * exposure * srgb_to_light(srgb)).astype(np.uint16)
    tags: list[tuple[int, int | str, int, Any, bool]] = [
        (271, "s", 0, "Test", True),
        (272, "s", 0, "Linear", True),
        (274, "H", 1, orientation, True),
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50707, "B", 4, (1, 1, 0, 0), True),
        (50708, "s", 0, "Test Linear", True),
        (50721, "2i", 9, tuple(v for pair in matrix for v in pair), True),
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),
        (50778, "H", 1, 21, True),
    ]
    main_tags: list[tuple[int, int | str, int, Any, bool]] = [
        (50714, "H", 3, (0, 0, 0), True),
        (50717, "H", 3, (65535, 65535, 65535), True),
    ]
    with tifffile.TiffWriter(path, byteorder="<") as file:
        file.write(
            thumbnail,
            photometric="rgb",
            subfiletype=1,
            subifds=1,
            extratags=tags,
            metadata=None,
            software=False,
        )
        file.write(
            raw,
            photometric=34892,
            subfiletype=0,
            extratags=main_tags,
            metadata=None,
            software=False,
        )
