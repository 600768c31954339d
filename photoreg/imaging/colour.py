"""Colour spaces in which photos are compared: sRGB to RGB, XYZ, LUV, Lab and HSI.

Every space comes back as three float32 channels on a scale of about 100, in which
the plain Euclidean distance is meaningful. Hue is an angle, so HSI is returned as
(intensity, S cos H, S sin H): two hues are then compared along the chord between
them, red has no seam at 360 degrees, and the hue of a grey (S = 0) counts nothing.
"""

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float32, UInt8

from photoreg.errors import InputError

ColourSpace = Literal["rgb", "xyz", "hsi", "luv", "lab"]

XYZ_FROM_LINEAR_RGB = np.array(
    [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ],
    dtype=np.float32,
)
"""ITU-R BT.709 primaries, white D65; Y of white is 1."""

WHITE_XYZ = XYZ_FROM_LINEAR_RGB.sum(axis=1)
"""What sRGB white maps to, so that greys have no chroma to the last digit."""

ROWS_AT_ONCE = 64
"""Rows converted together: the temporaries then stay in the processor's cache."""


def convert(
    pixels: UInt8[np.ndarray, "h w 3"], space: ColourSpace
) -> Float32[np.ndarray, "h w 3"]:
    """A photo's sRGB bytes in a colour space.

    Args:
        pixels: sRGB, 8 bits a channel.
        space: ``rgb``: gamma-coded, 0 to 100. ``xyz``: CIE XYZ, D65, Y 0 to 100.
            ``luv``, ``lab``: CIE 1976, L 0 to 100. ``hsi``: (I, S cos H, S sin H),
            I and S 0 to 100.

    Raises:
        InputError: if the space has no such name.
    """
    if space not in _CONVERTERS:
        raise InputError(
            f"{space!r} is not a colour space; choose {', '.join(get_args(ColourSpace))}."
        )
    converter = _CONVERTERS[space]
    result = np.zeros(pixels.shape, dtype=np.float32)
    for row in range(0, len(pixels), ROWS_AT_ONCE):
        result[row : row + ROWS_AT_ONCE] = converter(pixels[row : row + ROWS_AT_ONCE])
    return result


def _linear_of_bytes() -> np.ndarray:
    coded = np.arange(256) / 255.0
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


LINEAR_OF_BYTE = _linear_of_bytes()
"""Linear light (0 to 1) of each sRGB byte, IEC 61966-2-1."""


def _rgb(pixels: np.ndarray) -> np.ndarray:
    return pixels.astype(np.float32) * np.float32(100.0 / 255.0)


def _xyz_of_white_1(pixels: np.ndarray) -> np.ndarray:
    return LINEAR_OF_BYTE[pixels] @ XYZ_FROM_LINEAR_RGB.T


def _xyz(pixels: np.ndarray) -> np.ndarray:
    return _xyz_of_white_1(pixels) * np.float32(100.0)


def _lightness(Y: np.ndarray) -> np.ndarray:
    return np.where(
        Y > 216.0 / 24389.0,
        np.float32(116.0) * np.cbrt(Y) - np.float32(16.0),
        np.float32(24389.0 / 27.0) * Y,
    )


def _luv(pixels: np.ndarray) -> np.ndarray:
    """CIE 1976 (L*, u*, v*); black, whose chromaticity is undefined, is (0, 0, 0)."""
    xyz = _xyz_of_white_1(pixels)
    X, Y, Z = xyz[..., 0], xyz[..., 1], xyz[..., 2]
    L = _lightness(Y)
    white_sum = WHITE_XYZ @ np.array([1.0, 15.0, 3.0], dtype=np.float32)
    inverse_sum = np.float32(1.0) / np.maximum(
        X + np.float32(15.0) * Y + np.float32(3.0) * Z, np.float32(1e-12)
    )
    u = np.float32(4.0) * (X * inverse_sum - WHITE_XYZ[0] / white_sum)
    v = np.float32(9.0) * (Y * inverse_sum - WHITE_XYZ[1] / white_sum)
    return np.stack([L, np.float32(13.0) * L * u, np.float32(13.0) * L * v], axis=-1)


def _lab(pixels: np.ndarray) -> np.ndarray:
    """CIE 1976 (L*, a*, b*)."""
    ratio = _xyz_of_white_1(pixels) / WHITE_XYZ
    f = np.where(
        ratio > 216.0 / 24389.0,
        np.cbrt(ratio),
        ratio * np.float32(841.0 / 108.0) + np.float32(4.0 / 29.0),
    )
    return np.stack(
        [
            np.float32(116.0) * f[..., 1] - np.float32(16.0),
            np.float32(500.0) * (f[..., 0] - f[..., 1]),
            np.float32(200.0) * (f[..., 1] - f[..., 2]),
        ],
        axis=-1,
    )


def _hsi(pixels: np.ndarray) -> np.ndarray:
    """Hue, saturation, intensity as (I, S cos H, S sin H).

    References:
        R. C. Gonzalez and R. E. Woods, "Digital Image Processing", 1992, section
        4.6.2: S = 1 - min / I, H the angle from red around the grey axis.
    """
    rgb = pixels.astype(np.float32) * np.float32(1.0 / 255.0)
    R, G, B = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    intensity = rgb.mean(axis=-1)
    saturation = 1.0 - rgb.min(axis=-1) / np.maximum(intensity, np.float32(1e-6))
    saturation[intensity == 0.0] = 0.0
    hue = np.arctan2(np.float32(np.sqrt(3.0)) * (G - B), np.float32(2.0) * R - G - B)
    return np.float32(100.0) * np.stack(
        [intensity, saturation * np.cos(hue), saturation * np.sin(hue)], axis=-1
    )


_CONVERTERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "rgb": _rgb,
    "xyz": _xyz,
    "luv": _luv,
    "lab": _lab,
    "hsi": _hsi,
}
