"""One photo compared with the surface alone: how far its shading explains what is seen.

Distant lamps light a matt surface by a quadratic of its normal, hollows are dark as they
see little of the sky. So the photo's channels are fitted by such functions of the surface, with
free coefficients: whether bright means lit, inverted, or warm does not matter. What is
left of slow changes is filtered away beforehand, for painted colours are not in the mesh.

Within a round the prediction is carried along by the camera, to first order. Its slopes are
those of the prediction, not of the photo: texture, which the prediction does not have,
would shorten every step otherwise.

References:
    R. Basri and D. Jacobs, "Lambertian reflectance and linear subspaces", 2003,
    doi:10.1109/TPAMI.2003.1177153.
"""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from photoreg.geometry.surface_descriptors import SurfaceDescriptors
from photoreg.geometry.surface_view import SurfaceView, camera_rays
from photoreg.imaging.photo import Photo, resized_mask
from photoreg.parameters.increments import Increments, numbers_of
from photoreg.polish.grid_cells import cell_keys, starts_of_cells
from photoreg.polish.kernels import rim_rows
from photoreg.polish.levenberg_marquardt import (
    Quadratic,
    overdispersion,
    own_end,
    scatter,
)
from photoreg.polish.photometric_term import BLOCK_SIDES, CUT, MIN_SIGMA, OPPONENT
from photoreg.polish.shading_kernels import (
    draw_features,
    linear_equations,
    subtract_products,
    weighted_products,
)

MARGIN_PX = 3.0
"""Pixels this near to a rim or another jump of depth are left out, in those of the view."""
LOW_PASS_PX = 0.7
"""Blur of photo and features in pixels of the view: faces are drawn without averaging."""
CELL_PX = 32.0
"""Side of the cells over which pulls are summed, in pixels of a photo 1,024 px wide."""
VALIDATION_PX = 64.0
"""Side of the blocks of which every other one judges the fit of the rest, the same."""
TEXELS_A_PIXEL = 3.0
"""Texels of a mesh's texture for each pixel that shows the mesh: half of it is turned
away, and not all of the texture is used."""
NO_UV, NO_TEXTURE = np.zeros((0, 3, 2)), np.zeros((1, 1, 3), np.float32)
MIN_PIXELS = 400
"""Fewer pixels than this explain nothing."""
PASSES = 4
"""Reweighting passes of the fit."""
MAX_FITTED = 4_000
"""Pixels that the fit of some twenty coefficients looks at, at most about."""
RIDGE = 1e-3
"""Pull of each coefficient to zero, as a share of the features' energy."""
MIN_EXPLAINED = 0.03
"""Share of the photo that the surface must explain, or the term is left out."""


def shading_side_px(reach_px: float) -> int:
    """The longer side of the view in which a reach, in pixels of 1,024, is 8 pixels.

    From 256 to 768: finer faces are not resolved, and coarser ones are not missed.
    """
    return round(float(np.clip(8.0 * 1024.0 / reach_px, 256.0, 768.0)))


@dataclasses.dataclass(frozen=True, eq=False)
class ShadingFit:
    """What a photo shows of the surface, and what the surface's shape predicts."""

    pixels: Float[np.ndarray, "n 2"]
    """Of the view, cell by cell."""
    cell_starts: Int[np.ndarray, "bounds"]
    cells: Int[np.ndarray, "cells 2"]
    features: Float[np.ndarray, "n f"]
    """Filtered, in units of their own spread."""
    residual: Float[np.ndarray, "n k"]
    """Photo less prediction, whitened."""
    slopes: Float[np.ndarray, "n k 2"]
    """Of the prediction, by the pixel's column and row, whitened."""
    weights: Float[np.ndarray, "n"]
    """Robust weights of the fit."""
    explained: float
    """Share of the photo's variance that the fit of some blocks explains in others; below
    0 where it is worse than nothing."""
    n_seen: int
    """Pixels that could be compared."""


def fit_shading(
    photo: Photo,
    view: SurfaceView,
    descriptors: SurfaceDescriptors,
    high_pass_px: float,
    n_points: int,
    seed: int = 0,
) -> ShadingFit | None:
    """Fits the photo by functions of the surface's shape; None where too little is seen.

    Args:
        photo: Any size; it is reduced by area to the view's.
        view: What the camera sees of the descriptors' mesh.
        descriptors: Of the mesh.
        high_pass_px: Changes slower than this are left out, in pixels of the view.
        n_points: Pixels that are compared, at most.
        seed: Of their choice.
    """
    size = (view.camera.width, view.camera.height)
    scale = size[0] / 1024.0
    inside = view.covered & (view.inner > MARGIN_PX)
    mask = resized_mask(photo, size)
    if mask is not None:
        inside &= mask
    if inside.sum() < MIN_PIXELS:
        return None
    drawn = _features(view, descriptors)
    channels = cv2.transform(photo.pixels_at(size).astype(np.float32), OPPONENT)
    channels = np.ascontiguousarray(channels.transpose(2, 0, 1))
    # A border of a pixel has no slope; beyond the picture nothing counts.
    whole = cv2.copyMakeBorder(
        inside.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=[0]
    )
    rows, columns = np.nonzero(cv2.erode(whole, np.ones((3, 3), np.uint8))[1:-1, 1:-1])
    if len(rows) < MIN_PIXELS:
        return None
    # Beyond the box around what counts there is nothing to filter.
    top, left = rows.min() - 1, columns.min() - 1
    box = slice(top, rows.max() + 2), slice(left, columns.max() + 2)
    filtered = _band_passed(
        [plane[box] for plane in (*channels, *drawn)], inside[box], high_pass_px
    )
    n_seen = len(rows)
    if n_seen > n_points:
        rng = np.random.default_rng(seed)
        some = np.sort(rng.choice(n_seen, n_points, replace=False))
        rows, columns = rows[some], columns[some]
    pixels = np.column_stack([columns, rows])
    cell = np.floor(pixels / (CELL_PX * scale)).astype(np.int64)
    keys = cell_keys(cell)
    order = np.argsort(keys, kind="stable")
    pixels, cell = pixels[order], cell[order]
    starts = starts_of_cells(keys[order])
    columns, rows = (pixels - (left, top)).T
    values = filtered[:3, rows, columns].T.astype(np.float64)
    features = filtered[3:, rows, columns].T.astype(np.float64)
    spread = features.std(axis=0)
    known = spread > 1e-6 * max(float(spread.max()), 1e-12)
    if not known.any():
        return None
    features = features[:, known] / spread[known]
    block = np.floor(pixels / (VALIDATION_PX * scale)).astype(np.int64)
    explained = _cross_validated(features, values, block.sum(axis=1) % 2 == 0)
    coefficients, whitening = _robust_fit(features, values)
    error = subtract_products(values, features, coefficients)
    by_feature = np.zeros((len(pixels), known.sum(), 2))
    for axis, (down, right) in enumerate(((0, 1), (1, 0))):
        ahead = filtered[3:, rows + down, columns + right]
        behind = filtered[3:, rows - down, columns - right]
        by_feature[..., axis] = 0.5 * (ahead - behind)[known].T / spread[known]
    slopes = np.einsum("nfd,fk->nkd", by_feature, coefficients @ whitening)
    return ShadingFit(
        pixels.astype(np.float64),
        starts,
        cell[starts[:-1]],
        features,
        np.einsum("nk,kj->nj", error, whitening),
        slopes,
        _cauchy_weights(error, whitening),
        explained,
        n_seen,
    )


def _features(
    view: SurfaceView, descriptors: SurfaceDescriptors
) -> Float[np.ndarray, "f h w"]:
    mesh = descriptors.mesh
    scalars = [descriptors.occlusion, descriptors.curvature]
    corner_uv, texture = NO_UV, NO_TEXTURE
    if mesh.corner_uv is not None and descriptors.textures:
        wanted = TEXELS_A_PIXEL * view.covered.sum()
        texture = min(
            descriptors.textures,
            key=lambda one: abs(np.log(one.shape[0] * one.shape[1] / wanted)),
        )
        corner_uv = mesh.corner_uv
    elif descriptors.colours is not None:
        scalars += [*descriptors.colours.T]
    return draw_features(
        view.camera.record,
        view.camera.center,
        view.face_index,
        mesh.vertices,
        mesh.faces,
        np.stack([descriptors.normals, descriptors.coarse_normals]),
        np.column_stack(scalars),
        corner_uv,
        texture,
    )


def _band_passed(
    planes: list[np.ndarray], inside: Bool[np.ndarray, "h w"], high_pass_px: float
) -> Float[np.ndarray, "k h w"]:
    """Each plane less what is slow, looking inside only; 0 outside."""
    cover = inside.astype(np.float32)
    height, width = cover.shape
    # What is slow is blurred in a smaller picture.
    reduction = max(1.0, high_pass_px / 3.0)
    small = (max(1, round(width / reduction)), max(1, round(height / reduction)))
    sigma = high_pass_px * small[0] / width

    def slow(plane: np.ndarray) -> np.ndarray:
        reduced = cv2.resize(plane, small, interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(reduced, (0, 0), sigma)
        return cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR)

    near = np.maximum(cv2.GaussianBlur(cover, (0, 0), LOW_PASS_PX), 1e-3)
    far = np.maximum(slow(cover), 1e-3)
    out = np.zeros((len(planes), height, width), np.float32)
    for plane, filtered in zip(planes, out, strict=True):
        held = (plane - plane[inside].mean()) * cover
        blurred = cv2.GaussianBlur(held, (0, 0), LOW_PASS_PX)
        filtered[:] = (blurred / near - slow(held) / far) * cover
    return out


def _robust_fit(
    features: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (f, k), and what whitens the residuals (k, k)."""
    k = values.shape[1]
    some = slice(None, None, -(-len(values) // MAX_FITTED))
    fitted, seen = features[some], values[some]
    weights = np.ones(len(seen))
    coefficients = np.zeros((features.shape[1], k))
    whitening = np.eye(k)
    for _ in range(PASSES):
        normal, right = weighted_products(fitted, weights, seen)
        ridge = RIDGE * float(np.trace(normal)) / len(normal) + 1e-12
        coefficients = np.linalg.solve(normal + ridge * np.eye(len(normal)), right)
        error = subtract_products(seen, fitted, coefficients)
        covariance, _ = weighted_products(error, weights, error)
        covariance = covariance / weights.sum() + MIN_SIGMA**2 * np.eye(k)
        variances, axes = np.linalg.eigh(covariance)
        whitening = axes / np.sqrt(variances)
        weights = _cauchy_weights(error, whitening)
    return coefficients, whitening


def _cauchy_weights(error: np.ndarray, whitening: np.ndarray) -> np.ndarray:
    square = (np.einsum("nk,kj->nj", error, whitening) ** 2).sum(axis=1)
    return 1.0 / (1.0 + square / (error.shape[1] * CUT**2))


def _cross_validated(
    features: np.ndarray, values: np.ndarray, first: Bool[np.ndarray, "n"]
) -> float:
    """Share of the variance of one half that the fit of the other half explains."""
    left = whole = 0.0
    for half in (first, ~first):
        if half.sum() < MIN_PIXELS // 4 or (~half).sum() < MIN_PIXELS // 4:
            return 0.0
        coefficients, _ = _robust_fit(features[half], values[half])
        others = values[~half]
        error = subtract_products(others, features[~half], coefficients)
        # What shines or is torn off counts no more than what is far off everywhere.
        most = 3.0 * np.maximum(np.median(np.abs(others), axis=0) * 1.4826, MIN_SIGMA)
        left += float((np.clip(error, -most, most) ** 2).sum())
        whole += float((np.clip(others, -most, most) ** 2).sum())
    return 1.0 - left / max(whole, 1e-12)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ShadingTerm:
    """What one photo differs by from the surface's shading: a term of the polish.

    The residuals are linear in the increments, around where they were measured.
    """

    photo: int
    """Index of the photo."""
    x: Float[np.ndarray, "n_own"]
    """Increments of its camera where the term was measured."""
    residual: Float[np.ndarray, "n k"]
    """In units of their own spread."""
    slopes: Float[np.ndarray, "n k n_own"]
    """By the increments, without what other coefficients of the fit could do."""
    cell_starts: Int[np.ndarray, "bounds"]
    cells: Int[np.ndarray, "cells 2"]
    increments: Increments
    weight: float
    """Independent residuals, as a share of the points."""
    explained: float
    """See ``ShadingFit``."""

    @classmethod
    def measured(
        cls,
        photo: int,
        fit: ShadingFit,
        view: SurfaceView,
        increments: Increments,
        x: Float[np.ndarray, "p"],
    ) -> "ShadingTerm":
        """The term of a fit at ``x``, where ``view`` is what the camera sees."""
        camera, own = view.camera, x[increments.own(photo)]
        columns, rows = fit.pixels.astype(np.int64).T
        origins, directions = camera_rays(camera, fit.pixels)
        points = origins + view.depth[rows, columns][:, None] * directions
        record = increments.record(own, camera.width, camera.height)
        _, by_increments = rim_rows(record, points, increments.n)
        slopes = np.einsum("nkd,ndp->nkp", fit.slopes, by_increments)
        n, k, p = slopes.shape
        flat = np.ascontiguousarray(slopes.reshape(n, k * p))
        normal, right = weighted_products(fit.features, fit.weights, flat)
        ridge = RIDGE * float(np.trace(normal)) / len(normal) + 1e-12
        coefficients = np.linalg.solve(normal + ridge * np.eye(len(normal)), right)
        slopes = subtract_products(flat, fit.features, coefficients).reshape(n, k, p)
        # The area over which the filter makes noise alike; a quarter of a pixel's
        # square is the sampling's own.
        blob = 4.0 * np.pi * (LOW_PASS_PX**2 + 0.25)
        return cls(
            photo=photo,
            x=own,
            residual=fit.residual,
            slopes=slopes,
            cell_starts=fit.cell_starts,
            cells=fit.cells,
            increments=increments,
            weight=min(1.0, fit.n_seen / blob / n),
            explained=fit.explained,
        )

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and normal equations at ``x``."""
        cost, gradients, normal = self._equations(x)
        gradient = self.weight * gradients.sum(axis=0)
        return Quadratic(self.weight * cost, gradient, self.weight * normal, self.rows)

    def tempered(self, x: Float[np.ndarray, "p"]) -> "ShadingTerm":
        """The term weighted by what its cells know at ``x``; see ``PairTerm``."""
        ratio = overdispersion(*self._own_scores(x))
        return dataclasses.replace(self, weight=self.weight / ratio)

    def scatter(self, x: Float[np.ndarray, "p"]) -> Float[np.ndarray, "k k"]:
        """Covariance of the gradient at ``x``, of ``rows``."""
        return scatter(*self._own_scores(x))

    def _equations(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        return linear_equations(
            self.residual, self.slopes, x[self._own] - self.x, self.cell_starts, CUT
        )

    def _own_scores(
        self, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Gradients of the cells, normal matrix and groupings where it would go."""
        end = own_end(self.linearise(x), x, self.increments.limits, self._own)
        _, gradients, normal = self._equations(end)
        blocks = [cell_keys(self.cells // side) for side in BLOCK_SIDES]
        return self.weight * gradients, self.weight * normal, blocks

    @property
    def rows(self) -> Int[np.ndarray, "k"]:
        """This camera's numbers among the increments of all."""
        return numbers_of((self.photo,), (self.increments,))

    @property
    def _own(self) -> slice:
        """The increments of this term's camera."""
        return self.increments.own(self.photo)
