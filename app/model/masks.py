"""Masks as the document keeps them: a PNG of one bit a pixel, white where a photo counts.

A photo of 50 megapixels has a mask of 50 MB, and undo keeps many; as PNG it is some
kilobytes. No viser here.
"""

import functools
import hashlib
import io
import itertools
from collections.abc import Sequence

import cv2
import numpy as np
from PIL import Image

from photoreg.errors import InputError
from photoreg.formats.photos.registry import JPEG, PNG, TIFF, WEBP
from photoreg.imaging.encoding import encode

MASK_FORMATS = (PNG, JPEG, TIFF, WEBP)
MASK_SUFFIXES = tuple(suffix for known in MASK_FORMATS for suffix in known.suffixes)

PNG_HEAD = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"

SUBPIXEL_BITS = 4
"""Strokes are drawn to a sixteenth of a pixel."""


def encode_mask(mask: np.ndarray) -> bytes | None:
    """A mask (h, w), True where the photo counts, as PNG; None if that is everywhere."""
    if mask.all():
        return None
    return encode(
        np.where(mask, np.uint8(255), np.uint8(0)),
        ".png",
        (cv2.IMWRITE_PNG_BILEVEL, 1, cv2.IMWRITE_PNG_COMPRESSION, 1),
    )


def decode_mask(png: bytes) -> np.ndarray:
    """The mask (h, w) of bool that ``encode_mask`` made a PNG of."""
    grey = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise InputError("The mask could not be read. Load or paint it again.")
    return grey >= 128


@functools.lru_cache(maxsize=4)
def masks_stamp(masks: tuple[bytes | None, ...]) -> str:
    """Tells masks from others, in a line that can be kept; empty where there is none."""
    if not any(masks):
        return ""
    digests = [hashlib.sha256(png or b"").digest() for png in masks]
    return hashlib.sha256(b"".join(digests)).hexdigest()


def check_mask(png: bytes, width: int, height: int) -> None:
    """Checks by its head that a mask is a PNG of a photo's size, before it is unpacked.

    Raises:
        InputError: if it is something else.
    """
    size = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    if png[:16] != PNG_HEAD or png[16:24] != size:
        raise InputError(
            f"A mask of the project is not a PNG of {width}x{height} px, as its photo "
            "is; it is damaged."
        )


def painted_mask(
    png: bytes | None,
    width: int,
    height: int,
    stroke: Sequence[tuple[float, float]],
    radius_px: float,
    counts: bool,
) -> bytes | None:
    """The mask after one stroke of a round brush.

    Args:
        png: The mask so far; None: the photo counts everywhere.
        width: Width of the photo in pixels.
        height: Its height.
        stroke: The brush's path in photo pixels; (0, 0) is a pixel's centre.
        radius_px: Radius of the brush, in photo pixels.
        counts: Whether the photo shall count where the brush was, or not.

    Raises:
        InputError: if the stroke is empty, not finite, or the brush has no size.
    """
    path = np.asarray(stroke, dtype=np.float64).reshape(-1, 2)
    if len(path) == 0 or not np.isfinite(path).all() or not 0 < radius_px < 1e5:
        raise InputError("A stroke needs places within reach and a brush with a size.")
    path = np.clip(path, -4 * max(width, height), 5 * max(width, height))
    grey = np.full((height, width), 255, np.uint8)
    if png is not None:
        grey[~decode_mask(png)] = 0
    colour, one = 255 if counts else 0, 1 << SUBPIXEL_BITS
    points = np.rint(path * one).astype(np.int32)
    radius = max(round(radius_px * one), 1)
    for point in points:
        cv2.circle(grey, point.tolist(), radius, colour, -1, shift=SUBPIXEL_BITS)
    if radius_px >= 1.0:
        # Between two places the brush sweeps a rectangle.
        for a, b in itertools.pairwise(path):
            length = float(np.linalg.norm(b - a))
            if length < 1e-6:
                continue
            aside = radius_px * np.array([a[1] - b[1], b[0] - a[0]]) / length
            corners = np.rint(
                np.stack([a + aside, b + aside, b - aside, a - aside]) * one
            )
            cv2.fillConvexPoly(
                grey, corners.astype(np.int32), colour, shift=SUBPIXEL_BITS
            )
    return encode_mask(grey >= 128)


def mask_of(name: str, content: bytes, width: int, height: int) -> bytes | None:
    """The same of the content of a file."""
    try:
        names = [name for known in MASK_FORMATS for name in known.pillow_names]
        with Image.open(io.BytesIO(content), formats=names) as image:
            size = image.size
            has_alpha = "A" in image.getbands() or "transparency" in image.info
            rgba = image.convert("RGBA")
    except Exception as error:
        raise InputError(
            f"{name} could not be read as a picture; a mask should be a "
            f"{', '.join(known.name for known in MASK_FORMATS)}."
        ) from error
    if abs(size[0] * height - size[1] * width) > max(*size, width, height):
        raise InputError(
            f"The mask {name} is {size[0]}x{size[1]} px, but the photo is "
            f"{width}x{height} px: the shapes should be the same."
        )
    grey = np.asarray(rgba.convert("L"))
    alpha = np.asarray(rgba)[:, :, 3]
    # With transparency that is in use, that is the mask; otherwise dark and light.
    mask = alpha >= 128 if has_alpha and alpha.min() < 128 else grey >= 128
    if size != (width, height):
        mask = cv2.resize(
            mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
        ).astype(bool)
    if not mask.any():
        raise InputError(
            f"The mask {name} is dark all over: nothing of the photo would count. "
            "It should be white where the photo counts."
        )
    return encode_mask(mask)
