"""Photo-consistency for the polish: photos on a level, surface points, the pair's term."""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Int

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import SurfaceView, camera_rays
from photoreg.imaging.photo import Photo
from photoreg.parameters.increments import N_INCREMENTS, Increments
from photoreg.polish.grid_cells import cell_means, within_cells
from photoreg.polish.kernels import pair_normal_equations, pair_values, slope_energy
from photoreg.polish.levenberg_marquardt import (
    Quadratic,
    overdispersion,
    own_end,
    scatter,
)
from photoreg.polish.lighting import fit_light

N_CHUNKS = 32
"""Chunks of cells summed apart and then in order: the sum does not depend on threads."""
CUT = 2.0
"""Scale of the Cauchy cost in residual sigmas."""
BLOCK_SIDES = (1, 2, 4)
"""Sides, in cells, of the blocks over which errors may be alike."""
EDGE_MARGIN_PX = 2.0
"""Points this near to a rim or to another jump of depth are left out: their pixels mix
two surfaces. Where a shell's ribs hide each other these few points moved the answer by
0.18 px without any noise; without them it is 0.04."""
LIGHT_BLURS_PX = (8.0, 16.0)
"""How far normals are evened out before light is fitted, in pixels of 1,024. A rough
mesh wants more, a finely shaped one less; the fit takes the best of both. Where light
moved over a rough mesh 2 or 4 leave half as much of it again."""
MIN_INNER_SHARE = 0.1
"""Least share of what is seen that keeps the margin; thinner things go without."""
MIN_SIGNAL = 0.05
"""Least share of the slopes' energy taken for signal."""
MIN_SIGMA = 0.5
"""Least residual scale, in grey levels of 255: the rounding of bytes is 0.3."""

# Grey, and two colour differences that a change of brightness leaves nearly alone.
_OPPONENT = np.array(
    [
        [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0],
        [0.5, 0.0, -0.5],
        [0.25, -0.5, 0.25],
    ],
    dtype=np.float32,
)


@dataclasses.dataclass(frozen=True, eq=False)
class PairPoints:
    """Surface points that both photos of a pair see, cell by cell."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Unit normals of the surface, evened out over the cell."""
    light_normals: Float[np.ndarray, "n scales 3"]
    """Unit normals that meet the light: evened out over each of ``LIGHT_BLURS_PX``."""
    weights: Float[np.ndarray, "n"]
    cell_starts: Int[np.ndarray, "cells+1"]
    cells: Int[np.ndarray, "cells 2"]
    """Column and row of each cell."""

    def blocks(self, side: int) -> Int[np.ndarray, "cells"]:
        """The block of side x side cells that each cell is in."""
        column, row = (self.cells // side).T
        return row * 100_003 + column

    @property
    def chunk_starts(self) -> Int[np.ndarray, "chunks+1"]:
        """First cell of each chunk; chunks hold about the same number of points."""
        targets = np.linspace(0, len(self.points), N_CHUNKS + 1)[1:-1]
        inner = np.searchsorted(self.cell_starts, targets)
        return np.concatenate([[0], inner, [len(self.cell_starts) - 1]]).astype(
            np.int64
        )


def opponent_channels(
    photo: Photo, view: SurfaceView, sigma_px: float
) -> Float[np.ndarray, "h w 3"]:
    """The photo at the view's size in opponent channels, blurred inside the object.

    Blurred is (photo x cover) / cover: the background never bleeds in. Beyond the
    blur's reach the object's mean colour stands.

    Args:
        photo: Any size; it is reduced by area to the view's.
        view: What the camera sees of the mesh, at the size wanted.
        sigma_px: Blur in pixels of the view.

    Returns:
        float32, grey levels of 255.
    """
    size = (view.camera.width, view.camera.height)
    pixels = photo.pixels
    if (photo.width, photo.height) != size:
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    channels = cv2.transform(pixels.astype(np.float32), _OPPONENT)
    cover = view.covered.astype(np.float32)
    if photo.mask is not None:
        cover *= cv2.resize(
            photo.mask.astype(np.float32), size, interpolation=cv2.INTER_AREA
        )
    total = float(cover.sum())
    if total == 0.0 or sigma_px <= 0.0:
        return channels
    # Three channels apart: numpy is slow where the innermost axis has three.
    covers = cv2.merge([cover] * 3)
    channels -= np.array(cv2.sumElems(channels * covers)[:3], np.float32) / total
    blurred = cv2.GaussianBlur(channels * covers, (0, 0), sigma_px)
    weight = np.maximum(cv2.GaussianBlur(cover, (0, 0), sigma_px), 1e-3)
    blurred /= cv2.merge([weight] * 3)
    return blurred


def pair_points(
    mesh: Mesh,
    photos: Sequence[Photo],
    views: Sequence[SurfaceView],
    n_points: int,
    cell_px: float,
    margin_px: float,
    min_cosine: float,
    seed: int,
) -> PairPoints:
    """Points on the mesh seen by both photos of a pair, evenly over the first photo.

    Args:
        mesh: The surface.
        photos: The two photos, for their masks.
        views: What the two cameras see.
        n_points: About how many points.
        cell_px: Side of a cell in pixels of the first view.
        margin_px: Points nearer than this to a jump of depth in either view, in
            pixels, are left out.
        min_cosine: Least cosine between the surface's normal and the view.
        seed: Of the jitter.
    """
    view, other = views
    camera = view.camera
    rng = np.random.default_rng(seed)
    window = np.flatnonzero((view.covered & (view.inner > margin_px)).ravel())
    if len(window) < MIN_INNER_SHARE * view.covered.sum():
        window, margin_px = np.flatnonzero(view.covered.ravel()), 0.0
    if len(window) == 0:
        window = np.zeros(1, dtype=np.int64)
    # Evenly spaced through the row-wise list, jittered: about even over the photo.
    n = min(n_points * 2, 4 * len(window))
    chosen = window[
        ((np.arange(n) + rng.random(n)) * (len(window) / n)).astype(np.int64)
    ]
    pixels = np.column_stack([chosen % camera.width, chosen // camera.width])
    pixels = pixels + rng.random(pixels.shape) - 0.5
    origins, directions = camera_rays(camera, pixels)
    face, distance = mesh.first_hits(origins, directions)
    keep = face >= 0
    points = origins + np.where(keep, distance, 1.0)[:, None] * directions
    normals = mesh.face_normals[np.maximum(face, 0)]
    for v, photo in zip(views, photos, strict=True):
        towards = v.camera.center - points
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        keep &= np.einsum("ij,ij->i", normals, towards) > min_cosine
        at = v.camera.project(points)
        keep &= v.camera.contains(np.nan_to_num(at, nan=-1.0))
        if photo.mask is not None:
            x = np.clip(
                np.rint((at[:, 0] + 0.5) * photo.width / v.camera.width - 0.5),
                0,
                photo.width - 1,
            )
            y = np.clip(
                np.rint((at[:, 1] + 0.5) * photo.height / v.camera.height - 0.5),
                0,
                photo.height - 1,
            )
            keep &= photo.mask[
                np.nan_to_num(y).astype(int), np.nan_to_num(x).astype(int)
            ]
    index = np.flatnonzero(keep)
    index = index[mesh.is_unoccluded(points[index], other.camera.center)]
    if margin_px > 0:
        at = np.rint(other.camera.project(points[index])).astype(int)
        index = index[other.inner[at[:, 1], at[:, 0]] > margin_px]
    if len(index) > n_points:
        index = index[rng.permutation(len(index))[:n_points]]
    cell = np.floor(pixels[index] / cell_px).astype(np.int64)
    key = cell[:, 1] * 100_003 + cell[:, 0]
    order = np.argsort(key, kind="stable")
    index, key = index[order], key[order]
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])[: len(key)])
    starts = np.append(first, len(key))
    return PairPoints(
        np.ascontiguousarray(points[index]),
        _smooth_normals(normals[index], starts),
        _seen_normals(mesh, view, pixels[index]),
        np.ones(len(index)),
        starts.astype(np.int64),
        cell[order][first],
    )


def _smooth_normals(normals: np.ndarray, starts: np.ndarray) -> np.ndarray:
    if len(normals) == 0:
        return normals
    starts = starts.astype(np.int64)
    means = np.repeat(cell_means(normals, starts), np.diff(starts), axis=0)
    mixed = normals + means
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _seen_normals(
    mesh: Mesh, view: SurfaceView, pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n scales 3"]:
    """Unit normals at pixels of a view, evened out over each of ``LIGHT_BLURS_PX``.

    In pixels, so that a mesh's roughness does not count for its shape, however fine its
    faces are.
    """
    seen = np.zeros((*view.covered.shape, 3), np.float32)
    seen[view.covered] = mesh.face_normals[view.face_index[view.covered]]
    at_scales = []
    for blur_px in LIGHT_BLURS_PX:
        sigma = blur_px * view.camera.width / 1024.0
        # Blurred in a smaller picture: a second instead of twenty for a large photo.
        scale = min(1.0, 4.0 / sigma)
        small = cv2.resize(seen, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small, (0, 0), max(sigma * scale, 0.5))
        ratio = np.array(small.shape[1::-1]) / np.array(seen.shape[1::-1])
        columns, rows = np.rint((pixels + 0.5) * ratio - 0.5).astype(np.int64).T
        at = small[
            np.clip(rows, 0, small.shape[0] - 1),
            np.clip(columns, 0, small.shape[1] - 1),
        ].astype(np.float64)
        at_scales.append(
            at / np.maximum(np.linalg.norm(at, axis=1, keepdims=True), 1e-12)
        )
    return np.stack(at_scales, axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class PairTerm:
    """Photo-consistency of two photos: a term of the polish.

    Gain, offset, residual scale and the spread of the cells' offsets are measured at
    construction (``measured``) and then held, so the cost is one function of x.
    """

    pair: tuple[int, int]
    """Indices of the photos."""
    surface: PairPoints
    images: tuple[np.ndarray, np.ndarray]
    increments: tuple[Increments, Increments]
    gain: Float[np.ndarray, "3"]
    offsets: Float[np.ndarray, "n 3"]
    """Of each point: what the photos differ by in exposure and light."""
    sigma: Float[np.ndarray, "3"]
    tau: Float[np.ndarray, "3"]
    signal: Float[np.ndarray, "3"]
    """Share of the slopes' energy that both photos have; the rest is noise and would
    make the normal matrix promise what the cost does not keep."""
    weight: Float[np.ndarray, "3"]
    """Of each channel: independent residuals, as a share of the points."""

    @classmethod
    def measured(
        cls,
        pair: tuple[int, int],
        surface: PairPoints,
        images: tuple[np.ndarray, np.ndarray],
        increments: tuple[Increments, Increments],
        x: Float[np.ndarray, "p"],
        weight: float,
    ) -> "PairTerm":
        """The term, with exposure and noise measured at ``x``."""
        geometries = _geometries(pair, increments, images, x)
        values = pair_values(surface.points, *images, *geometries)
        gain, offsets, sigma, tau = measure_noise(
            values, surface.cell_starts, surface.light_normals
        )
        shared, mean = slope_energy(
            surface.points, surface.normals, *images, *geometries, gain
        ).T
        signal = np.clip(shared / np.maximum(mean, 1e-12), MIN_SIGNAL, 1.0)
        return cls(
            pair,
            surface,
            images,
            increments,
            gain,
            offsets,
            sigma,
            tau,
            signal,
            np.full(3, weight),
        )

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and normal equations at ``x``."""
        costs, gradients, normals = self._sums(x)
        rows = self._rows
        gradient, normal = np.zeros(len(x)), np.zeros((len(x), len(x)))
        gradient[rows] = self.weight @ gradients.sum(axis=0)
        normal[np.ix_(rows, rows)] = np.einsum(
            "k,kij->ij", self.weight, normals.sum(axis=0)
        )
        return Quadratic(float(costs.sum(axis=0) @ self.weight), gradient, normal)

    def tempered(self, x: Float[np.ndarray, "p"]) -> "PairTerm":
        """The term with each channel weighted by what it knows at ``x``.

        What the channels get wrong together is left to ``scatter``: in the weights it
        would trust outlines more, and where a scan's outline is fat the answer follows
        it (granite went from 0.7 to 1.4 px).
        """
        gradients, normals = self._own_scores(x)
        ratios = [
            overdispersion(
                self.weight[k] * gradients[:, k],
                self.weight[k] * normals[k],
                self._blocks,
            )
            for k in range(len(self.weight))
        ]
        return dataclasses.replace(self, weight=self.weight / ratios)

    def scatter(self, x: Float[np.ndarray, "p"]) -> Float[np.ndarray, "p p"]:
        """Covariance of the gradient at ``x``, all channels together."""
        gradients, normals = self._own_scores(x)
        whole = np.zeros((len(x), len(x)))
        # Where the mesh is wrong, all channels are wrong alike.
        whole[np.ix_(self._rows, self._rows)] = scatter(
            np.einsum("k,ckp->cp", self.weight, gradients),
            np.einsum("k,kij->ij", self.weight, normals),
            self._blocks,
        )
        return whole

    def _own_scores(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradients (cells, 3, 18) and normals (3, 18, 18) where this term would go.

        Where it is, if nothing can be reckoned there.
        """
        limits = np.full(len(x), np.inf)
        limits[self._rows] = np.concatenate([one.limits for one in self.increments])
        _, gradients, normals = self._sums(own_end(self.linearise(x), x, limits))
        if not (np.isfinite(gradients).all() and np.isfinite(normals).all()):
            _, gradients, normals = self._sums(x)
        return gradients, normals.sum(axis=0)

    @property
    def _blocks(self) -> list[Int[np.ndarray, "cells"]]:
        return [self.surface.blocks(side) for side in BLOCK_SIDES]

    @property
    def _rows(self) -> np.ndarray:
        return np.concatenate(
            [np.arange(N_INCREMENTS) + i * N_INCREMENTS for i in self.pair]
        )

    def _sums(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        surface = self.surface
        with np.errstate(divide="ignore"):
            precision = np.minimum((self.sigma / self.tau) ** 2, 1e12)
        costs, gradients, normals = pair_normal_equations(
            surface.points,
            surface.normals,
            surface.weights,
            surface.cell_starts,
            surface.chunk_starts,
            *self.images,
            *_geometries(self.pair, self.increments, self.images, x),
            self.gain,
            self.offsets,
            1.0 / self.sigma,
            precision,
            CUT,
        )
        return costs, gradients, normals * self.signal[:, None, None]


def exposure_gain(
    values: Float[np.ndarray, "n 2 3"], cell_starts: Int[np.ndarray, "cells+1"]
) -> Float[np.ndarray, "3"]:
    """Square root of the gain between two photos, a channel each."""
    # Deviations within cells: slow light would otherwise pass for contrast.
    within = within_cells(values, cell_starts)
    spread = np.sqrt(np.maximum((within**2).mean(axis=0), 1e-6))
    return np.sqrt(np.clip(spread[1] / spread[0], 0.25, 4.0))


def measure_noise(
    values: Float[np.ndarray, "n 2 3"],
    cell_starts: Int[np.ndarray, "cells+1"],
    light_normals: Float[np.ndarray, "n scales 3"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Exposure and light between two photos and the noise of what they leave.

    Returns:
        Square root of the gain (3,), offset of each point (n, 3), residual sigma within
        cells (3,), robust, and the spread tau (3,) of the cells' offsets beyond what
        sigma explains.
    """
    counts = np.diff(cell_starts)
    values = np.nan_to_num(values)
    gain = exposure_gain(values, cell_starts)
    residual = values[:, 0] * gain - values[:, 1] / gain
    offsets = fit_light(residual, light_normals, cell_starts)
    offsets += np.median(residual - offsets, axis=0)
    residual = residual - offsets
    cells = cell_means(residual, cell_starts)
    inner = within_cells(residual, cell_starts)
    # n - 1 of n: the cell's mean took one degree of freedom.
    lost = np.sqrt(len(values) / max(len(values) - len(counts), 1))
    sigma = np.maximum(1.4826 * np.median(np.abs(inner), axis=0) * lost, MIN_SIGMA)
    big = counts >= 8
    if big.sum() < 8:
        return gain, offsets, sigma, np.zeros(3)
    between = (1.4826 * np.median(np.abs(cells[big]), axis=0)) ** 2
    noise = sigma**2 * np.mean(1.0 / counts[big])
    return gain, offsets, sigma, np.sqrt(np.maximum(between - noise, 0.0))


def _geometries(
    pair: tuple[int, int],
    increments: tuple[Increments, Increments],
    images: tuple[np.ndarray, np.ndarray],
    x: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    first, second = (
        increment.geometry(
            x[i * N_INCREMENTS : (i + 1) * N_INCREMENTS], image.shape[1], image.shape[0]
        )
        for i, increment, image in zip(pair, increments, images, strict=True)
    )
    return first, second
