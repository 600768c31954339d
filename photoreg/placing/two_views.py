"""What two photos tell of each other without a mesh: points in space, up to scale.

Features that look alike are matched, the essential matrix that most of them obey gives the
second camera relative to the first, and the matches are triangulated.
"""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from photoreg.geometry.camera import Camera, centred_camera, reduced_size
from photoreg.geometry.rotations import rotation_matrix
from photoreg.imaging.photo import MIN_SIDE_PX, Photo, resized_mask

SIDE_PX = 1024
"""Features are looked for at this many pixels on the longer side at most."""
N_FEATURES = 6_000
LEAST_CONTRAST = 0.005
"""An eighth of the usual: what is dull has features, too, and matching tells which are sound."""
CELL_PX = 64
RATIO = 0.8
"""Most distance of a match over that of the next best (Lowe)."""
THRESHOLD_PX = 1.0
"""Scale of the distance from the epipolar line."""
LEAST_MATCHES = 30
"""Fewer matches than this agree by chance on some geometry."""
LEAST_ANGLE_DEG = 1.0
"""Rays that cross at less do not tell how far a point is."""
MOST_ERROR_PX = 2.0
"""Points that are farther from where the photos show them were no match."""


@dataclasses.dataclass(frozen=True, eq=False)
class Features:
    """Places in a photo that are known again, and what they look like."""

    pixels: Float[np.ndarray, "n 2"]
    """In pixels of the photo at its full size."""
    descriptors: Float[np.ndarray, "n 128"]


@dataclasses.dataclass(frozen=True, eq=False)
class TwoViews:
    """Two cameras and points in the axes of the first, in units of their distance."""

    cameras: tuple[Camera, Camera]
    """The first stands in the origin."""
    points: Float[np.ndarray, "n 3"]
    places: Float[np.ndarray, "m 2"]
    """Where the first photo shows what both show; more than the points, as some of it is too
    far to be located."""
    places_in_second: Float[np.ndarray, "m 2"]


def features_of(photo: Photo) -> Features:
    """The SIFT features of a photo, of what its mask lets count.

    References:
        D. G. Lowe, IJCV 60(2), 2004, DOI 10.1023/B:VISI.0000029664.99615.94.
    """
    size = reduced_size(photo.width, photo.height, SIDE_PX, MIN_SIDE_PX)
    grey = cv2.cvtColor(photo.pixels_at(size), cv2.COLOR_RGB2GRAY)
    sift = cv2.SIFT.create(0, contrastThreshold=LEAST_CONTRAST)
    mask = resized_mask(photo, size)
    counts = None if mask is None else mask.astype(np.uint8)
    found = _spread(sift.detect(grey, counts), size)
    found, descriptors = sift.compute(grey, found)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    scale = np.array([photo.width, photo.height]) / size
    pixels = (np.array([one.pt for one in found]) + 0.5) * scale - 0.5
    return Features(pixels, descriptors)


def _spread(found: Sequence[cv2.KeyPoint], size: tuple[int, int]) -> list[cv2.KeyPoint]:
    """The strongest of each cell: else surroundings rich in contrast are all there is."""
    across, down = (-(-side // CELL_PX) for side in size)
    per_cell = -(-N_FEATURES // (across * down))
    cells: dict[tuple[int, int], list[cv2.KeyPoint]] = {}
    for one in sorted(found, key=lambda one: -one.response):
        cell = cells.setdefault(
            (int(one.pt[0]) // CELL_PX, int(one.pt[1]) // CELL_PX), []
        )
        if len(cell) < per_cell:
            cell.append(one)
    return [one for cell in cells.values() for one in cell]


def matched(a: Features, b: Features) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n, 2) of both photos at features that are each other's nearest."""
    if min(len(a.pixels), len(b.pixels)) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    forth = _nearest(a.descriptors, b.descriptors)
    back = _nearest(b.descriptors, a.descriptors)
    pairs = [(i, k) for i, k in forth.items() if back.get(k) == i]
    # A place with several directions is one match.
    index = np.array(sorted(pairs), dtype=int).reshape(-1, 2)
    both = np.hstack([a.pixels[index[:, 0]], b.pixels[index[:, 1]]])
    both = np.unique(both, axis=0)
    return both[:, :2], both[:, 2:]


def _nearest(a: np.ndarray, b: np.ndarray) -> dict[int, int]:
    found = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a, b, k=2)
    return {
        first.queryIdx: first.trainIdx
        for first, second in found
        if first.distance < RATIO * second.distance
    }


def two_views(
    photos: tuple[Photo, Photo],
    matches: tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]],
    focals_px: tuple[float, float],
) -> TwoViews | None:
    """The relative pose of two photos and the points that both show.

    Args:
        photos: Both photos.
        matches: Pixels of places that look alike.
        focals_px: Their focal lengths; principal points are taken for central.

    Returns:
        None where too little agrees on one geometry.

    References:
        D. Nister, PAMI 26(6), 2004, DOI 10.1109/TPAMI.2004.17; D. Barath et al.,
        "MAGSAC++", CVPR 2020, DOI 10.1109/CVPR42600.2020.00138.
    """
    if len(matches[0]) < LEAST_MATCHES:
        return None
    first, second = (
        centred_camera(focal_px, photo.width, photo.height)
        for photo, focal_px in zip(photos, focals_px, strict=True)
    )
    a, b = (
        (pixels - camera.K[:2, 2]) / camera.focal_px
        for pixels, camera in zip(matches, (first, second), strict=True)
    )
    scale_px = [max(p.width, p.height) / SIDE_PX for p in photos]
    threshold = THRESHOLD_PX * float(
        np.mean([s / f for s, f in zip(scale_px, focals_px, strict=True)])
    )
    E, kept = cv2.findEssentialMat(
        a, b, np.eye(3), method=cv2.USAC_MAGSAC, prob=0.9999, threshold=threshold
    )
    if E is None or E.shape != (3, 3) or kept.sum() < LEAST_MATCHES:
        return None
    is_kept = kept.ravel().astype(bool)
    _, R, t, _ = cv2.recoverPose(E, a[is_kept], b[is_kept], np.eye(3))
    R, t = _polished(a[is_kept], b[is_kept], R, t.ravel(), threshold)
    second = dataclasses.replace(second, R_cam_world=R, t_cam_world=t)
    points, is_sound = _triangulated(a, b, R, t, MOST_ERROR_PX * threshold)
    if is_sound.sum() < LEAST_MATCHES:
        return None
    sampson = np.abs(_sampson(a, b, R, t)) < 3.0 * threshold
    return TwoViews(
        (first, second), points[is_sound], matches[0][sampson], matches[1][sampson]
    )


def _sampson(a: np.ndarray, b: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Distances from the epipolar constraint, to first order, in ideal coordinates."""
    across = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    E = across @ R
    lines = a @ E[:, :2].T + E[:, 2]
    back = b @ E[:2] + E[2]
    value = (b * lines[:, :2]).sum(axis=1) + lines[:, 2]
    slope = (lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return value / np.sqrt(np.maximum(slope, 1e-12))


def _polished(
    a: np.ndarray, b: np.ndarray, R: np.ndarray, t: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray]:
    """The relative pose that all matches agree on best."""
    axes = np.linalg.svd(t[None])[2][1:]

    def pose(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = t + x[3:] @ axes
        return rotation_matrix(x[:3]) @ R, moved / np.linalg.norm(moved)

    end = least_squares(
        lambda x: _sampson(a, b, *pose(x)),
        np.zeros(5),
        loss="cauchy",
        f_scale=threshold,
        max_nfev=20,
    )
    return pose(end.x)


def _triangulated(
    a: np.ndarray, b: np.ndarray, R: np.ndarray, t: np.ndarray, most_error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) in the first camera's axes, and which of them are located."""
    rays_a = np.column_stack([a, np.ones(len(a))])
    rays_b = np.column_stack([b, np.ones(len(b))]) @ R
    rays_a /= np.linalg.norm(rays_a, axis=1, keepdims=True)
    rays_b /= np.linalg.norm(rays_b, axis=1, keepdims=True)
    center = -R.T @ t
    cosine = (rays_a * rays_b).sum(axis=1)
    sine2 = np.maximum(1.0 - cosine**2, 1e-12)
    along_a, along_b = rays_a @ center, rays_b @ center
    # The middle between the rays where they are nearest.
    reach_a = (along_a - cosine * along_b) / sine2
    reach_b = (cosine * along_a - along_b) / sine2
    points = 0.5 * (reach_a[:, None] * rays_a + center + reach_b[:, None] * rays_b)
    in_b = points @ R.T + t
    is_sound = (
        (reach_a > 0.0)
        & (reach_b > 0.0)
        & (points[:, 2] > 0.0)
        & (in_b[:, 2] > 0.0)
        & (np.sqrt(sine2) > np.sin(np.radians(LEAST_ANGLE_DEG)))
    )
    for seen, shown in ((points, a), (in_b, b)):
        depth = np.where(is_sound, seen[:, 2], 1.0)
        error = np.linalg.norm(seen[:, :2] / depth[:, None] - shown, axis=1)
        is_sound &= error < most_error
    return points, is_sound
