"""Where a photo may be used for a texture: on the object, off its edges, in its mask."""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from photoreg.geometry.camera import Camera, reduced_size
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo
from photoreg.texture import kernels

EDGE_JUMP_PX = 5.0
"""A step in depth of less than so many pixels hides nothing that a photo registered
to a pixel would show otherwise; rough surfaces are full of such steps."""
SPILL_SIDE_PX = 1024
"""Longer side of the picture in which background on the mesh is looked for."""
SPILL_REACH = 0.01
"""How far over the mesh's outline the background is looked for, as a share of the
photo's longer side: meshes from photos are some pixels too fat."""
SPILL_CONTRAST = 3.0
"""Least distance between the colours within and outside, in standard deviations of
them: where they are alike, nothing can be told and nothing shows."""
NOISE = 6.0
"""Grey levels by which even equal colours differ."""


@dataclasses.dataclass(frozen=True, eq=False)
class PreparedPhoto:
    """A photo ready to be sampled."""

    camera: Camera
    """Its camera, for the size of these pixels, without a lens."""
    pixels: UInt8[np.ndarray, "h w 3"]
    """The photo, undistorted."""
    depth: Float[np.ndarray, "h w"]
    """Depth of the surface at each pixel, float32; infinity where there is none."""
    clearance: UInt8[np.ndarray, "h w"]
    """0 too near to an edge, the border or the mask's end to be used, 255 far off."""
    low: Float[np.ndarray, "hl wl 3"]
    """The photo blurred, on a coarse grid, float32."""


def find_usable_area(
    mesh: Mesh, photo: Photo, camera: Camera, margin: float, feather: float
) -> PreparedPhoto:
    """Finds where a photo may be used, undistorted.

    Args:
        mesh: The surface.
        photo: The photo, of any size.
        camera: Its camera; adapted to the photo's size.
        margin: Nearest to an edge that colours are taken, as a share of the longer
            side, but at least 2 pixels.
        feather: Share of that side over which the photo's weight grows from there.
    """
    photo = undistorted_photo(photo, camera)
    camera = camera.resized(photo.width, photo.height).pinhole
    buffer = render_geometry(mesh, camera)
    edges = kernels.photo_edges(
        buffer.depth,
        buffer.face_index,
        mesh.face_normals,
        np.linalg.inv(camera.K).T @ camera.R_cam_world,
        camera.focal_px,
        EDGE_JUMP_PX,
    )
    edges |= spilt_background(photo.pixels, buffer.covered)
    if photo.mask is not None:
        edges |= ~photo.mask
    side = max(photo.width, photo.height)
    # A frame of edges: the photo's border is one too.
    framed = cv2.copyMakeBorder(
        (~edges).view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0
    )
    distance = cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1]
    margin_px = max(2.0, margin * side)
    clearance = kernels.clearance_of(distance, margin_px, max(1.0, feather * side))
    return PreparedPhoto(
        camera,
        photo.pixels,
        buffer.depth,
        clearance,
        _low_band(photo.pixels, clearance, side),
    )


def spilt_background(
    pixels: UInt8[np.ndarray, "h w 3"], covered: Bool[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Pixels on the mesh that show the background: the object ends before the mesh does.

    Meshes from photos are fat, and cameras off by part of a pixel. So along the outline
    each pixel's colour is compared with those farther in and those outside, both as
    they are nearby; what looks like the background, and hangs together with it, is.

    Args:
        pixels: The photo.
        covered: Where the mesh is.
    """
    size = reduced_size(pixels.shape[1], pixels.shape[0], SPILL_SIDE_PX)
    on = cv2.resize(covered.view(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    if on.all() or not on.any():
        return np.zeros(covered.shape, dtype=bool)
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    reach_px = max(3.0, SPILL_REACH * max(size))
    depth_in = cv2.distanceTransform(on, cv2.DIST_L2, 3)
    depth_out = cv2.distanceTransform(1 - on, cv2.DIST_L2, 3)
    y, x = np.nonzero((on > 0) & (depth_in <= reach_px))
    within = _nearby(small, depth_in > reach_px, x, y, 2.0 * reach_px)
    outside = _nearby(small, depth_out > 2.0, x, y, 2.0 * reach_px)
    gap = ((within.mean - outside.mean) ** 2).sum(axis=1)
    is_distinct = gap > SPILL_CONTRAST**2 * (within.variance + outside.variance)
    is_known = (within.weight > 1e-3) & (outside.weight > 1e-3)
    asked = small[y, x]
    is_spilt = is_known & is_distinct & (outside.misfit(asked) < within.misfit(asked))
    spilt = np.zeros(on.shape, dtype=bool)
    spilt[y[is_spilt], x[is_spilt]] = True
    # What is like the background but apart from it is a spot on the object.
    labels = cv2.connectedComponents((spilt | (on == 0)).astype(np.uint8))[1]
    is_outside = np.zeros(labels.max() + 1, dtype=bool)
    is_outside[labels[on == 0]] = True
    spilt &= is_outside[labels]
    whole = cv2.resize(
        spilt.view(np.uint8), covered.shape[::-1], interpolation=cv2.INTER_NEAREST
    )
    return (whole > 0) & covered


@dataclasses.dataclass(frozen=True, eq=False)
class _Nearby:
    """Mean and spread of a region's colours around each of some pixels."""

    mean: Float[np.ndarray, "n 3"]
    variance: Float[np.ndarray, "n"]
    """Of a channel."""
    weight: Float[np.ndarray, "n"]
    """Share of the region in the neighbourhood."""

    def misfit(self, colours: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """How unlikely the colours are there: -log of a normal density."""
        squares = ((colours - self.mean) ** 2).sum(axis=1)
        return 0.5 * squares / self.variance + 1.5 * np.log(self.variance)


def _nearby(
    pixels: Float[np.ndarray, "h w 3"],
    region: Bool[np.ndarray, "h w"],
    x: Int[np.ndarray, "n"],
    y: Int[np.ndarray, "n"],
    sigma_px: float,
) -> _Nearby:
    # On a coarse grid: so wide a blur holds nothing finer.
    step = max(1, int(sigma_px / 3.0))
    height, width = region.shape
    size = (max(1, width // step), max(1, height // step))
    share = region.astype(np.float32)
    shown = cv2.copyTo(pixels, region.view(np.uint8))
    maps = np.dstack(
        [
            cv2.resize(values, size, interpolation=cv2.INTER_AREA)
            for values in (share, shown, np.einsum("hwc,hwc->hw", shown, shown))
        ]
    )
    maps = cv2.GaussianBlur(maps, (0, 0), sigma_px / step)
    column = ((x + 0.5) * (size[0] / width)).astype(int)
    row = ((y + 0.5) * (size[1] / height)).astype(int)
    found = maps[np.minimum(row, size[1] - 1), np.minimum(column, size[0] - 1)]
    weight = found[:, 0]
    means = found[:, 1:] / np.maximum(weight, 1e-6)[:, None]
    mean = means[:, :3]
    variance = (means[:, 3] - (mean**2).sum(axis=1)) / 3.0
    return _Nearby(mean, np.maximum(variance, 0.0) + NOISE**2, weight)


def _low_band(
    pixels: UInt8[np.ndarray, "h w 3"], clearance: UInt8[np.ndarray, "h w"], side: int
) -> Float[np.ndarray, "hl wl 3"]:
    """The photo blurred by about 1 % of its side, inside what is usable only."""
    sigma = 0.012 * side
    step = max(1, int(sigma / 3.0))
    height, width = pixels.shape[:2]
    size = (max(2, width // step), max(2, height // step))
    usable = (clearance > 0).view(np.uint8)
    cover = cv2.resize(usable.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    inside = cv2.copyTo(pixels, usable)
    # The fraction of a level that bytes lose here is far below what is visible.
    sums = cv2.resize(inside, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    cover = cv2.GaussianBlur(cover, (0, 0), sigma / step)
    sums = cv2.GaussianBlur(sums, (0, 0), sigma / step)
    return (sums / np.maximum(cover, 1e-6)[:, :, None]).astype(np.float32)
