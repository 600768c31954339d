"""Photo-consistency for the polish: photos on a level, surface points, the pair's term."""

import concurrent.futures
import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection import CAMERA
from photoreg.geometry.surface_view import SurfaceView, camera_rays
from photoreg.imaging.exposure import MAX_GAIN
from photoreg.imaging.photo import Pair, Photo
from photoreg.parameters.increments import Increments, numbers_of
from photoreg.polish.grid_cells import (
    cell_keys,
    cell_means,
    starts_of_cells,
    within_cells,
)
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
"""Points this near to a rim or another jump of depth are left out: their pixels mix
two surfaces. Where a shell's ribs hide each other these few points moved the answer by
0.18 px without any noise; without them it is 0.04."""
LIGHT_BLURS_PX = (8.0, 16.0)
"""How far normals are evened out before light is fitted, in pixels of 1,024. A rough
mesh needs more, a finely shaped one less; the fit takes the best of both. Where light
moved over a rough mesh 2 or 4 leave half as much of it again."""
SPACINGS = 8
"""Distances between points that are tried, per octave."""
WINDOW_PX = 64
"""Points are drawn over a box whose sides are multiples of this."""
MIN_INNER_SHARE = 0.1
"""Least share of what is seen that keeps the margin; thinner things go without."""
MIN_SIGNAL = 0.05
"""Least share of the slopes' energy taken for signal."""
MIN_SIGMA = 0.5
"""Least residual scale, in grey levels of 255: the rounding of bytes is 0.3."""

# Grey, and two colour differences that a change of brightness leaves nearly alone.
OPPONENT = np.array(
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
    cell_starts: Int[np.ndarray, "bounds"]
    cells: Int[np.ndarray, "cells 2"]
    """Column and row of each cell."""

    def blocks(self, side: int) -> Int[np.ndarray, "cells"]:
        """The block of side x side cells that each cell is in."""
        return cell_keys(self.cells // side)

    @property
    def chunk_starts(self) -> Int[np.ndarray, "chunk_bounds"]:
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
    channels = cv2.transform(photo.pixels_at(size).astype(np.float32), OPPONENT)
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
    light_normals: Sequence[Float32[np.ndarray, "_ _ 3"]],
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
        light_normals: ``light_normals`` of the first view.
        n_points: About how many points.
        cell_px: Side of a cell in pixels of the first view.
        margin_px: Points nearer than this to a jump of depth in either view, in
            pixels, are left out.
        min_cosine: Least cosine between the surface's normal and the view.
        seed: Of the jitter.
    """
    view, other = views
    camera = view.camera
    window = view.covered & (view.inner > margin_px)
    if window.sum() < MIN_INNER_SHARE * view.covered.sum():
        window, margin_px = view.covered, 0.0
    pixels, rank = spread_pixels(window, n_points * 2, seed)
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
        index = index[np.argsort(rank[index], kind="stable")[:n_points]]
    cell = np.floor(pixels[index] / cell_px).astype(np.int64)
    key = cell_keys(cell)
    order = np.argsort(key, kind="stable")
    index = index[order]
    starts = starts_of_cells(key[order])
    return PairPoints(
        np.ascontiguousarray(points[index]),
        _smooth_normals(normals[index], starts),
        _normals_at(light_normals, view, pixels[index]),
        np.ones(len(index)),
        starts,
        cell[order][starts[:-1]],
    )


def spread_pixels(
    window: Bool[np.ndarray, "h w"], n: int, seed: int
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m"]]:
    """About ``n`` places evenly over a window, four a pixel at most, and their ranks.

    A window that differs by a pixel, as for a mesh in other units, changes one place and no
    other; drawn from a list of its pixels, all would change.

    Returns:
        Pixels (column, row), and a random number each, by whose order to take fewer.
    """
    area = max(1, int(window.sum()))
    wanted = np.sqrt(area / min(n, 4 * area))
    # Steps of a ladder, for the same reason.
    step = 2.0 ** (np.floor(SPACINGS * np.log2(wanted)) / SPACINGS)
    rows, columns = (np.flatnonzero(window.any(axis=axis)) for axis in (1, 0))
    low = [
        side[0] // WINDOW_PX * WINDOW_PX if len(side) else 0 for side in (columns, rows)
    ]
    high = [side[-1] + 1 if len(side) else 1 for side in (columns, rows)]
    n_columns, n_rows = (
        int(np.ceil(np.ceil((last - first) / WINDOW_PX) * WINDOW_PX / step))
        for first, last in zip(low, high, strict=True)
    )
    rng = np.random.default_rng(seed)
    jitter = rng.random((n_rows, n_columns, 3), dtype=np.float32)
    x = low[0] - 0.5 + step * (np.arange(n_columns) + jitter[..., 0])
    y = low[1] - 0.5 + step * (np.arange(n_rows)[:, None] + jitter[..., 1])
    at = np.rint(y).astype(np.int64), np.rint(x).astype(np.int64)
    height, width = window.shape
    inside = (at[0] < height) & (at[1] < width)
    inside[inside] = window[at[0][inside], at[1][inside]]
    pixels = np.column_stack([x[inside], y[inside]])
    if len(pixels) == 0:
        return np.zeros((1, 2)), np.zeros(1)
    return pixels, jitter[..., 2][inside].astype(np.float64)


def _smooth_normals(normals: np.ndarray, starts: np.ndarray) -> np.ndarray:
    if len(normals) == 0:
        return normals
    starts = starts.astype(np.int64)
    means = np.repeat(cell_means(normals, starts), np.diff(starts), axis=0)
    mixed = normals + means
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def light_normals(
    mesh: Mesh, view: SurfaceView
) -> tuple[Float32[np.ndarray, "_ _ 3"], ...]:
    """Normals in a view evened out over each of ``LIGHT_BLURS_PX``, as small pictures.

    In pixels, so that a mesh's roughness does not count for its shape, however fine its
    faces are.
    """
    seen = np.zeros((*view.covered.shape, 3), np.float32)
    seen[view.covered] = mesh.face_normals[view.face_index[view.covered]]
    pictures = []
    for blur_px in LIGHT_BLURS_PX:
        sigma = blur_px * view.camera.width / 1024.0
        # Blurred in a smaller picture: a second instead of twenty for a large photo.
        scale = min(1.0, 4.0 / sigma)
        small = cv2.resize(seen, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        pictures.append(cv2.GaussianBlur(small, (0, 0), max(sigma * scale, 0.5)))
    return tuple(pictures)


def light_normals_of_firsts(
    mesh: Mesh, views: Sequence[SurfaceView], pairs: Sequence[Pair]
) -> dict[int, tuple[Float32[np.ndarray, "_ _ 3"], ...]]:
    """``light_normals`` of every view that is the first of a pair, once each."""
    firsts = sorted({i for i, _ in pairs})
    with concurrent.futures.ThreadPoolExecutor() as threads:
        found = threads.map(lambda i: light_normals(mesh, views[i]), firsts)
        return dict(zip(firsts, found, strict=True))


def _normals_at(
    pictures: Sequence[np.ndarray], view: SurfaceView, pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n scales 3"]:
    """Unit normals of ``light_normals`` at pixels of their view."""
    at_scales = []
    for small in pictures:
        ratio = np.array(small.shape[1::-1]) / np.array(view.covered.shape[1::-1])
        columns, rows = np.rint((pixels + 0.5) * ratio - 0.5).astype(np.int64).T
        at = small[
            np.clip(rows, 0, small.shape[0] - 1),
            np.clip(columns, 0, small.shape[1] - 1),
        ].astype(np.float64)
        at_scales.append(
            at / np.maximum(np.linalg.norm(at, axis=1, keepdims=True), 1e-12)
        )
    return np.stack(at_scales, axis=1)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
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
        records = _records(pair, increments, images, x)
        values = pair_values(surface.points, *images, records)
        gain, offsets, sigma, tau = measure_noise(
            values, surface.cell_starts, surface.light_normals
        )
        shared, mean = slope_energy(
            surface.points, surface.normals, *images, records, gain
        ).T
        signal = np.clip(shared / np.maximum(mean, 1e-12), MIN_SIGNAL, 1.0)
        return cls(
            pair=pair,
            surface=surface,
            images=images,
            increments=increments,
            gain=gain,
            offsets=offsets,
            sigma=sigma,
            tau=tau,
            signal=signal,
            weight=np.full(3, weight),
        )

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and normal equations at ``x``."""
        costs, gradients, normals = self._sums(x)
        return Quadratic(
            float(costs.sum(axis=0) @ self.weight),
            self.weight @ gradients.sum(axis=0),
            np.einsum("k,kij->ij", self.weight, normals.sum(axis=0)),
            self.rows,
        )

    def tempered(self, x: Float[np.ndarray, "p"]) -> "PairTerm":
        """The term with each channel weighted by what it knows at ``x``.

        What the channels get wrong together is left to ``scatter``: in the weights it would
        make outlines count more, and where a scan's outline is fat the answer follows it
        (granite went from 0.7 to 1.4 px).
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

    def scatter(self, x: Float[np.ndarray, "p"]) -> Float[np.ndarray, "k k"]:
        """Covariance of the gradient at ``x``, all channels together, of ``rows``."""
        gradients, normals = self._own_scores(x)
        # Where the mesh is wrong, all channels are wrong in the same way.
        return scatter(
            np.einsum("k,ckp->cp", self.weight, gradients),
            np.einsum("k,kij->ij", self.weight, normals),
            self._blocks,
        )

    def _own_scores(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradients (cells, 3, 2 n) and normals (3, 2 n, 2 n) where this term would go.

        Where it is, if it cannot be evaluated there.
        """
        limits = np.concatenate([one.limits for one in self.increments])
        end = own_end(self.linearise(x), x, limits, self.rows)
        _, gradients, normals = self._sums(end)
        if not (np.isfinite(gradients).all() and np.isfinite(normals).all()):
            _, gradients, normals = self._sums(x)
        return gradients, normals.sum(axis=0)

    @property
    def _blocks(self) -> list[Int[np.ndarray, "cells"]]:
        return [self.surface.blocks(side) for side in BLOCK_SIDES]

    @property
    def rows(self) -> Int[np.ndarray, "k"]:
        """This pair's numbers among the increments of all cameras."""
        return numbers_of(self.pair, self.increments)

    @property
    def _n(self) -> int:
        """How many increments a camera has."""
        return self.increments[0].n

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
            _records(self.pair, self.increments, self.images, x),
            self.gain,
            self.offsets,
            1.0 / self.sigma,
            precision,
            CUT,
            self._n,
        )
        return costs, gradients, normals * self.signal[:, None, None]


def exposure_gain(
    values: Float[np.ndarray, "n 2 3"], cell_starts: Int[np.ndarray, "bounds"]
) -> Float[np.ndarray, "3"]:
    """Square root of the gain between two photos, a channel each."""
    # Deviations within cells: slow light would otherwise pass for contrast.
    within = within_cells(values, cell_starts)
    spread = np.sqrt(np.maximum((within**2).mean(axis=0), 1e-6))
    return np.sqrt(np.clip(spread[1] / spread[0], MAX_GAIN**-2, MAX_GAIN**2))


def measure_noise(
    values: Float[np.ndarray, "n 2 3"],
    cell_starts: Int[np.ndarray, "bounds"],
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


def _records(
    pair: tuple[int, int],
    increments: tuple[Increments, Increments],
    images: tuple[np.ndarray, np.ndarray],
    x: np.ndarray,
) -> np.ndarray:
    """The cameras of a pair at ``x``, for kernels: (2,) of ``CAMERA``."""
    records = np.zeros(2, CAMERA)
    for k, (i, increment, image) in enumerate(
        zip(pair, increments, images, strict=True)
    ):
        records[k] = increment.record(
            x[increment.own(i)], image.shape[1], image.shape[0]
        )
    return records
