"""Which pixels of a photo show the object: by a mask, a box, or a plain background."""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from photoreg.errors import InputError
from photoreg.geometry.camera import reduced_size
from photoreg.imaging.colour import convert
from photoreg.imaging.photo import MIN_SIDE_PX, Photo, resized_mask
from photoreg.placing.outcome import Box, How

SIDE_PX = 320
"""Photos are segmented at this many pixels on the longer side at most."""
BORDER_SHARE = 0.03
"""Width of the strip along the frame that shows the background, over the longer side."""
PLAIN_SIGMA = 2.5
"""Most scatter, in units of Lab, of a strip about a smooth surface of colour that is
called plain: slow light and noise stay below it, things do not."""
PLAIN_INLIERS = 0.7
"""Least share of the strip that lies near that surface; objects may touch the frame."""
LEAST_SIGMAS = 3.5
"""Colours nearer to the background than this many sigmas are the background's."""
LEAST_SIGMA = 0.5
"""A made background has no noise at all; a real one always some."""
SMALL_PART = 0.05
"""Parts smaller than this share of the largest one are specks."""
SMALL_HOLE = 0.003
"""Holes smaller than this share of the object are noise, not its shape."""
LEAST_OBJECT, MOST_OBJECT = 0.004, 0.97
"""Shares of a photo beyond which what was found is no object's outline."""
N_CLUSTERS = 14
GRABCUT_ROUNDS = 3
UNSURE_PX = 3
"""A rim so wide of a first guess is left to the cut."""


@dataclasses.dataclass(frozen=True, eq=False)
class Segmentation:
    """The object in a photo, at most ``SIDE_PX`` wide or high."""

    covered: Bool[np.ndarray, "h w"]
    """True where the photo shows the object."""
    how: How
    touches_frame: bool
    """Whether the object goes on beyond the photo."""

    @property
    def is_weak(self) -> bool:
        """Whether the outline is a guess."""
        return self.how == "clutter"


def segment(photo: Photo, box: Box | None = None) -> Segmentation | None:
    """Tells an object from its background.

    A mask says where it is; else a box around it tells what is background; else a plain
    background tells itself by the strip along the frame; else colours that are rare
    there and frequent in the middle are taken for the object's.

    Args:
        photo: The photo.
        box: Around the object, in pixels of the photo, as a person drew it.

    Returns:
        None where nothing stands out.

    References:
        C. Rother et al., "GrabCut", SIGGRAPH 2004, DOI 10.1145/1015706.1015720.

    Raises:
        InputError: if the box does not lie in the photo.
    """
    size = reduced_size(photo.width, photo.height, SIDE_PX, MIN_SIDE_PX)
    pixels = photo.pixels_at(size)
    mask = resized_mask(photo, size)
    if mask is not None:
        return _described(mask, "mask")
    if box is not None:
        return _described(_cut_in_box(pixels, _box_at(box, photo, size)), "box")
    colours = convert(pixels, "lab")
    distance, sigma, inliers = _from_background(colours)
    if sigma < PLAIN_SIGMA and inliers > PLAIN_INLIERS:
        return _described(_cut_from_plain(pixels, distance, sigma), "plain")
    return _described(_cut_by_clusters(pixels, colours), "clutter")


def _described(covered: np.ndarray, how: How) -> Segmentation | None:
    covered = _without_specks(covered)
    if not LEAST_OBJECT < covered.mean() < MOST_OBJECT:
        return None
    # The rows and columns beside the frame: a cut may leave the last one out.
    near = [covered[:2], covered[-2:], covered[:, :2].T, covered[:, -2:].T]
    touching = max(float(side.any(axis=0).mean()) for side in near)
    return Segmentation(covered, how, touching > 0.02)


def _without_specks(covered: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Large parts with large holes."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(covered.astype(np.uint8))
    if count < 2:
        return np.zeros(covered.shape, dtype=bool)
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    kept = (areas >= SMALL_PART * areas.max())[labels]
    count, labels, stats, _ = cv2.connectedComponentsWithStats((~kept).astype(np.uint8))
    areas = stats[:, cv2.CC_STAT_AREA]
    is_hole = areas < SMALL_HOLE * kept.sum()
    is_hole[0] = False
    return kept | is_hole[labels]


def _from_background(
    colours: Float[np.ndarray, "h w 3"],
) -> tuple[Float[np.ndarray, "h w"], float, float]:
    """Distance of each colour from the background's, its scatter, and its share of the strip.

    The background is a quadratic surface of colour, fitted to the strip along the frame
    by least squares that are weighted anew (Cauchy), as parts of the strip may show the
    object.
    """
    height, width = colours.shape[:2]
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    strip = max(2, round(BORDER_SHARE * max(height, width)))
    is_border = np.ones((height, width), dtype=bool)
    is_border[strip:-strip, strip:-strip] = False
    rows, targets = basis[is_border], colours[is_border].astype(np.float64)
    fitted = np.broadcast_to(np.median(targets, axis=0), targets.shape)
    surface, sigma = np.zeros((6, 3)), 0.0
    residual = np.linalg.norm(targets - fitted, axis=1)
    for _ in range(10):
        sigma = max(LEAST_SIGMA, float(np.median(residual)) / 1.5)
        weights = 1.0 / (1.0 + (residual / (2.0 * sigma)) ** 2)
        normal = np.einsum("n,ni,nj->ij", weights, rows, rows) + 1e-6 * np.eye(6)
        right = np.einsum("n,ni,nc->ic", weights, rows, targets)
        surface = np.linalg.solve(normal, right)
        residual = np.linalg.norm(
            targets - np.einsum("ni,ic->nc", rows, surface), axis=1
        )
    inliers = float((residual < LEAST_SIGMAS * sigma).mean())
    background = np.einsum("hwi,ic->hwc", basis, surface)
    return np.linalg.norm(colours - background, axis=2), sigma, inliers


def _cut_from_plain(
    pixels: UInt8[np.ndarray, "h w 3"], distance: Float[np.ndarray, "h w"], sigma: float
) -> Bool[np.ndarray, "h w"]:
    smooth = cv2.GaussianBlur(distance.astype(np.float32), (0, 0), 0.7)
    scale = 255.0 / max(float(smooth.max()), 1e-6)
    otsu, _ = cv2.threshold(
        (smooth * scale).astype(np.uint8), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU
    )
    threshold = max(0.5 * otsu / scale, LEAST_SIGMAS * sigma)
    guess = _without_specks(smooth > threshold)
    return _cut(pixels, guess, np.ones(guess.shape, dtype=bool))


def _cut_in_box(
    pixels: UInt8[np.ndarray, "h w 3"], box: Bool[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    labels = np.where(box, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    return _grabcut(pixels, labels, 5)


def _cut_by_clusters(
    pixels: UInt8[np.ndarray, "h w 3"], colours: Float[np.ndarray, "h w 3"]
) -> Bool[np.ndarray, "h w"]:
    """What has the colours and the grain that are frequent in the middle and rare around."""
    height, width = pixels.shape[:2]
    light = colours[..., 0]
    variance = cv2.GaussianBlur(
        (light - cv2.GaussianBlur(light, (0, 0), 2)) ** 2, (0, 0), 3
    )
    grain = 8.0 * np.log(1.0 + np.sqrt(variance))
    features = np.dstack([colours, grain]).reshape(-1, 4).astype(np.float32)
    cv2.setRNGSeed(0)
    ends = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    start = np.zeros((len(features), 1), np.int32)
    _, labels, _ = cv2.kmeans(
        features, N_CLUSTERS, start, ends, 1, cv2.KMEANS_PP_CENTERS
    )
    labels = labels.reshape(height, width)
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    radius = np.maximum(np.abs(x), np.abs(y))
    shares = [
        np.bincount(labels[region], minlength=N_CLUSTERS) / region.sum()
        for region in (radius < 0.5, radius > 0.85)
    ]
    is_object = shares[0] > 1.5 * shares[1]
    guess = cv2.medianBlur(is_object[labels].astype(np.uint8), 7) > 0
    return _cut(pixels, _without_specks(guess), radius < 0.95)


def _cut(
    pixels: UInt8[np.ndarray, "h w 3"],
    guess: Bool[np.ndarray, "h w"],
    allowed: Bool[np.ndarray, "h w"],
) -> Bool[np.ndarray, "h w"]:
    """A guess whose rim is moved to where colours change."""
    if not 0 < guess.sum() < guess.size:
        return guess
    kernel = np.ones((2 * UNSURE_PX + 1,) * 2, np.uint8)
    core = cv2.erode(guess.astype(np.uint8), kernel, borderValue=1) > 0
    far = cv2.dilate(guess.astype(np.uint8), kernel) == 0
    labels = np.where(guess, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    labels = np.where(core, cv2.GC_FGD, np.where(far | ~allowed, cv2.GC_BGD, labels))
    return _grabcut(pixels, labels.astype(np.uint8), GRABCUT_ROUNDS)


def _grabcut(
    pixels: UInt8[np.ndarray, "h w 3"], labels: UInt8[np.ndarray, "h w"], rounds: int
) -> Bool[np.ndarray, "h w"]:
    is_object = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    if min(is_object.sum(), (~is_object).sum()) < 2 * N_CLUSTERS:
        return is_object
    # The seed is the thread's own.
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    image, no_box = np.ascontiguousarray(pixels), (0, 0, 1, 1)
    cv2.grabCut(image, labels, no_box, *models, rounds, cv2.GC_INIT_WITH_MASK)
    return (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)


def _box_at(box: Box, photo: Photo, size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Pixels of the reduced photo within a box."""
    left, top, width, height = box
    is_inside = (
        np.isfinite(box).all()
        and width > 0.0
        and height > 0.0
        and left < photo.width
        and top < photo.height
        and left + width > 0.0
        and top + height > 0.0
    )
    if not is_inside:
        raise InputError(
            f"{photo.name}: a box of {width:g} x {height:g} px at {left:g}, {top:g} does "
            f"not lie in the photo of {photo.width}x{photo.height} px; give left, top, "
            "width and height in pixels."
        )
    across = (np.arange(size[0]) + 0.5) * photo.width / size[0]
    down = (np.arange(size[1]) + 0.5) * photo.height / size[1]
    return ((down >= top) & (down <= top + height))[:, None] & (
        (across >= left) & (across <= left + width)
    )
