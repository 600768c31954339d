"""A photo as an ideal lens would have taken it."""

import dataclasses

import cv2
import numpy as np

from photoreg.geometry.camera import Camera
from photoreg.geometry.projection import distort_grid
from photoreg.imaging.photo import Photo


def undistorted_photo(photo: Photo, camera: Camera) -> Photo:
    """The photo resampled so that ``camera.pinhole`` is its camera.

    Of the same size, so K, R and t keep their meaning; what the lens shows outside of
    that is lost. What it does not show is black, and outside the mask.

    Args:
        photo: Any size; the camera is scaled to it.
        camera: Of the photo.
    """
    if camera.lens.is_ideal:
        return photo
    camera = camera.resized(photo.width, photo.height)
    columns, rows = distort_grid(camera.record, photo.width, photo.height)
    pixels = cv2.remap(photo.pixels, columns, rows, cv2.INTER_CUBIC)
    shown = np.ones((photo.height, photo.width), dtype=np.uint8)
    if photo.mask is not None:
        shown = photo.mask.astype(np.uint8)
    mask = cv2.remap(shown, columns, rows, cv2.INTER_NEAREST) > 0
    return dataclasses.replace(
        photo, pixels=pixels, mask=None if mask.all() else mask, source=None
    )
