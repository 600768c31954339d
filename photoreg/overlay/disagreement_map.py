"""Where photos disagree on the surface: as a picture, and at points of the surface."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.visibility import seen_points
from photoreg.imaging.exposure import MAX_GAIN
from photoreg.imaging.photo import Photo
from photoreg.overlay.pictures import AlignedPair

TOP_LEVELS = 40.0
"""Disagreement, in grey levels of 255, at which the colours end."""

BLUR_PX = 4.0
"""Sigma over which a picture's differences are averaged, in pixels of 1,024."""

UNSEEN_SHADE = 0.25
"""Brightness left to a photo where nothing is compared."""

CLAY = (128, 118, 108)
MIN_COSINE = 0.2


def disagreement_levels(pair: AlignedPair) -> Float[np.ndarray, "h w"]:
    """Colour difference of two photos on the surface, in grey levels; NaN if not seen.

    A common gain of each colour channel is taken off first; single pixels are
    averaged with their neighbours, as far as both photos see them.
    """
    levels = np.full(pair.seen.shape, np.nan, dtype=np.float32)
    if not pair.seen.any():
        return levels
    base = pair.base.astype(np.float32)
    carried = pair.carried.astype(np.float32) * _gains(
        pair.base[pair.seen], pair.carried[pair.seen]
    )
    difference = np.abs(base - carried).mean(axis=2)
    seen = pair.seen.astype(np.float32)
    sigma = BLUR_PX * max(pair.seen.shape) / 1024.0
    weight = cv2.GaussianBlur(seen, (0, 0), sigma)
    mean = cv2.GaussianBlur(difference * seen, (0, 0), sigma)
    levels[pair.seen] = mean[pair.seen] / np.maximum(weight[pair.seen], 1e-6)
    return levels


def mean_disagreement(pair: AlignedPair) -> float | None:
    """Mean of the levels over what both photos see; None if that is nothing."""
    levels = disagreement_levels(pair)
    return float(np.nanmean(levels)) if pair.seen.any() else None


def disagreement_picture(pair: AlignedPair) -> UInt8[np.ndarray, "h w 3"]:
    """The levels as colours: dark where photos agree, bright where they do not.

    Where nothing is compared the base is shown, grey and dark.
    """
    levels = disagreement_levels(pair)
    colours = level_colours(np.nan_to_num(levels))
    grey = cv2.cvtColor(pair.base, cv2.COLOR_RGB2GRAY)
    dark = cv2.cvtColor((UNSEEN_SHADE * grey).astype(np.uint8), cv2.COLOR_GRAY2RGB)
    return np.where(pair.seen[:, :, None], colours, dark)


def level_colours(levels: np.ndarray) -> UInt8[np.ndarray, "... 3"]:
    """Colours of levels from 0 to ``TOP_LEVELS``: black, violet, red, yellow.

    Brightness rises all along, so the scale reads without colour too.
    """
    share = np.clip(levels / TOP_LEVELS, 0.0, 1.0)
    index = np.rint(255.0 * share).astype(np.uint8)
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_INFERNO)
    return np.ascontiguousarray(table.reshape(256, 3)[:, ::-1])[index]


class SurfaceSight:
    """What each photo shows at the vertices of a mesh, under changing cameras."""

    def __init__(self, mesh: Mesh, photos: Sequence[Photo], max_side_px: int) -> None:
        self.mesh = mesh
        self.photos = tuple(photo.resized(max_side_px) for photo in photos)
        sigma = BLUR_PX * max_side_px / 1024.0
        self._soft = [cv2.GaussianBlur(p.pixels, (0, 0), sigma) for p in self.photos]
        self._normals = mesh.vertex_normals

    def look(
        self, cameras: Sequence[Camera]
    ) -> tuple[Float[np.ndarray, "c n 2"], Float[np.ndarray, "c n"]]:
        """Where each vertex is in each reduced photo, and how squarely it is seen.

        Returns:
            Pixels, and the cosine of the view; 0 where the photo does not see it.
        """
        pixels, cosines = [], []
        for photo, camera in zip(self.photos, cameras, strict=True):
            small = camera.resized(photo.width, photo.height)
            at, cosine = self._sight(photo, small)
            pixels.append(at)
            cosines.append(cosine)
        return np.array(pixels), np.array(cosines)

    def _sight(self, photo: Photo, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        mesh = self.mesh
        at = camera.project(mesh.vertices)
        to_camera = camera.center - mesh.vertices
        cosine = np.einsum("nd,nd->n", self._normals, to_camera)
        # A scan turned inside out is seen all the same; rays tell what hides.
        cosine = np.abs(cosine) / np.linalg.norm(to_camera, axis=1)
        seen = seen_points(mesh, camera, mesh.vertices)
        if photo.mask is not None:
            column, row = np.rint(at[seen]).astype(int).T
            inner = photo.mask[
                np.clip(row, 0, photo.height - 1), np.clip(column, 0, photo.width - 1)
            ]
            seen[np.flatnonzero(seen)[~inner]] = False
        return at, np.where(seen & (cosine > MIN_COSINE), cosine, 0.0)

    def disagreement(self, cameras: Sequence[Camera]) -> Float[np.ndarray, "n"]:
        """Levels at the vertices; NaN where fewer than two photos see one."""
        pixels, cosines = self.look(cameras)
        colours = np.full((len(self.photos), pixels.shape[1], 3), np.nan)
        for i, soft in enumerate(self._soft):
            seen = cosines[i] > 0.0
            at = pixels[i, seen].astype(np.float32)
            if len(at):
                colours[i, seen] = cv2.remap(
                    soft, at[:, None, 0], at[:, None, 1], cv2.INTER_LINEAR,
                    borderMode=cv2.BORDER_REPLICATE,
                )[:, 0]  # fmt: skip
        shared = (cosines > 0.0).sum(axis=0) >= 2
        levels = np.full(pixels.shape[1], np.nan)
        if not shared.any():
            return levels
        first = colours[0]
        for i in range(1, len(colours)):
            both = ~np.isnan(first[:, 0]) & ~np.isnan(colours[i, :, 0])
            if both.any():
                colours[i] *= _gains(first[both], colours[i, both])
        part = colours[:, shared]
        spread = np.nanmax(part, axis=0) - np.nanmin(part, axis=0)
        levels[shared] = spread.mean(axis=1)
        return levels


def vertex_colours(levels: Float[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours of levels at vertices; clay where nothing is compared."""
    known: Bool[np.ndarray, "n"] = ~np.isnan(levels)
    colours = np.full((len(levels), 3), CLAY, dtype=np.uint8)
    colours[known] = level_colours(levels[known])
    return colours


def _gains(base: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Per channel, what makes ``other`` (n, 3) as bright as ``base`` on the whole."""
    # Every seventh is enough for a median.
    ours = np.median(base[::7].astype(np.float32), axis=0)
    theirs = np.median(other[::7].astype(np.float32), axis=0)
    return np.clip(
        np.maximum(ours, 1.0) / np.maximum(theirs, 1.0), MAX_GAIN**-2, MAX_GAIN**2
    )
