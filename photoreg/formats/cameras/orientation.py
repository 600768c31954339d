"""Cameras of photos that EXIF turns: of the pixels as stored, and as displayed.

photoreg's cameras are of photos as displayed. Most other programs pass over EXIF's
orientation and number the pixels as the file stores them, so their cameras are turned
about the axis of view on the way in and out.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.formats.photos.decoding import PhotoHeader
from photoreg.formats.photos.files import photo_header
from photoreg.geometry.camera import Camera

PROPER = (1, 3, 6, 8)
"""EXIF orientations that turn; the others mirror, which no camera does."""


def cameras_as_displayed(
    cameras: Mapping[str, Camera], photos: Mapping[str, Path], program: str
) -> tuple[dict[str, Camera], list[str]]:
    """Cameras of stored pixels turned with their photos.

    Args:
        cameras: As another program has them, by photo name.
        photos: Where the photos lie, as far as known.
        program: The program, for sentences.

    Returns:
        The cameras as displayed, and a sentence about those where the photo's size does not
        show whether they were of the stored pixels.

    Raises:
        InputError: if EXIF mirrors a photo.
    """
    turned, unsure = dict(cameras), []
    for name, camera in cameras.items():
        if name not in photos:
            continue
        header = photo_header(photos[name])
        if header.orientation == 1 or _is_upright(camera, header):
            continue
        turned[name] = _turned(name, camera, header.orientation)
        if camera.width == camera.height or header.orientation == 3:
            unsure.append(name)
    if not unsure:
        return turned, []
    return turned, [
        f"{', '.join(unsure)}: EXIF turns what the file stores, and sizes do not show "
        f"whether {program} respected that. The cameras were taken to be of the stored "
        "pixels and turned; if the photo lies turned on the surface, give upright copies."
    ]


def cameras_as_stored(
    cameras: Mapping[str, Camera], photos: Mapping[str, Path]
) -> tuple[dict[str, Camera], list[str]]:
    """The inverse: cameras for programs that read the pixels as they are stored.

    Returns:
        The cameras, and a sentence about photos that EXIF mirrors: these keep theirs.
    """
    turned, mirrored = dict(cameras), []
    for name, camera in cameras.items():
        header = photo_header(photos[name]) if name in photos else None
        if header is None or header.orientation == 1:
            continue
        if header.orientation not in PROPER:
            mirrored.append(name)
        elif (camera.width, camera.height) == header.displayed_size:
            inverse = {6: 8, 8: 6}.get(header.orientation, header.orientation)
            turned[name] = _turned(name, camera, inverse)
    if not mirrored:
        return turned, []
    return turned, [
        f"{', '.join(mirrored)}: EXIF mirrors what the file stores, for which there is "
        "no camera; give the other program upright copies."
    ]


def _is_upright(camera: Camera, header: PhotoHeader) -> bool:
    """Whether the size shows that a camera is of the photo as displayed."""
    stored, shown = (header.width, header.height), header.displayed_size
    return stored != shown and (camera.width, camera.height) == shown


def _turned(name: str, camera: Camera, orientation: int) -> Camera:
    """The camera of a photo after it was turned as an EXIF orientation asks."""
    if orientation not in PROPER:
        raise InputError(
            f"{name} is mirrored by its EXIF orientation ({orientation}), so a camera of "
            "its stored pixels does not fit the photo as displayed. Save an upright copy "
            "of the photo and use that in both programs."
        )
    A, offset = _pixel_map(orientation, camera.width, camera.height)
    roll = np.eye(3)
    roll[:2, :2] = A
    H = roll.copy()
    H[:2, 2] = offset
    width, height = camera.width, camera.height
    if orientation >= 5:
        width, height = height, width
    K = H @ camera.K @ roll.T
    # The tangential terms turn as a vector (p2, p1) does; the radial ones stay.
    p2, p1 = A @ (camera.lens.p2, camera.lens.p1)
    lens = dataclasses.replace(camera.lens, p1=float(p1), p2=float(p2))
    if abs(K[1, 0]) > 1e-12 * abs(K[1, 1]):  # Skew, which turns into another.
        if not lens.is_ideal:
            raise InputError(
                f"{name} is turned by its EXIF orientation, and its camera has both skew "
                "and lens distortion, which cannot be turned together. Undistort it, or "
                "save an upright copy of the photo."
            )
        return Camera.from_projection_matrix(H @ camera.P, width, height)
    K[1, 0] = 0.0
    R, t = roll @ camera.R_cam_world, roll @ camera.t_cam_world
    return Camera(K, R, t, width, height, lens)


def _pixel_map(
    orientation: int, width: int, height: int
) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "2"]]:
    """A and b of x_displayed = A x_stored + b; the size is as stored."""
    right, bottom = width - 1.0, height - 1.0
    maps = {
        1: ([[1, 0], [0, 1]], [0.0, 0.0]),
        3: ([[-1, 0], [0, -1]], [right, bottom]),
        6: ([[0, -1], [1, 0]], [bottom, 0.0]),
        8: ([[0, 1], [-1, 0]], [0.0, right]),
    }
    A, offset = maps[orientation]
    return np.array(A, dtype=np.float64), np.array(offset)
