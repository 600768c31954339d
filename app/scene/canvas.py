"""A photo on the canvas: warped to it, or as a plane in the scene. Pure geometry.

viser's camera knows a vertical field of view and nothing else: square pixels, the
principal point in the middle. A photo is brought to it in two ways: warped to what such
a camera would have taken, or as a rectangle that stands where K says.
"""

import cv2
import numpy as np

from app.model.camera_moves import DisplayFrame
from photoreg.geometry.camera import Camera, centred_intrinsics

SURROUND = {True: (38, 41, 48), False: (229, 232, 237)}
"""Around the photo that is looked through, on a dark and on a light page."""

FIT = 0.97


def backdrop(dark: bool) -> np.ndarray:
    """A quiet gradient behind the scene, (256, 8, 3) bytes."""
    top, bottom = (
        ((44, 49, 58), (17, 19, 23)) if dark else ((250, 250, 251), (214, 219, 226))
    )
    shade = np.linspace(0.0, 1.0, 256)[:, None, None]
    column = (1.0 - shade) * np.array(top) + shade * np.array(bottom)
    return np.repeat(np.rint(column).astype(np.uint8), 8, axis=1)


def fitting_focal(camera: Camera, width: int, height: int) -> float:
    """Focal length, in canvas pixels, with which the whole photo is in the canvas."""
    K = camera.K
    x = max(K[0, 2] + 0.5, camera.width - 0.5 - K[0, 2]) / K[0, 0]
    y = max(K[1, 2] + 0.5, camera.height - 0.5 - K[1, 2]) / K[1, 1]
    return FIT * min(0.5 * width / x, 0.5 * height / y)


def warped_photo(
    pixels: np.ndarray,
    camera: Camera,
    focal: float,
    width: int,
    height: int,
    around: tuple[int, int, int] = SURROUND[True],
) -> np.ndarray:
    """The photo as a camera with centred principal point and square pixels sees it.

    Canvas pixel (x, y), centre of the first at 0, shows the ray
    ((x - (w - 1) / 2) / focal, (y - (h - 1) / 2) / focal, 1).
    """
    C = centred_intrinsics(focal, width, height)
    M = (C @ np.linalg.inv(camera.K))[:2]
    return cv2.warpAffine(
        pixels,
        M,
        (width, height),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=around,
    )


def view_angle(focal: float, height: float) -> float:
    """Vertical field of view, in radians, of a focal length in canvas pixels."""
    return float(2.0 * np.arctan(0.5 * height / focal))


def photo_plane(
    camera: Camera, depth: float
) -> tuple[float, float, tuple[float, float, float]]:
    """Width, height and centre, in camera axes, of the photo as a plane at ``depth``."""
    K = camera.K
    fx, fy = K[0, 0], K[1, 1]
    # Continuous pixels: the first pixel reaches from 0 to 1.
    x = (0.5 * camera.width - K[0, 2] - 0.5) / fx * depth
    y = (0.5 * camera.height - K[1, 2] - 0.5) / fy * depth
    return camera.width / fx * depth, camera.height / fy * depth, (x, y, depth)


def without_skew(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    """The photo sheared so that a rectangle shows it right; itself where K has no skew."""
    K = camera.K
    shear = K[0, 1] / K[1, 1]
    if abs(shear) * camera.height < 0.05:
        return pixels
    M = np.array([[1.0, -shear, shear * K[1, 2]], [0.0, 1.0, 0.0]])
    return cv2.warpAffine(
        pixels, M, (camera.width, camera.height), borderMode=cv2.BORDER_REPLICATE
    )


def brightened(pixels: np.ndarray, gain: float) -> np.ndarray:
    """Pixels ``gain`` times as bright; white stays white."""
    return pixels if gain == 1.0 else cv2.convertScaleAbs(pixels, alpha=gain)


def far_depth(frame: DisplayFrame, camera: Camera, bounds: np.ndarray) -> float:
    """A depth, in page units, beyond everything within ``bounds`` (2, 3)."""
    corners = np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3)
    return 1.02 * max(float(camera.to_camera(corners)[:, 2].max()) * frame.scale, 0.1)
