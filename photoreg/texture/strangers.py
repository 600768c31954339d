"""What stands in front of the object in a photo, found where other photos disagree."""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from photoreg.geometry.camera import Camera, reduced_size
from photoreg.imaging.photo import Photo

LEAST_PHOTOS = 3
"""Where only two disagree, there is no telling which is right."""
LEAST_LOG_RATIO = 0.25
"""Colours that differ by less, in a logarithm of a channel, may be of one surface:
because of angle, light and misalignment by a pixel."""
SPREADS = 4.0
"""Differences within this many robust standard deviations are usual for a photo."""
DARKEST, BRIGHTEST = 8.0, 247.0
"""Levels beyond are clipped to these: a black bar is as far off as can be told."""
GRID_SIDE = 256
"""Cells along a photo's longer side in which differing texels are counted."""
BLUR_CELLS = 1.0
LEAST_SHARE = 0.5
"""Share of the texels around a cell: where more differ, something stands in front."""
TEXELS_AT_A_TIME = 20_000


@dataclasses.dataclass(frozen=True, eq=False)
class Stranger:
    """Where a photo shows something other than the surface."""

    area: Bool[np.ndarray, "h w"]
    """Where, on a coarse grid over the photo."""
    share: float
    """Of the texels that the photo sees, in [0, 1]."""

    def taken_from(self, photo: Photo) -> Photo:
        """The photo with its mask less the area."""
        if not self.area.any():
            return photo
        size = (photo.width, photo.height)
        taken = cv2.resize(
            self.area.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST
        )
        keep = taken == 0
        if photo.mask is not None:
            keep &= photo.mask
        return dataclasses.replace(photo, mask=keep)


def find_strangers(
    cameras: Sequence[Camera],
    points: Float[np.ndarray, "n 3"],
    colours: Sequence[Float[np.ndarray, "n 3"]],
    gains: Float[np.ndarray, "m 3"],
) -> list[Stranger]:
    """Where each photo disagrees with the others, among places that three or more see.

    A colour differs if it is far from the median of all photos that see the place, and
    most of them, two at least, are near it. What differs over an area is left out; single
    texels, at edges of the texture, are not.

    Args:
        cameras: Of each photo.
        points: Places on the surface, evenly spread.
        colours: What each photo sees there; NaN where it does not.
        gains: By which each photo's channels are multiplied to agree with the others.

    References:
        The photo-consistency check of M. Waechter, N. Moehrle and M. Goesele, "Let There
        Be Color! Large-Scale Texturing of 3D Reconstructions", ECCV 2014, section 3.1,
        doi:10.1007/978-3-319-10602-1_54, with medians instead of means.
    """
    n = len(points)
    differs = np.zeros((len(cameras), n), dtype=bool)
    judged = np.zeros((len(cameras), n), dtype=bool)
    usual = _usual_differences(colours, gains)
    for start in range(0, n, TEXELS_AT_A_TIME):
        part = slice(start, start + TEXELS_AT_A_TIME)
        off, seen = _off_median([one[part] for one in colours], gains)
        far = (np.abs(np.nan_to_num(off)) > usual[:, None, :]).any(axis=2) & seen
        near = (seen & ~far).sum(axis=0)
        enough = (near >= 2) & (2 * near > seen.sum(axis=0))
        judged[:, part] = seen & enough
        differs[:, part] = far & enough
    return [
        _stranger(camera, points, differs[i], judged[i], np.isfinite(colours[i][:, 0]))
        for i, camera in enumerate(cameras)
    ]


def _off_median(
    colours: Sequence[np.ndarray], gains: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of colours less their median over the photos (m, n, 3), and who sees.

    NaN, and not seen, where fewer than three photos see a place.
    """
    values = np.stack(colours).astype(np.float64)
    seen = np.isfinite(values[:, :, 0])
    seen &= seen.sum(axis=0) >= LEAST_PHOTOS
    logs = np.log(np.clip(values, DARKEST, BRIGHTEST)) + np.log(gains)[:, None, :]
    logs[~seen] = np.nan
    several = seen.any(axis=0)
    off = np.full(logs.shape, np.nan)
    off[:, several] = logs[:, several] - np.nanmedian(logs[:, several], axis=0)
    return off, seen


def _usual_differences(
    colours: Sequence[np.ndarray], gains: np.ndarray
) -> Float[np.ndarray, "m 3"]:
    """How far each photo's colours usually are from the median, by channel."""
    step = max(1, len(colours[0]) // TEXELS_AT_A_TIME)
    off, seen = _off_median([one[::step] for one in colours], gains)
    usual = np.full((len(colours), 3), LEAST_LOG_RATIO)
    for i, own in enumerate(seen):
        if own.any():
            spread = 1.4826 * np.median(np.abs(off[i, own]), axis=0)
            usual[i] = np.maximum(usual[i], SPREADS * spread)
    return usual


def _stranger(
    camera: Camera,
    points: np.ndarray,
    differs: np.ndarray,
    judged: np.ndarray,
    seen: np.ndarray,
) -> Stranger:
    width, height = reduced_size(camera.width, camera.height, GRID_SIDE)
    counts = np.zeros((2, height, width), dtype=np.float32)
    cells = camera.project(points[judged]) + 0.5
    cells *= np.array([width / camera.width, height / camera.height])
    columns, rows = np.nan_to_num(cells).astype(np.int64).T
    columns, rows = np.clip(columns, 0, width - 1), np.clip(rows, 0, height - 1)
    np.add.at(counts[0], (rows, columns), 1.0)
    np.add.at(counts[1], (rows, columns), differs[judged])
    both, differing = (cv2.GaussianBlur(count, (0, 0), BLUR_CELLS) for count in counts)
    area = differing > LEAST_SHARE * np.maximum(both, 1e-3)
    inside = area[rows, columns].sum()
    return Stranger(area, float(inside / max(1, seen.sum())))
