"""What lensfun's database knows of the lens that took a photo.

It needs lensfunpy (``pip install 'photoreg[lensfun]'``); without it nothing is known. A
lens is found by what EXIF says: make, model, lens and focal length. What is known is a
start and the centre of a prior: lenses of one type differ, and the refinement solves them.

References:
    lensfun, https://lensfun.github.io: its distortion models, and its database (CC BY-SA).
"""

import functools
import importlib
from typing import Any

import numpy as np

from photoreg.geometry.lens import Lens
from photoreg.imaging.photo import KnownLens

LONGER_SIDE_PX = 256
"""Of the grid on which lensfun's distortion is sampled."""
WORST_FIT = 1e-3
"""How far the terms may be off lensfun's own distortion, of the photo's longer side: as a
start, to be refined, a pixel at 1,000 is near enough."""


def known_lens(
    make: str,
    model: str,
    lens_model: str,
    focal_mm: float,
    focal_px: float,
    size: tuple[float, float],
) -> KnownLens | None:
    """The lens that took a photo; None where the database does not know it.

    Args:
        make: Of the camera, as EXIF has it.
        model: Likewise.
        lens_model: Likewise; empty where EXIF does not name the lens: then the lens is
            known where the camera has a fixed one.
        focal_mm: The focal length of the lens, not its 35 mm equivalent.
        focal_px: The focal length in pixels of the photo.
        size: Width and height of the whole photo in the same pixels.
    """
    lensfunpy, database = _database()
    if database is None or not model:
        return None
    cameras = database.find_cameras(make or None, model)
    if not cameras:
        return None
    camera = cameras[0]
    is_fixed = camera.mount[:1].islower()  # So the database marks fixed lenses.
    found = [
        lens
        for lens in database.find_lenses(
            camera, None, None if is_fixed else lens_model or None
        )
        if lens.min_focal <= focal_mm * 1.02 and focal_mm <= lens.max_focal * 1.02
    ]
    if not found or (not is_fixed and not lens_model):
        return None
    lens = found[0]
    if lens.type != lensfunpy.LensType.RECTILINEAR or not lens.calib_distortion:
        return None
    shrink = LONGER_SIDE_PX / max(size)
    width, height = (max(16, round(side * shrink)) for side in size)
    modifier = lensfunpy.Modifier(lens, camera.crop_factor, width, height)
    modifier.initialize(
        focal_mm, lens.min_aperture or 4.0, scale=1.0,
        flags=lensfunpy.ModifyFlags.DISTORTION,
    )  # fmt: skip
    bent = modifier.apply_geometry_distortion()
    if bent is None:
        return None
    terms = radial_terms(np.asarray(bent, float), focal_px * shrink)
    return None if terms is None else KnownLens(Lens(*terms), lens.model)


def radial_terms(bent: np.ndarray, focal_px: float) -> tuple[float, float] | None:
    """k1 and k2 of a distortion that is given by where each pixel of a grid comes from.

    The focal length is fitted along, as lensfun's models scale the centre too; None
    where two terms are further off than ``WORST_FIT``.

    Args:
        bent: (h, w, 2) places in the photo, by the ideal pixel.
        focal_px: In the same pixels.
    """
    height, width = bent.shape[:2]
    center = 0.5 * np.array([width - 1.0, height - 1.0])
    y, x = np.mgrid[:height, :width]
    ideal = np.hypot(x - center[0], y - center[1]).ravel() / focal_px
    seen = np.hypot(*(bent - center).reshape(-1, 2).T) / focal_px
    powers = np.stack([ideal, ideal**3, ideal**5], axis=1)
    scale, cubic, quintic = np.linalg.lstsq(powers, seen, rcond=None)[0]
    off = np.abs(powers @ (scale, cubic, quintic) - seen).max() * focal_px
    if not (scale > 0.0 and off <= WORST_FIT * max(width, height)):
        return None
    return float(cubic / scale), float(quintic / scale)


@functools.cache
def _database() -> tuple[Any, Any]:
    """The package and its database; nothing where it is not installed."""
    try:
        lensfunpy = importlib.import_module("lensfunpy")
    except ImportError:
        return None, None
    return lensfunpy, lensfunpy.Database()
