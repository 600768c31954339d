"""Two sets of cameras beside each other, in every photo."""

from collections.abc import Sequence

import numpy as np

from photoreg.geometry.camera import Camera
from photoreg.imaging.encoding import encode_jpeg
from photoreg.overlay.disagreement_map import disagreement_picture, mean_disagreement
from photoreg.overlay.pictures import AlignedPair, LiveOverlay, OverlayMode, compose
from photoreg.report.photo_comparison import PhotoComparison

PICTURE_SIDE_PX = 1024
JPEG_QUALITY = 82


def draw_comparison(
    overlay: LiveOverlay,
    before: Sequence[Camera],
    after: Sequence[Camera],
    mode: OverlayMode,
) -> tuple[PhotoComparison, ...]:
    """The overlays of two sets of cameras, and where their photos disagree.

    Args:
        overlay: The mesh and the photos.
        before: One camera a photo.
        after: The same.
        mode: How two photos are laid over each other.
    """
    photos = overlay.photos
    has_other = len(photos) > 1
    if not has_other and mode == "carried":
        # The surface alone would not show how the photo lies on it.
        mode = "blend"
    found = []
    for onto, photo in enumerate(photos):
        old, new = (aligned_pair(overlay, each, onto) for each in (before, after))
        found.append(
            PhotoComparison(
                name=photo.name,
                carried=photos[(onto + 1) % len(photos)].name,
                before=jpeg(compose(old, mode)),
                after=jpeg(compose(new, mode)),
                disagreement_before=_heat(old) if has_other else b"",
                disagreement_after=_heat(new) if has_other else b"",
                levels_before=mean_disagreement(old) if has_other else None,
                levels_after=mean_disagreement(new) if has_other else None,
            )
        )
    return tuple(found)


def aligned_pair(
    overlay: LiveOverlay, cameras: Sequence[Camera], onto: int, quick: bool = False
) -> AlignedPair:
    """The next photo carried over into one; of a single photo the surface.

    Args:
        overlay: The mesh and the photos.
        cameras: One camera a photo.
        onto: Index of the photo underneath.
        quick: Whether a rough picture will do, because the next one follows soon.
    """
    if len(cameras) == 1:
        return overlay.shape_pair(cameras, onto)
    carried = (onto + 1) % len(cameras)
    draw = overlay.quick_pair if quick else overlay.pair
    return draw(cameras, onto, carried)


def jpeg(picture: np.ndarray) -> bytes:
    """A picture to look at."""
    return encode_jpeg(picture, JPEG_QUALITY)


def _heat(pair: AlignedPair) -> bytes:
    return jpeg(disagreement_picture(pair))
