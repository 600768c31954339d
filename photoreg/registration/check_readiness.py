"""Whether photos and rough cameras can be refined at all, checked beforehand."""

import itertools
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import surface_view
from photoreg.geometry.visibility import samples_for, visible
from photoreg.geometry.winding import facing_cameras
from photoreg.imaging.photo import Photo
from photoreg.polish.silhouette_term import SEGMENT_POINTS, find_edges, find_rim
from photoreg.registration.readiness import FEW, Readiness

N_SAMPLES = 3_000
"""Shares of the surface are then right to 1 % (one standard error, at a half)."""
MIN_COSINE = 0.25
"""Surface seen at a flatter angle than 75 degrees does not count as seen."""


MIN_UNMASKED = 0.025
"""Least share of the surface in a photo that its mask leaves: the polish compares no
photos over fewer than 200 of its 8,000 points."""

RIM_POINTS = 1200
MIN_EDGES = 4 * SEGMENT_POINTS
"""Fewer rim points with an edge than this are no outline to the polish."""
EDGE_REACH_PX = 20.0
"""How far edges are looked for, in pixels of a photo reduced to 512: as far as the
coarsest level of the polish does."""

SIDE_PX = 512
FINE_PX, COARSE_PX = 1.0, 6.0
"""Texture is what lies between these two blurs, in pixels of a photo reduced to 512."""

MIN_CONTRAST = 1.0
"""Least texture, in grey levels of 255, with which photos can be seen to agree.

A made rock in flat light, by its colours alone, from 5.4 px off: without any texture the
photos' noise measures 0.5; at 0.8 the cameras stay where they were, at 1.2 they come to
0.7 px, at 4 to 0.3 px. The real and rendered sets of the README measure 3.1 (the head's
skin) to 35."""


def check_readiness(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> Readiness:
    """Looks at overlap, visibility and texture; about 20 ms.

    Args:
        mesh: The surface.
        photos: The photos to refine.
        cameras: One camera a photo, for its full size.

    Raises:
        InputError: if there are not as many cameras as photos.
    """
    if len(photos) != len(cameras):
        raise InputError(
            f"There are {len(photos)} photos but {len(cameras)} cameras; give one camera "
            "per photo."
        )
    mesh = facing_cameras(mesh, cameras)
    samples = samples_for(mesh, cameras, N_SAMPLES, 0)
    seen = visible(samples, cameras, mesh, "rays", MIN_COSINE)
    masked, counted = [], []
    for photo, camera, own in zip(photos, cameras, seen, strict=True):
        counted.append(own & _in_mask(photo, camera, samples.points))
        if counted[-1].sum() < MIN_UNMASKED * own.sum():
            masked.append(photo.name)
    facing, seen = seen, np.array(counted)
    either, shared = seen.any(axis=0), seen.sum(axis=0) >= 2
    blind, alone, plain, featureless = [], [], [], []
    for photo, camera, in_view, own in zip(photos, cameras, facing, seen, strict=True):
        if not in_view.any():
            blind.append(photo.name)
            continue
        if photo.name in masked:
            continue
        with_others = own & shared
        if len(photos) > 1 and with_others.sum() < FEW * own.sum():
            alone.append(photo.name)
        points = samples.points[with_others if with_others.any() else own]
        if texture_contrast(photo, camera, points) < MIN_CONTRAST:
            plain.append(photo.name)
            # A camera far off sees nothing either, where the photo shows background.
            if is_uniform(photo) and _n_edges(mesh, photo, camera) < MIN_EDGES:
                featureless.append(photo.name)
    overlap = float(shared.sum() / max(1, either.sum()))
    return Readiness(
        overlap=overlap if len(photos) > 1 else None,
        blind=tuple(blind),
        alone=tuple(alone),
        plain=tuple(plain),
        masked=tuple(masked),
        featureless=tuple(featureless),
        same=tuple(
            (one.name, other.name)
            for one, other in itertools.combinations(photos, 2)
            if _is_same_picture(one, other)
        ),
    )


def _in_mask(
    photo: Photo, camera: Camera, points: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    """Whether the photo counts where it shows the points; true where it does not."""
    if photo.mask is None:
        return np.ones(len(points), dtype=bool)
    pixels = np.nan_to_num(camera.project(points), nan=-1.0)
    inside = camera.contains(pixels)
    columns, rows = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(int).T
    return ~inside | photo.mask[rows, columns]


def _n_edges(mesh: Mesh, photo: Photo, camera: Camera) -> int:
    """How many points of the mesh's rim have an edge of the photo within reach."""
    small = photo.resized(SIDE_PX)
    view = surface_view(mesh, camera.resized(small.width, small.height))
    rim = find_rim(mesh, view, RIM_POINTS)
    if len(rim.points) < MIN_EDGES:
        return 0
    edges = find_edges(
        small, view, rim, EDGE_REACH_PX * max(view.covered.shape) / SIDE_PX
    )
    return int(np.isfinite(edges.offset_px).sum())


def _is_same_picture(one: Photo, other: Photo) -> bool:
    a, b = one.pixels, other.pixels
    # A few rows first: other photos differ there, and large ones take time.
    return (
        a.shape == b.shape and np.array_equal(a[::64], b[::64]) and np.array_equal(a, b)
    )


def texture_contrast(
    photo: Photo, camera: Camera, points: Float[np.ndarray, "n 3"]
) -> float:
    """Contrast of a photo's detail at surface points it sees, beyond its noise.

    Returns:
        A robust standard deviation, in grey levels of 255.
    """
    detail, noise = _detail(photo)
    height, width = detail.shape
    pixels = camera.resized(width, height).project(points)
    columns, rows = np.rint(pixels).astype(int).T
    inside: Bool[np.ndarray, "n"] = (
        (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    )
    if not inside.any():
        return 0.0
    values = np.abs(detail[rows[inside], columns[inside]])
    contrast = 1.48 * float(np.median(values))
    return float(np.sqrt(max(0.0, contrast**2 - noise**2)))


def is_uniform(photo: Photo) -> bool:
    """Whether a photo shows nothing anywhere, as a black or a white one."""
    detail, noise = _detail(photo)
    # Of normal noise one pixel in ten million is beyond five standard deviations.
    return float(np.abs(detail).max()) < max(MIN_CONTRAST, 5.0 * noise)


def _detail(photo: Photo) -> tuple[Float[np.ndarray, "h w"], float]:
    """A reduced photo's detail, and what white noise of its strength leaves there.

    Both in grey levels of 255.
    """
    grey = cv2.cvtColor(photo.resized(SIDE_PX).pixels, cv2.COLOR_RGB2GRAY)
    grey = grey.astype(np.float32)
    detail = cv2.GaussianBlur(grey, (0, 0), FINE_PX)
    detail -= cv2.GaussianBlur(grey, (0, 0), COARSE_PX)
    # White noise, after the finer blur.
    return detail, _noise_levels(grey) / (2.0 * np.sqrt(np.pi) * FINE_PX)


def _noise_levels(grey: np.ndarray) -> float:
    """Standard deviation of white noise, from what no smooth picture has.

    References:
        J. Immerkaer, Fast Noise Variance Estimation, CVIU 64(2), 1996; its mean is
        replaced by a median, which edges and texture hardly move.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    response = np.abs(cv2.filter2D(grey, cv2.CV_32F, mask))
    return float(np.median(response)) / (0.6745 * 6.0)
