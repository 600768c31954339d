"""What two photos show of the same places: patches carried over the surface, matched.

One photo is carried over the surface into the other's frame, so that both are seen from
one place and differ by small shifts only, and by exposure. Each patch's shift is found to a
fraction of a pixel, normalised for gain and offset, which slow changes of light and
exposure cannot bend as they bend plain differences of colours.
"""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import SurfaceView, camera_rays
from photoreg.imaging.photo import Photo, resized_mask
from photoreg.polish.patch_kernels import match_patches, sampled

BLURS_PX = (1.2, 0.7)
"""Blur of both passes; the first is at half the size."""
ITERATIONS = (8, 6)
"""Steps of each pass at most."""
MARGIN_PX = 2.0
"""Pixels nearer than this to a jump of depth in either view are left out."""
NORMAL_BLUR_PX = 2.5
"""How far the surface's normals are evened out."""
DEPTH_TOLERANCE = 0.003
"""What is farther than the surface by more than this share of its depth is hidden."""
MIN_CORRELATION = 0.5
"""Patches less alike than this do not show the same place."""
STRIDE_PX = 10
"""Distance of the patches' centres, at least."""
NOISE_FACTOR = 0.5 * 4.0 * np.pi * BLURS_PX[1] ** 2
"""Variance of a patch's shift over residual variance times inverse structure tensor: the
window counts pixels by half, and the blur makes the noise of neighbours one."""
SIGMAS_PX = (0.05, 3.0)
"""Least and largest standard error of a shift."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Correspondences:
    """Places of the surface where one photo shows what the other does elsewhere."""

    points: Float[np.ndarray, "n 3"]
    """On the surface, world axes: what the other photo shows at ``other_px``."""
    own_px: Float[np.ndarray, "n 2"]
    """Where the own photo shows the same, in pixels of its view."""
    shifts_px: Float[np.ndarray, "n"]
    """How far that is from where the cameras have it."""
    other_px: Float[np.ndarray, "n 2"]
    """In pixels of the other's view."""
    transfer: Float[np.ndarray, "n 2 2"]
    """Derivative of the own pixel by the other one along the surface."""
    along_normal: Float[np.ndarray, "n 2"]
    """What a unit of the surface's error along its normal moves the own pixel: along the
    epipolar line, in pixels per model unit."""
    covariance: Float[np.ndarray, "n 2 2"]
    """Of ``own_px``, by the noise of both photos."""
    n_looked_for: int
    """Patches that both photos see."""
    stride_px: int
    """Distance of the patches' centres."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class _Carried:
    """One photo carried into the other's frame."""

    rows: Int[np.ndarray, "m"]
    columns: Int[np.ndarray, "m"]
    points: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "m 3"]
    other_px: Float[np.ndarray, "m 2"]
    valid: Bool[np.ndarray, "h w"]
    values: Float[np.ndarray, "h w"]
    """Grey levels of 255; 0 where not valid."""


def find_correspondences(
    mesh: Mesh,
    own: tuple[Photo, SurfaceView],
    other: tuple[Photo, SurfaceView],
    n_patches: int,
    min_cosine: float,
) -> Correspondences:
    """Patches of ``other``, carried over the surface, found in ``own``.

    Args:
        mesh: The surface.
        own: The photo that is searched, and what its camera sees.
        other: The photo whose patches are looked for.
        n_patches: At most about so many.
        min_cosine: Least cosine between the surface's normal and either view.
    """
    view = own[1]
    carried = _carry(mesh, own, other, min_cosine)
    picture = _grey(own[0], view)
    stride = max(
        STRIDE_PX, int(np.ceil(np.sqrt(carried.valid.sum() / max(n_patches, 1))))
    )
    index = np.flatnonzero(
        (carried.rows % stride == stride // 2)
        & (carried.columns % stride == stride // 2)
    )
    centres = np.column_stack([carried.columns[index], carried.rows[index]]).astype(
        np.int64
    )
    half = (max(1, view.camera.width // 2), max(1, view.camera.height // 2))
    coarse_valid = (
        cv2.resize(carried.valid.astype(np.float32), half, interpolation=cv2.INTER_AREA)
        > 0.99
    )
    starts = np.zeros((len(index), 2))
    # At half the size first, which widens the reach.
    coarse, target = (
        cv2.resize(
            _blurred(image, carried.valid, BLURS_PX[0]),
            half,
            interpolation=cv2.INTER_AREA,
        )
        for image in (carried.values, picture)
    )
    found = match_patches(
        coarse, target, coarse_valid, centres // 2, starts, ITERATIONS[0]
    )
    starts[:] = np.where(
        (found[:, 2] > MIN_CORRELATION)[:, None], 2.0 * found[:, :2], np.nan
    )
    fine, target = (
        _blurred(image, carried.valid, BLURS_PX[1])
        for image in (carried.values, picture)
    )
    found = match_patches(fine, target, carried.valid, centres, starts, ITERATIONS[1])
    good = found[:, 2] > MIN_CORRELATION
    index, found = index[good], found[good]
    points, normals = carried.points[index], carried.normals[index]
    D_own = surface_derivative(view.camera, points)
    D_other = surface_derivative(other[1].camera, points)
    transfer = _transfer(D_own, D_other, normals)
    by_own, by_other = (np.einsum("nij,nj->ni", D, normals) for D in (D_own, D_other))
    return Correspondences(
        points=points,
        own_px=centres[good] + found[:, :2],
        shifts_px=np.hypot(found[:, 0], found[:, 1]),
        other_px=carried.other_px[index],
        transfer=transfer,
        along_normal=by_own - np.einsum("nij,nj->ni", transfer, by_other),
        covariance=_covariances(found),
        n_looked_for=len(centres),
        stride_px=stride,
    )


def surface_derivative(
    camera: Camera, points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2 3"]:
    """Derivative of the pixels of world points, by central differences."""
    step = (
        1e-5 * float(np.linalg.norm(points - camera.center, axis=1).mean())
        if len(points)
        else 1.0
    )
    columns = []
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        ahead, behind = camera.project(points + shift), camera.project(points - shift)
        columns.append((ahead - behind) / (2.0 * step))
    return np.stack(columns, axis=2)


def _transfer(
    D_own: np.ndarray, D_other: np.ndarray, normals: np.ndarray
) -> Float[np.ndarray, "n 2 2"]:
    """Derivative of the own pixel by the other one along the tangent plane."""
    # Two tangents, whichever.
    helper = np.where(
        np.abs(normals[:, :1]) > 0.6, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]
    )
    first = np.cross(normals, helper)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    tangents = np.stack([first, np.cross(normals, first)], axis=2)
    return (D_own @ tangents) @ np.linalg.pinv(D_other @ tangents)


def _covariances(found: np.ndarray) -> Float[np.ndarray, "n 2 2"]:
    tensor = np.stack([found[:, [3, 4]], found[:, [4, 5]]], axis=1)
    values, vectors = np.linalg.eigh(tensor)
    variance = NOISE_FACTOR * found[:, 6:7] / np.maximum(values, 1e-12)
    variance = np.clip(variance, SIGMAS_PX[0] ** 2, SIGMAS_PX[1] ** 2)
    return np.einsum("nik,nk,njk->nij", vectors, variance, vectors)


def _grey(photo: Photo, view: SurfaceView) -> Float[np.ndarray, "h w"]:
    """The photo at the view's size, grey: chroma is coarser, and hardly adds to it."""
    size = (view.camera.width, view.camera.height)
    pixels = photo.pixels_at(size).astype(np.float32)
    return cv2.transform(pixels, np.full((1, 3), 1.0 / 3.0))


def _carry(
    mesh: Mesh,
    own: tuple[Photo, SurfaceView],
    other: tuple[Photo, SurfaceView],
    min_cosine: float,
) -> _Carried:
    """``other`` as the own camera would see it: only what both see, and masks leave."""
    (own_photo, view), (other_photo, far) = own, other
    allowed = view.inner > MARGIN_PX
    mask = resized_mask(own_photo, (view.camera.width, view.camera.height))
    if mask is not None:
        allowed &= mask
    rows, columns = np.nonzero(allowed)
    pixels = np.column_stack([columns, rows]).astype(np.float64)
    origins, directions = camera_rays(view.camera, pixels)
    points = (
        origins + view.depth[rows, columns][:, None].astype(np.float64) * directions
    )
    normals = _normals(mesh, view)[rows, columns]
    at = far.camera.project(points)
    width, height = far.camera.width, far.camera.height
    # A pixel and a half short of the border, where cubic sampling ends.
    keep = (
        (at[:, 0] >= 1.5)
        & (at[:, 1] >= 1.5)
        & (at[:, 0] <= width - 2.5)
        & (at[:, 1] <= height - 2.5)
    )
    for camera in (view.camera, far.camera):
        towards = camera.center - points
        cosine = np.einsum("ij,ij->i", normals, towards)
        keep &= cosine > min_cosine * np.linalg.norm(towards, axis=1)
    index = np.flatnonzero(keep)
    near = np.rint(at[index]).astype(np.int64)
    seen = far.inner[near[:, 1], near[:, 0]] > MARGIN_PX
    far_mask = resized_mask(other_photo, (width, height))
    if far_mask is not None:
        seen &= far_mask[near[:, 1], near[:, 0]]
    index = index[seen]
    # Inverse depth is linear in the picture.
    nearness = np.where(far.covered, 1.0 / far.depth, 0.0).astype(np.float32)
    there = nearness[near[seen, 1], near[seen, 0]]
    depth = far.camera.to_camera(points[index])[:, 2]
    tolerance = max(DEPTH_TOLERANCE, 2.0 / far.camera.focal_px)
    index = index[depth * there < 1.0 + tolerance]
    values = np.zeros(view.covered.shape, np.float32)
    values[rows[index], columns[index]] = sampled(_grey(other_photo, far), at[index])
    valid = np.zeros(view.covered.shape, bool)
    valid[rows[index], columns[index]] = True
    return _Carried(
        rows=rows[index],
        columns=columns[index],
        points=points[index],
        normals=normals[index],
        other_px=at[index],
        valid=valid,
        values=values,
    )


def _normals(mesh: Mesh, view: SurfaceView) -> Float[np.ndarray, "h w 3"]:
    """Unit normals as the view sees them, evened out over neighbouring pixels."""
    seen = np.zeros((*view.covered.shape, 3), np.float32)
    seen[view.covered] = mesh.face_normals[view.face_index[view.covered]]
    seen = cv2.GaussianBlur(seen, (0, 0), NORMAL_BLUR_PX)
    return seen / np.maximum(np.linalg.norm(seen, axis=2, keepdims=True), 1e-6)


def _blurred(
    values: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"], sigma_px: float
) -> Float[np.ndarray, "h w"]:
    """Blurred within ``valid`` only, where the photos show one surface."""
    cover = valid.astype(np.float32)
    weight = np.maximum(cv2.GaussianBlur(cover, (0, 0), sigma_px), 1e-3)
    middle = float(values[valid].mean()) if valid.any() else 0.0
    return cv2.GaussianBlur((values - middle) * cover, (0, 0), sigma_px) / weight
