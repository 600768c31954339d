"""From light to the bytes of a photo: occluder, lens, exposure, noise, encoding."""

import io
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from photoreg.imaging.encoding import encode, encode_jpeg
from photoreg.synthetic.noise import SolidNoise
from photoreg.synthetic.options import SceneSettings
from photoreg.synthetic.render import encode_srgb


def occluded(
    linear: Float[np.ndarray, "h w 3"], share: float, seed: int
) -> Float[np.ndarray, "h w 3"]:
    """The picture with ``share`` of it hidden by a round thing that leans in."""
    rng = np.random.default_rng([seed, 0x0CC1])
    height, width = linear.shape[:2]
    grid_x, grid_y = np.meshgrid(np.arange(width), np.arange(height))
    places = _places(width, height)
    anchor_x = rng.choice([-0.02, 1.02]) * width
    anchor_y = rng.uniform(0.35, 0.75) * height
    noise = SolidNoise(seed + 2)
    wobble = noise(places, 4.0 / width, octaves=2)[:, 0].reshape(height, width)
    reach = np.hypot(grid_x - anchor_x, grid_y - anchor_y) + 0.03 * width * wobble
    # The level that exactly the share lies under; a pixel's width of soft edge.
    cover = np.clip(np.quantile(reach, share) - reach + 0.5, 0.0, 1.0)[:, :, None]
    grain = noise(places, 30.0 / width, octaves=4)[:, 1].reshape(height, width, 1)
    colour = np.array([0.16, 0.21, 0.12]) * (1.0 + 0.25 * grain)
    return (cover * colour + (1.0 - cover) * linear).astype(np.float32)


def behind_leaves(
    linear: Float[np.ndarray, "h w 3"], share: float, seed: int
) -> Float[np.ndarray, "h w 3"]:
    """The picture with ``share`` of it hidden by leaves, most of them near one side."""
    rng = np.random.default_rng([seed, 0x1EAF])
    height, width = linear.shape[:2]
    linear = np.array(linear, dtype=np.float32)
    hidden = np.zeros((height, width), dtype=np.uint8)
    side = rng.choice([-1.0, 1.0])
    while hidden.mean() < share:
        x = 0.5 * width * (1.0 + side * (1.0 - abs(rng.normal(0.0, 0.5))))
        place = (round(x), round(rng.uniform(0.0, height)))
        axes = (round(width * rng.uniform(0.008, 0.02)), round(width * 0.006) + 1)
        colour = np.array([0.06, 0.14, 0.04]) * rng.uniform(0.5, 1.5)
        turn = rng.uniform(0.0, 180.0)
        cv2.ellipse(linear, place, axes, turn, 0.0, 360.0, colour.tolist(), -1)
        cv2.ellipse(hidden, place, axes, turn, 0.0, 360.0, (1,), -1)
    return linear


def hazy(
    linear: Float[np.ndarray, "h w 3"], most: float, seed: Sequence[int]
) -> Float[np.ndarray, "h w 3"]:
    """The picture behind a veil that takes up to ``most`` of it, here more, there less."""
    height, width = linear.shape[:2]
    noise = SolidNoise(int(np.random.default_rng(seed).integers(1 << 31)))
    field = noise(_places(width, height), 2.0 / width, octaves=1)[:, 0].reshape(
        height, width
    )
    low, high = field.min(), field.max()
    veil = most * (field - low) / max(float(high - low), 1e-12)
    grey = np.array([0.55, 0.6, 0.66])
    return (linear + veil[:, :, None] * (grey - linear)).astype(np.float32)


def _places(width: int, height: int) -> Float[np.ndarray, "n 3"]:
    """Where noise is looked up for each pixel, row by row."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def expose(
    linear: Float[np.ndarray, "h w 3"], index: int, seed: int, settings: SceneSettings
) -> UInt8[np.ndarray, "h w 3"]:
    """Pixel bytes of photo ``index``: dark corners, sRGB, gain and offset, noise.

    The first photo has neither gain nor offset.
    """
    height, width = linear.shape[:2]
    if settings.vignetting > 0.0:
        half_diagonal = 0.5 * np.hypot(width, height)
        x = (np.arange(width) - 0.5 * (width - 1)) / half_diagonal
        y = (np.arange(height) - 0.5 * (height - 1)) / half_diagonal
        squared = y[:, None] ** 2 + x[None, :] ** 2
        linear = linear * (1.0 - settings.vignetting * squared)[:, :, None]
    values = encode_srgb(linear)
    if index > 0:
        values = values * np.asarray(settings.gain) + np.asarray(settings.offset)
    if settings.sensor_noise > 0.0:
        rng = np.random.default_rng([seed, 0x5E45, index])
        values = values + settings.sensor_noise * rng.standard_normal(
            values.shape, dtype=np.float32
        )
    return np.rint(np.clip(values, 0.0, 255.0)).astype(np.uint8)


def encode_photo(
    pixels: UInt8[np.ndarray, "h w 3"], stem: str, jpeg_quality: int
) -> tuple[str, bytes]:
    """File name and bytes of a photo: a JPEG, or a PNG if ``jpeg_quality`` is 0."""
    if jpeg_quality > 0:
        return f"{stem}.jpg", encode_jpeg(pixels, jpeg_quality)
    options = (cv2.IMWRITE_PNG_COMPRESSION, 1)
    return f"{stem}.png", encode(pixels, ".png", options)


def decode_photo(data: bytes) -> UInt8[np.ndarray, "h w 3"]:
    """Pixels of a file made by `encode_photo`."""
    # Pillow, as `load_photo` does: decoders differ in the last bit of a JPEG.
    with Image.open(io.BytesIO(data)) as image:
        return np.array(image.convert("RGB"), dtype=np.uint8)
