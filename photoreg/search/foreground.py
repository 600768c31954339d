"""Whether the object lies where a photo has the object's colours: a term of the search.

Where the photos show mostly background, colours agree best on the background: cameras
slide off the object and every cost of photo-consistency is content. Here points of the
surface ought to read colours like the object's, points beside it colours like the
surroundings'. Both sides are asked, so neither growing nor shrinking pays.
"""

from collections.abc import Sequence

import cv2
import numba as nb
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection import homogeneous
from photoreg.geometry.surface_view import camera_rays, surface_view
from photoreg.imaging.colour_model import colour_bins, colour_model, object_regions
from photoreg.imaging.photo import Photo, resized_mask
from photoreg.parameters.genes import GeneMap

SIDE_PX = 512
"""Photos are reduced to this many pixels on the longer side at most."""
BAND_SHARE = 0.08
"""Width of the surroundings looked at, as a share of that side: about as far as rough
cameras put the object wrong."""
BLUR_PX = 1.5
N_POINTS = 500
"""Points of each kind a photo."""


class Foreground:
    """How badly cameras put the object where its colours are not."""

    def __init__(
        self, mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera], seed: int
    ) -> None:
        """Learns the colours inside and around the object from rough ``cameras``.

        The object is off by some pixels there: both sides hold some of the other's
        colours, which makes them more alike, not wrong.
        """
        rng = np.random.default_rng(seed)
        points, self._scales = [], []
        self._images = []
        for photo, camera in zip(photos, cameras, strict=True):
            small = camera.reduced(SIDE_PX, least_px=16)
            view = surface_view(mesh, small)
            band_px = BAND_SHARE * max(small.width, small.height)
            self._images.append(_evidence(photo, view.covered, band_px))
            nearest, around = around_object(view.covered)
            for region in (view.covered, around):
                rows, columns = np.nonzero(region)
                if len(rows) == 0:
                    points.append(np.full((1, 3), np.nan))
                    continue
                chosen = rng.integers(0, len(rows), N_POINTS)
                rows, columns = rows[chosen], columns[chosen]
                depth = view.depth[tuple(nearest[:, rows, columns])]
                origins, rays = camera_rays(
                    small, np.column_stack([columns, rows]).astype(np.float64)
                )
                points.append(origins + depth[:, None] * rays)
            self._scales.append(
                (small.width / camera.width, small.height / camera.height)
            )
        self._points = np.concatenate(points)
        self._starts = np.cumsum([0, *(len(p) for p in points)])

    def misfits(
        self, genes: Float[np.ndarray, "p g"], gene_map: GeneMap
    ) -> Float[np.ndarray, "p"]:
        """Of each individual: 0 all as it should be, 1 chance, 2 all wrong."""
        P = gene_map.poses(genes).P
        total = np.zeros(len(genes))
        for i, (image, (sx, sy)) in enumerate(
            zip(self._images, self._scales, strict=True)
        ):
            # Pixel centres: x_new = (x + 1/2) scale - 1/2.
            reduce = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
            first, middle, last = self._starts[2 * i : 2 * i + 3]
            total += mean_evidence_gap(
                np.ascontiguousarray(reduce @ P[:, i]),
                self._points[first:middle],
                self._points[middle:last],
                image,
            )
        return 1.0 - 0.5 * total / len(self._images)


def around_object(
    covered: Bool[np.ndarray, "h w"],
) -> tuple[Int[np.ndarray, "2 h w"], Bool[np.ndarray, "h w"]]:
    """Row and column of the covered pixel nearest to each pixel, and which are near one.

    Near, but not covered themselves: within ``BAND_SHARE`` of the longer side.
    """
    nearest = np.asarray(
        distance_transform_edt(~covered, return_distances=False, return_indices=True)
    )
    rows, columns = np.indices(covered.shape)
    gap = np.hypot(nearest[0] - rows, nearest[1] - columns)
    return nearest, (gap > 0.0) & (gap <= BAND_SHARE * max(covered.shape))


def _evidence(
    photo: Photo, covered: np.ndarray, band_px: float
) -> Float[np.ndarray, "h w"]:
    """Of each pixel: 1 surely the object's colour, -1 surely the surroundings'.

    0 where the photo does not count.
    """
    size = (covered.shape[1], covered.shape[0])
    values = cv2.GaussianBlur(photo.pixels_at(size).astype(np.float32), (0, 0), BLUR_PX)
    mask = resized_mask(photo, size)
    regions = object_regions(covered, band_px)
    log_ratio = colour_model(colour_bins(values), regions, mask).of(values)
    evidence = np.tanh(0.5 * log_ratio)
    if mask is not None:
        evidence = np.where(mask, evidence, 0.0)
    return np.ascontiguousarray(evidence, dtype=np.float32)


@nb.njit(parallel=True, cache=True, nogil=True)
def mean_evidence_gap(projections, inside, outside, image):  # noqa: ANN001, ANN201
    """Mean evidence at ``inside`` less that at ``outside``, for each projection (p, 3, 4).

    Points that leave the picture count as without evidence.
    """
    height, width = image.shape
    out = np.zeros(len(projections))
    for individual in nb.prange(len(projections)):
        P = projections[individual]
        gap = 0.0
        for sign in (1.0, -1.0):
            points = inside if sign > 0.0 else outside
            total = 0.0
            for i in range(len(points)):
                x, y, z = points[i, 0], points[i, 1], points[i, 2]
                u, v, depth = homogeneous(P, x, y, z)
                if not depth > 0.0:
                    continue
                u, v = u / depth, v / depth
                if 0.0 <= u < width - 1.0 and 0.0 <= v < height - 1.0:
                    # Between pixels: the nearest one's would jump at a last digit.
                    column, row = int(u), int(v)
                    s, t = u - column, v - row
                    above = (1.0 - s) * image[row, column] + s * image[row, column + 1]
                    row += 1
                    below = (1.0 - s) * image[row, column] + s * image[row, column + 1]
                    total += (1.0 - t) * above + t * below
            gap += sign * total / len(points)
        out[individual] = gap
    return out
