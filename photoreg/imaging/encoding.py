"""Pictures as the bytes of a PNG or JPEG file."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

from photoreg.errors import OutputError

_FROM_RGB = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}


def encode(
    pixels: UInt8[np.ndarray, "h w *channels"],
    suffix: str,
    options: Sequence[int] = (),
) -> bytes:
    """Encodes a grey picture, or one in sRGB without or with opacity.

    Args:
        pixels: Bytes of (h, w), (h, w, 3) or (h, w, 4).
        suffix: ``.png`` or ``.jpg``.
        options: OpenCV's, by twos: a name ``cv2.IMWRITE_...`` and its value.

    Raises:
        OutputError: if it cannot be encoded, such as a JPEG of more than 65,535 px.
    """
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(np.ascontiguousarray(pixels), _FROM_RGB[pixels.shape[2]])
    done, data = cv2.imencode(suffix, pixels, list(options))
    if not done:
        height, width = pixels.shape[:2]
        raise OutputError(
            f"A picture of {width}x{height} px could not be encoded as {suffix[1:]}."
        )
    return data.tobytes()


def encode_jpeg(
    pixels: UInt8[np.ndarray, "h w 3"], quality: int, max_side_px: int | None = None
) -> bytes:
    """A picture to look at as JPEG, area-averaged so that no side exceeds ``max_side_px``."""
    shrink = min(1.0, (max_side_px or np.inf) / max(pixels.shape[:2]))
    if shrink < 1.0:
        area = cv2.INTER_AREA
        pixels = cv2.resize(
            pixels, None, fx=shrink, fy=shrink, interpolation=area
        ).astype(np.uint8)
    return encode(pixels, ".jpg", (cv2.IMWRITE_JPEG_QUALITY, quality))
