"""A photograph: pixels as displayed, optional mask, and what EXIF knows of the lens."""

import dataclasses
import functools
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from photoreg.errors import InputError
from photoreg.geometry.camera import reduced_size
from photoreg.geometry.lens import Lens
from photoreg.sources import SourceFile
from photoreg.words import nfc

Pair = tuple[int, int]
"""Two photos by index, the smaller one first."""

MIN_SIDE_PX = 16
MAX_KEPT, MAX_KEPT_PIXELS = 4, 1 << 20
"""Reductions that a photo keeps, and the pixels of the largest: 12 MB at most, beside
the 36 MB of a photo of 12 megapixels."""


@dataclasses.dataclass(frozen=True)
class KnownLens:
    """A lens of lensfun's database."""

    lens: Lens
    """Its radial terms at the photo's focal length."""
    name: str
    """As the database names it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Photo:
    """A photograph as displayed: EXIF orientation is already applied.

    Raises:
        InputError: at construction, if the pixels are not (h, w, 3) bytes, the
            photo is smaller than 16 px on a side, or the mask has another size.
    """

    name: str
    """File name, in Unicode's composed form; cameras are matched to photos by it."""
    pixels: UInt8[np.ndarray, "h w 3"]
    """sRGB, row 0 at the top."""
    mask: Bool[np.ndarray, "h w"] | None = None
    """True where the photo counts; None: everywhere."""
    exif_focal_px: float | None = None
    """Focal length in pixels by EXIF, a starting value; None if EXIF does not tell."""
    source: SourceFile | None = None
    """The file it was read from; None if it was made in memory."""
    exif_focal_note: str = ""
    """Where EXIF has the focal length from and how sure that is, for people."""
    is_cropped: bool = False
    """Whether EXIF shows that a part was cut off: the principal point may lie anywhere."""
    known_lens: KnownLens | None = None
    """The lens that took it, where lensfun knows it; its distortion is a starting value."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", nfc(self.name))
        pixels = self.pixels
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
            raise InputError(
                f"{self.name}: pixels should be (height, width, 3) bytes, but are "
                f"{pixels.shape} {pixels.dtype}."
            )
        if min(pixels.shape[:2]) < MIN_SIDE_PX:
            raise InputError(
                f"{self.name} is {self.width}x{self.height} px; a photo should be at "
                f"least {MIN_SIDE_PX} px on each side."
            )
        if self.mask is not None and self.mask.shape != pixels.shape[:2]:
            raise InputError(
                f"{self.name}: the mask is {self.mask.shape[1]}x{self.mask.shape[0]} px, "
                f"but the photo is {self.width}x{self.height} px."
            )

    @property
    def width(self) -> int:
        """Width in pixels, as displayed."""
        return self.pixels.shape[1]

    @property
    def height(self) -> int:
        """Height in pixels, as displayed."""
        return self.pixels.shape[0]

    @functools.cached_property
    def _reductions(self) -> dict[tuple[int, int], UInt8[np.ndarray, "h w 3"]]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        # Reductions are quicker made anew than sent to another process.
        names = [field.name for field in dataclasses.fields(self)]
        return {name: self.__dict__[name] for name in names}

    def pixels_at(self, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
        """The pixels averaged by area to width and height ``size``; not to be changed.

        Small ones are kept: the terms of a refinement ask for the same few sizes again
        and again.
        """
        if size == (self.width, self.height):
            return self.pixels
        kept = self._reductions.get(size)
        if kept is not None:
            return kept
        pixels = cv2.resize(self.pixels, size, interpolation=cv2.INTER_AREA)
        pixels = pixels.astype(np.uint8, copy=False)
        if size[0] * size[1] <= MAX_KEPT_PIXELS:
            self._reductions[size] = pixels
            if len(self._reductions) > MAX_KEPT:
                del self._reductions[next(iter(self._reductions))]
        return pixels

    def resized(self, max_side_px: int) -> "Photo":
        """The photo reduced (area-averaged) so that no side exceeds ``max_side_px``.

        The shorter side keeps 16 pixels: a long, narrow photo stays a photo.
        """
        size = reduced_size(self.width, self.height, max_side_px, MIN_SIDE_PX)
        if size == (self.width, self.height):
            return self
        mask = self.mask
        if mask is not None:
            mask = (
                cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
                > 0
            )
        return dataclasses.replace(
            self,
            pixels=self.pixels_at(size),
            mask=mask,
            exif_focal_px=None
            if self.exif_focal_px is None
            else self.exif_focal_px * size[0] / self.width,
            source=None,
        )


def resized_mask(photo: Photo, size: tuple[int, int]) -> Bool[np.ndarray, "h w"] | None:
    """The photo's mask at width and height ``size``; None where all counts."""
    if photo.mask is None:
        return None
    share = cv2.resize(
        photo.mask.astype(np.float32), size, interpolation=cv2.INTER_AREA
    )
    return share >= 0.5
