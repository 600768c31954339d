"""A blur that takes nothing in from beyond a part of a photo."""

import cv2
import numpy as np
from jaxtyping import Float32


def blurred_within(
    values: Float32[np.ndarray, "h w c"],
    cover: Float32[np.ndarray, "h w"],
    sigma_px: float,
) -> Float32[np.ndarray, "h w c"]:
    """Gaussian blur of what is covered; beyond its reach the values mean nothing.

    Args:
        values: Of each pixel.
        cover: Share of each pixel that counts.
        sigma_px: Standard deviation of the blur.
    """
    if cover.all():
        return cv2.GaussianBlur(values, (0, 0), sigma_px)
    weight = cv2.GaussianBlur(cover, (0, 0), sigma_px)
    blurred = cv2.GaussianBlur(values * cover[..., None], (0, 0), sigma_px)
    return blurred / np.maximum(weight, np.float32(1e-6))[..., None]
