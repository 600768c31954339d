"""The rim of the mesh, and the edges of the photo it should fall on.

The rim is where the mesh ends against nothing, as a camera sees it: found on a grid
of rays, then along each normal by bisection, so it needs no connectivity and meets
meshes of any size. Where the surface itself ends (a border of the mesh) there is no
silhouette, and no residual.

Moving a camera, each rim point stays on its place of the surface to first order: the
rim slides over the surface, but along the line of sight only (R. Cipolla and P.
Giblin, "Visual Motion of Curves and Surfaces", 2000, section 2).
"""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import SurfaceView, camera_rays
from photoreg.imaging.colour_model import colour_bins, colour_model, object_regions
from photoreg.imaging.photo import Photo, resized_mask
from photoreg.parameters.increments import Increments, numbers_of
from photoreg.polish.grid_cells import cell_keys, cell_means, starts_of_cells
from photoreg.polish.kernels import bilinear_at, rim_rows
from photoreg.polish.levenberg_marquardt import (
    Quadratic,
    overdispersion,
    own_end,
    scatter,
)
from photoreg.polish.mesh_field import MeshField

CUT = 2.0
"""Scale of the Cauchy cost in residual sigmas."""
MIN_SIGMA_PX = 0.1
"""Least residual scale, in pixels: edges are not found better than this."""
SEGMENT_POINTS = 12
"""Rim points, on average, that share an offset: edges are off by whole stretches."""
SEGMENT_SIDE = 4.0 / np.pi * SEGMENT_POINTS
"""A segment is what a square cell of the view holds of the rim. This is its side in
strides: the mean chord of a square is a quarter of pi of it."""
BLOCK_SIDES = (1, 2, 4)
"""Sides, in cells, of the blocks over which errors may be alike."""
OUTLINE_SIGMA_PX = 0.5
"""Spread of the offset that a whole outline has: scans come out fat or thin."""
BISECTIONS = 7
"""They leave 2.5 px / 2^7 = 0.02 px, a fifth of ``MIN_SIGMA_PX``."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rim:
    """Points of a mesh's rim as one camera sees it, in order along the rim."""

    points: Float[np.ndarray, "n 3"]
    """On the surface, world axes."""
    pixels: Float[np.ndarray, "n 2"]
    """In the view, between the last ray that hits and the first that does not."""
    normals: Float[np.ndarray, "n 2"]
    """Unit vectors in the view, away from the object."""
    stride_px: int = 1
    """Every so many pixels along the rim there is a point."""


def find_rim(mesh: Mesh, view: SurfaceView, n_points: int) -> Rim:
    """The rim of ``mesh`` in ``view``, about ``n_points`` points, without borders."""
    covered = view.covered
    none = Rim(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)))
    contours, _ = cv2.findContours(
        covered.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
    )
    # Holes and islands of a few pixels are noise of the mesh, not its shape.
    chains = [c[:, 0, :] for c in contours if len(c) >= 24]
    if not chains:
        return none
    pixels = np.concatenate(chains).astype(np.float64)
    stride = max(1, round(len(pixels) / max(n_points, 1)))
    smooth = cv2.GaussianBlur(covered.astype(np.float32), (0, 0), 1.5)
    columns, rows = pixels.astype(int).T
    height, width = covered.shape
    inside = (columns > 2) & (rows > 2) & (columns < width - 3) & (rows < height - 3)
    pixels, columns, rows = pixels[inside], columns[inside], rows[inside]
    normals = -np.column_stack(
        [
            smooth[rows, columns + 1] - smooth[rows, columns - 1],
            smooth[rows + 1, columns] - smooth[rows - 1, columns],
        ]
    ).astype(np.float64)
    lengths = np.linalg.norm(normals, axis=1)
    # Every so many columns or rows, whichever the rim crosses, and not so many points:
    # a rim that is longer by a pixel has the same ones elsewhere.
    crosses_columns = np.abs(normals[:, 1]) >= np.abs(normals[:, 0])
    keep = np.where(crosses_columns, columns, rows) % stride == 0
    keep &= lengths > 0.05
    pixels, normals = pixels[keep], normals[keep] / lengths[keep, None]
    if len(pixels) == 0:
        return none

    near, far = np.full(len(pixels), 0.0), np.full(len(pixels), 2.5)
    good = np.ones(len(pixels), dtype=bool)
    face_at = np.full(len(pixels), -1)
    depth_at = np.zeros(len(pixels))
    # First and second round: the ends of the interval, which must differ.
    for attempt in range(BISECTIONS + 2):
        at = near if attempt == 0 else far if attempt == 1 else 0.5 * (near + far)
        face, depth = mesh.first_hits(
            *camera_rays(view.camera, pixels + at[:, None] * normals)
        )
        hit = face >= 0
        if attempt == 0:
            good &= hit
        elif attempt == 1:
            good &= ~hit
        else:
            near, far = np.where(hit, at, near), np.where(hit, far, at)
        last = hit & (attempt != 1)
        face_at = np.where(last, face, face_at)
        depth_at = np.where(last, depth, depth_at)
    pixels = pixels + (0.5 * (near + far))[:, None] * normals
    origins, directions = camera_rays(view.camera, pixels)
    points = origins + depth_at[:, None] * directions
    good &= face_at >= 0
    facing = np.einsum("ij,ij->i", mesh.face_normals[face_at], directions) < 0.0
    good &= facing & ~mesh.is_border_face[face_at]
    return Rim(points[good], pixels[good], normals[good], stride_px=stride)


@dataclasses.dataclass(frozen=True, eq=False)
class RimEdges:
    """For each rim point the photo's edge along its normal."""

    offset_px: Float[np.ndarray, "n"]
    """From the rim outwards to the edge, in pixels of the view; NaN: none found."""
    counts: Bool[np.ndarray, "n"]
    """Whether the photo's mask leaves anything of the normal to search."""


@dataclasses.dataclass(frozen=True, eq=False)
class EdgeImage:
    """A photo as edges are looked for in it: made once, asked for any outline."""

    values: Float[np.ndarray, "h w 3"]
    """The photo's colours, 0 to 255, softened."""
    bins: Int[np.ndarray, "h w"]
    """Their ``colour_bins``."""
    mask: Bool[np.ndarray, "h w"] | None
    """Which pixels count; None: all."""

    @classmethod
    def of(cls, photo: Photo, size: tuple[int, int]) -> "EdgeImage":
        """The photo at width and height ``size``."""
        pixels = photo.pixels_at(size).astype(np.float32)
        values = cv2.GaussianBlur(pixels, (0, 0), 0.8)
        return cls(values, colour_bins(values), resized_mask(photo, size))

    def edges(
        self,
        rim: Rim,
        regions: UInt8[np.ndarray, "h w"],
        reach_px: float,
    ) -> RimEdges:
        """Searches each rim point's normal for the edge between object and surroundings.

        The edge is where colours like the object's give way to colours like the
        surroundings', where the colour steps, and near. Where colours inside and outside
        are alike, the step alone counts. What the photo's mask leaves out has neither
        colours nor edges; its border is an edge only where the photo's colours step there.

        Args:
            rim: The outline, in pixels of this image.
            regions: ``object_regions`` of the object, ``reach_px`` around it.
            reach_px: How far from the rim an edge may be.
        """
        model = colour_model(self.bins, regions, self.mask)
        half = 2.0
        reach = max(3, round(reach_px * half))
        steps = np.arange(-reach - 2, reach + 3) / half
        at = rim.pixels[:, None, :] + steps[None, :, None] * rim.normals[:, None, :]
        profile = bilinear_at(self.values, at)
        slope = 0.5 * (profile[:, 2:] - profile[:, :-2])
        strength = np.sqrt((slope**2).sum(axis=2))[:, 1:-1]
        ratio = model.of(profile)[:, 2:-2]
        counts = np.ones(len(ratio), dtype=bool)
        if self.mask is not None:
            ratio = np.where(_at(self.mask, at)[:, 2:-2], ratio, 0.0)
            # The step at the border of the mask is between a pixel that counts and one
            # that does not.
            near = cv2.dilate(self.mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            within = _at(near, at)[:, 2:-2]
            strength = np.where(within, strength, 0.0)
            counts = np.logical_or.reduce(within, axis=1)
        # Inside up to here, outside from here on; neighbours are not independent.
        inside = np.cumsum(ratio, axis=1)
        split = (2.0 * inside - inside[:, -1:]) / (half * 4.0)
        positions = steps[2:-2]
        noise = np.median(strength[counts]) + 1.0 if counts.any() else 1.0
        score = (
            split
            + 2.0 * np.log1p(strength / noise)
            - 0.5 * (positions / (0.5 * reach_px)) ** 2
        )
        rows = np.arange(len(score))
        best = np.clip(score.argmax(axis=1), 1, len(positions) - 2)
        # To the nearest top of the step's strength, then to a fraction by a parabola.
        for _ in range(3):
            left, here, right = (strength[rows, best + d] for d in (-1, 0, 1))
            best = best + np.where((right > here) & (right >= left), 1, 0)
            best = best - np.where((left > here) & (left > right), 1, 0)
            best = np.clip(best, 1, len(positions) - 2)
        left, here, right = (strength[rows, best + d] for d in (-1, 0, 1))
        bend = left - 2.0 * here + right
        peak = (bend < 0.0) & (here >= left) & (here >= right) & (here > noise)
        fraction = np.where(peak, 0.5 * (left - right) / np.where(peak, bend, 1.0), 0.0)
        offset = positions[best] + np.clip(fraction, -0.5, 0.5) / half
        height, width = regions.shape
        found = rim.pixels + offset[:, None] * rim.normals
        shown = ((found >= 0.0) & (found <= [width - 1, height - 1])).all(axis=1)
        return RimEdges(np.where(peak & shown & counts, offset, np.nan), counts)


def find_edges(photo: Photo, view: SurfaceView, rim: Rim, reach_px: float) -> RimEdges:
    """The photo's edges along a rim's normals; see ``EdgeImage.edges``."""
    image = EdgeImage.of(photo, (view.camera.width, view.camera.height))
    return image.edges(rim, object_regions(view.covered, reach_px), reach_px)


def _at(mask: Bool[np.ndarray, "h w"], at: Float[np.ndarray, "n k 2"]) -> np.ndarray:
    """The mask at the pixels nearest to ``at``, beyond the border that on it."""
    height, width = mask.shape
    columns = np.clip(np.rint(at[..., 0]).astype(int), 0, width - 1)
    rows = np.clip(np.rint(at[..., 1]).astype(int), 0, height - 1)
    return mask[rows, columns]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RimTerm:
    """Distance of one photo's rim from the photo's edges: a term of the polish."""

    photo: int
    """Index of the photo."""
    rim: Rim
    edges: Float[np.ndarray, "n 2"]
    """The edge that each rim point should fall on, in pixels of the view."""
    cell_starts: Int[np.ndarray, "bounds"]
    """First point of each segment of the rim; points are in its order."""
    cells: Int[np.ndarray, "segments 2"]
    """Column and row of each segment's cell."""
    size: tuple[int, int]
    """Width and height of the view."""
    increments: Increments
    sigma: float
    """Residual scale within segments, in pixels of the view."""
    tau: float
    """Spread of the segments' offsets, in pixels of the view."""
    outline: float
    """Spread of the whole outline's offset, in pixels of the view."""
    weight: float
    """Independent residuals, as a share of the points."""

    @classmethod
    def measured(
        cls,
        photo: int,
        rim: Rim,
        edges: RimEdges,
        size: tuple[int, int],
        increments: Increments,
        outline_px: float,
        weight: float,
    ) -> "RimTerm | None":
        """The term with its noise measured; None where too few edges were found."""
        found = np.isfinite(edges.offset_px)
        if found.sum() < 4 * SEGMENT_POINTS:
            return None
        cells = np.floor(rim.pixels[found] / (SEGMENT_SIDE * rim.stride_px))
        cells = cells.astype(np.int64)
        key = cell_keys(cells)
        order = np.argsort(key, kind="stable")
        cells, key, index = cells[order], key[order], np.flatnonzero(found)[order]
        rim = dataclasses.replace(
            rim,
            points=rim.points[index],
            pixels=rim.pixels[index],
            normals=rim.normals[index],
        )
        offset = edges.offset_px[index]
        starts = starts_of_cells(key)
        counts = np.diff(starts)
        medians = _medians(offset, key, starts)
        inner = offset - np.repeat(medians, counts)
        # Of a few points the median says too little.
        whole = counts >= SEGMENT_POINTS // 2
        if not whole.any():
            return None
        inner = np.abs(inner[np.repeat(whole, counts)])
        sigma = max(1.4826 * float(np.median(inner)), MIN_SIGMA_PX)
        centred = medians[whole] - np.median(medians[whole])
        spread = (1.4826 * float(np.median(np.abs(centred)))) ** 2
        noise = sigma**2 * float(np.mean(1.0 / counts[whole]))
        tau = np.sqrt(max(spread - noise, 0.0))
        return cls(
            photo=photo,
            rim=rim,
            edges=rim.pixels + offset[:, None] * rim.normals,
            cell_starts=starts,
            cells=cells[starts[:-1]],
            size=size,
            increments=increments,
            sigma=sigma,
            tau=float(max(tau, 1e-3)),
            outline=outline_px,
            weight=weight,
        )

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and normal equations at ``x``."""
        residual, rows = self._residuals(x)
        weights, error, cost = self._offsets(residual)
        J = -np.einsum("nd,ndp->np", self.rim.normals, rows) / self.sigma
        *_, normal, last = self._system(J, weights)
        # Without the outline's offset, too.
        normal = normal[:-1, :-1] - np.outer(normal[:-1, -1], normal[-1, :-1]) / last
        return Quadratic(cost, J.T @ (weights * error), normal, self.rows)

    def tempered(self, x: Float[np.ndarray, "p"]) -> "RimTerm":
        """The term weighted by what its segments know at ``x``; see ``PairTerm``."""
        ratio = overdispersion(*self._own_scores(x))
        return dataclasses.replace(self, weight=self.weight / ratio)

    def scatter(self, x: Float[np.ndarray, "p"]) -> Float[np.ndarray, "k k"]:
        """Covariance of the gradient at ``x``, of ``rows``."""
        return scatter(*self._own_scores(x))

    def mesh_scatter(
        self, x: Float[np.ndarray, "p"], field: MeshField
    ) -> Float[np.ndarray, "k k"]:
        """Covariance of the gradient at ``x``, of ``rows``, by the mesh's own error.

        Each segment is off as a whole; what offsets take of that is not in it.
        """
        residual, rows = self._residuals(x)
        weights, _, _ = self._offsets(residual)
        J = -np.einsum("nd,ndp->np", self.rim.normals, rows) / self.sigma
        camera = self.increments.camera(x[self._own]).resized(*self.size)
        depth = camera.to_camera(self.rim.points)[:, 2]
        by_mesh = camera.focal_px / depth / self.sigma
        A, sums, totals, normal, last = self._system(J, weights)
        starts = self.cell_starts[:-1]
        slopes = np.add.reduceat((weights * by_mesh)[:, None] * A, starts)
        taken = np.add.reduceat(weights * by_mesh, starts) / totals
        slopes -= taken[:, None] * sums
        slopes = slopes[:, :-1] - np.outer(slopes[:, -1], normal[-1, :-1]) / last
        places = cell_means(self.rim.points, self.cell_starts)
        return field.scatter(places, slopes)

    def _system(
        self, J: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """The normal equations with the segments' offsets eliminated.

        Returns:
            Rows of the camera's numbers and of the outline's offset; their weighted sums
            over each segment; what each segment's offset is divided by; the normal
            matrix; and what the outline's offset is divided by.
        """
        A = np.column_stack([J, np.ones(len(J))])
        wA = weights[:, None] * A
        sums = np.add.reduceat(wA, self.cell_starts[:-1], axis=0)
        precision = self.weight * (self.sigma / self.tau) ** 2
        totals = np.add.reduceat(weights, self.cell_starts[:-1]) + precision
        normal = A.T @ wA - (sums / totals[:, None]).T @ sums
        last = float(normal[-1, -1]) + (self.sigma / self.outline) ** 2
        return A, sums, totals, normal, last

    def _own_scores(
        self, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Gradients of the segments, normal matrix and groupings where it would go.

        Where it is, if it cannot be evaluated there.
        """
        end = own_end(self.linearise(x), x, self.increments.limits, self._own)
        model = self.linearise(end)
        if model.is_finite:
            x = end
        else:
            model = self.linearise(x)
        residual, rows = self._residuals(x)
        weights, error, _ = self._offsets(residual)
        J = -np.einsum("nd,ndp->np", self.rim.normals, rows) / self.sigma
        parts = np.add.reduceat((weights * error)[:, None] * J, self.cell_starts[:-1])
        return (
            parts,
            model.normal,
            [cell_keys(self.cells // side) for side in BLOCK_SIDES],
        )

    @property
    def _own(self) -> slice:
        """The increments of this term's camera."""
        return self.increments.own(self.photo)

    @property
    def rows(self) -> Int[np.ndarray, "k"]:
        """This camera's numbers among the increments of all."""
        return numbers_of((self.photo,), (self.increments,))

    def _residuals(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        record = self.increments.record(x[self._own], *self.size)
        pixels, rows = rim_rows(record, self.rim.points, self.increments.n)
        residual = np.einsum("nd,nd->n", self.rim.normals, self.edges - pixels)
        return residual / self.sigma, rows

    def _offsets(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Weights, residuals after the offsets, and the cost."""
        starts, counts = self.cell_starts, np.diff(self.cell_starts)
        precision = self.weight * (self.sigma / self.tau) ** 2
        outline_precision = (self.sigma / self.outline) ** 2
        segments = cell_means(residual, starts)
        segments *= self.tau**2 / (self.tau**2 + self.sigma**2 / counts)
        outline = 0.0
        for _ in range(6):
            error = residual - outline - np.repeat(segments, counts)
            w = self.weight / (1.0 + (error / CUT) ** 2)
            without = w * (residual - outline)
            segments = np.add.reduceat(without, starts[:-1]) / (
                np.add.reduceat(w, starts[:-1]) + precision
            )
            rest = residual - np.repeat(segments, counts)
            outline = float(w @ rest) / (float(w.sum()) + outline_precision)
        error = residual - outline - np.repeat(segments, counts)
        cost = (
            self.weight * 0.5 * CUT**2 * float(np.log1p((error / CUT) ** 2).sum())
            + 0.5 * precision * float(segments @ segments)
            + 0.5 * outline_precision * outline**2
        )
        return self.weight / (1.0 + (error / CUT) ** 2), error, cost


def _medians(
    values: Float[np.ndarray, "n"],
    keys: Int[np.ndarray, "n"],
    starts: Int[np.ndarray, "bounds"],
) -> Float[np.ndarray, "segments"]:
    """Median of each segment's values; ``keys`` are in order, and begin at ``starts``."""
    ordered = values[np.lexsort((values, keys))]
    counts = np.diff(starts)
    low, high = starts[:-1] + (counts - 1) // 2, starts[:-1] + counts // 2
    return 0.5 * (ordered[low] + ordered[high])
