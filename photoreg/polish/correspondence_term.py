"""Correspondences of two photos as a term of the polish, in pixels.

A residual is how far the own photo shows a place of the surface from where it should,
given where the other photo shows it. Its covariance is that of the match, plus what is left
all round, plus what the mesh's own error does: off along its normal, the surface takes
the place along the epipolar line, and only there.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from photoreg.parameters.increments import Increments, numbers_of
from photoreg.polish.correspondences import Correspondences
from photoreg.polish.grid_cells import cell_keys, cells_at, starts_of_cells
from photoreg.polish.kernels import rim_rows
from photoreg.polish.levenberg_marquardt import (
    Quadratic,
    overdispersion,
    own_end,
    scatter,
)
from photoreg.polish.mesh_field import MeshField, fit_mesh_field
from photoreg.polish.patch_kernels import WINDOW_SIGMA, transfer_equations

CUT = 2.0
"""Scale of the Cauchy cost in residual sigmas."""
BLOCK_SIDES = (1, 2, 4)
"""Sides, in cells, of the blocks over which errors may be alike."""
NOISE_PASSES = 3
"""How often the noise is measured anew, each time where the term would go with the last."""
CHI_SQUARE_MEDIAN = 0.4549
"""Median of the square of a standard normal number."""
MIN_CELLS = 20
"""Fewer do not show over what length the mesh's error is correlated."""
WINDOW_PX2 = 4.0 * np.pi * WINDOW_SIGMA**2
"""Area of a patch's window: patches nearer to each other are partly redundant."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CorrespondenceTerm:
    """Correspondences of a pair of photos, both ways: a term of the polish."""

    pair: tuple[int, int]
    """Indices of the photos."""
    ways: tuple[Correspondences, Correspondences]
    """Found in the first photo, and in the second, each sorted by cell."""
    cells: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]]
    """The cell of each correspondence, in the first photo."""
    sizes: tuple[tuple[int, int], tuple[int, int]]
    """Width and height of the two views."""
    increments: tuple[Increments, Increments]
    weight: float
    sigma_px: float = 0.0
    """Standard deviation of what is left all round beyond the matches' own noise."""
    mesh_sigma: float = 0.0
    """Standard deviation of the mesh's error along its normal, in model units."""

    @classmethod
    def measured(
        cls,
        pair: tuple[int, int],
        ways: tuple[Correspondences, Correspondences],
        sizes: tuple[tuple[int, int], tuple[int, int]],
        increments: tuple[Increments, Increments],
        x: Float[np.ndarray, "p"],
        cell_px: float,
        weight: float,
    ) -> "CorrespondenceTerm":
        """The term with its noise measured near ``x``.

        Args:
            pair: Indices of the photos.
            ways: Correspondences found in the first photo, and in the second.
            sizes: Of the two views.
            increments: Of the two cameras.
            x: Increments of all cameras.
            cell_px: Side of a cell in pixels of the first view.
            weight: Of an independent correspondence.
        """
        sorted_ways, cells = [], []
        for way, first_px in zip(ways, (ways[0].own_px, ways[1].other_px), strict=True):
            key = cell_keys(np.floor(first_px / cell_px).astype(np.int64))
            order = np.argsort(key, kind="stable")
            sorted_ways.append(_taken(way, order))
            cells.append(key[order])
        term = cls(
            pair=pair,
            ways=(sorted_ways[0], sorted_ways[1]),
            cells=(cells[0], cells[1]),
            sizes=sizes,
            increments=increments,
            weight=weight * _share(ways),
        )
        at = x
        for _ in range(NOISE_PASSES):
            at = term._own_end(at)
            term = term.with_noise_of(at)
        return term

    @property
    def rows(self) -> np.ndarray:
        """This pair's numbers among the increments of all cameras."""
        return numbers_of(self.pair, self.increments)

    @property
    def mesh_sigma_px(self) -> float:
        """How far the mesh's error moves a place along its epipolar line, in pixels."""
        along = np.concatenate([way.along_normal for way in self.ways])
        return self.mesh_sigma * float(np.median(np.linalg.norm(along, axis=1)))

    def residuals(
        self, x: Float[np.ndarray, "p"]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals (n, 2) in pixels and their derivatives (n, 2, p), of both ways."""
        n = self.increments[0].n
        records = [
            increment.record(x[increment.own(i)], *size)
            for i, increment, size in zip(
                self.pair, self.increments, self.sizes, strict=True
            )
        ]
        out = []
        for own, way in enumerate(self.ways):
            at_own, by_own = rim_rows(records[own], way.points, n)
            at_other, by_other = rim_rows(records[1 - own], way.points, n)
            # To first order: the other photo's ray moves along the tangent plane.
            error = at_own - way.own_px
            gap = at_other - way.other_px
            J = np.zeros((len(error), 2, 2 * n))
            J_own = slice(own * n, (own + 1) * n)
            J_other = slice((1 - own) * n, (2 - own) * n)
            J[:, :, J_own] = by_own
            for k in range(2):
                error -= way.transfer[:, :, k] * gap[:, k : k + 1]
                J[:, :, J_other] -= (
                    way.transfer[:, :, k, None] * by_other[:, k, None, :]
                )
            out.append((error, J))
        return out

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and normal equations at ``x``."""
        cost, gradients, normals = self._sums(x)
        return Quadratic(cost, gradients.sum(axis=0), normals, self.rows)

    def tempered(self, x: Float[np.ndarray, "p"]) -> "CorrespondenceTerm":
        """The term weighted by what it knows at ``x``; see ``PairTerm``."""
        return dataclasses.replace(
            self, weight=self.weight / overdispersion(*self._own_scores(x))
        )

    def scatter(self, x: Float[np.ndarray, "p"]) -> Float[np.ndarray, "k k"]:
        """Covariance of the gradient at ``x``, of ``rows``."""
        return scatter(*self._own_scores(x))

    def mesh_scatter(
        self, x: Float[np.ndarray, "p"]
    ) -> tuple[MeshField, Float[np.ndarray, "k k"]]:
        """The mesh's own error, and the covariance by it of the gradient at ``x``.

        The latter is of ``rows``. Both are 0 where there are too few cells to measure them.
        """
        keys, cell = np.unique(np.concatenate(self.cells), return_inverse=True)
        m, p = len(keys), len(self.rows)
        by_mesh, by_cameras = np.zeros((m, p)), np.zeros((m, p))
        known, errors, places, counts = (np.zeros((m, k)) for k in (1, 1, 3, 1))
        begin = 0
        for (error, J), way in zip(self.residuals(x), self.ways, strict=True):
            own = cell[begin : begin + len(error)]
            begin += len(error)
            whitening = self._whitening(way)
            squares = (np.einsum("nij,nj->ni", whitening, error) ** 2).sum(axis=1)
            trust = 1.0 / (1.0 + squares / CUT**2)
            pull = np.einsum("nji,njk,nk->ni", whitening, whitening, way.along_normal)
            np.add.at(
                by_mesh,
                own,
                self.weight * trust[:, None] * np.einsum("ni,nip->np", pull, J),
            )
            alone = way.covariance + self.sigma_px**2 * np.eye(2)
            pull = np.linalg.solve(alone, way.along_normal[:, :, None])[:, :, 0]
            pull *= _share(self.ways) * trust[:, None]
            np.add.at(by_cameras, own, np.einsum("ni,nip->np", pull, J))
            np.add.at(known, own, (pull * way.along_normal).sum(axis=1, keepdims=True))
            np.add.at(errors, own, (pull * error).sum(axis=1, keepdims=True))
            np.add.at(places, own, way.points)
            np.add.at(counts, own, 1.0)
        told = known[:, 0] > 1e-6 * np.median(known)
        if told.sum() < MIN_CELLS:
            return MeshField(0.0, 0.0), np.zeros((p, p))
        places = (places / counts)[told]
        known = known[told]
        field = fit_mesh_field(
            (errors[told] / known)[:, 0],
            1.0 / known[:, 0],
            by_cameras[told] / known,
            places,
        )
        return field, field.scatter(places, by_mesh[told])

    def with_noise_of(self, x: Float[np.ndarray, "p"]) -> "CorrespondenceTerm":
        """The term with the noise that its residuals have at ``x``.

        By medians, so that wrong matches do not count: across the epipolar line, what is left
        beyond the matches' noise; along it, what is left beyond both.
        """
        across, along = [], []
        for (error, _), way in zip(self.residuals(x), self.ways, strict=True):
            reach = np.linalg.norm(way.along_normal, axis=1)
            line = way.along_normal / np.maximum(reach, 1e-300)[:, None]
            side = np.column_stack([-line[:, 1], line[:, 0]])
            own = [
                np.einsum("ni,nij,nj->n", direction, way.covariance, direction)
                for direction in (side, line)
            ]
            better = own[0] + own[1] <= np.median(own[0] + own[1]) if len(reach) else []
            across.append(
                np.column_stack(
                    [
                        np.einsum("ni,ni->n", side, error) ** 2,
                        own[0],
                        np.ones(len(reach)),
                    ]
                )[better]
            )
            along.append(
                np.column_stack(
                    [np.einsum("ni,ni->n", line, error) ** 2, own[1], reach**2]
                )[better]
            )
        squares, noise, unit = np.concatenate(across).T
        variance = extra_variance(squares, noise, unit)
        squares, noise, unit = np.concatenate(along).T
        mesh_variance = extra_variance(squares, noise + variance, unit)
        return dataclasses.replace(
            self, sigma_px=np.sqrt(variance), mesh_sigma=np.sqrt(mesh_variance)
        )

    def _whitening(self, way: Correspondences) -> Float[np.ndarray, "n 2 2"]:
        covariance = way.covariance + self.sigma_px**2 * np.eye(2)
        line = self.mesh_sigma * way.along_normal
        covariance = covariance + line[:, :, None] * line[:, None, :]
        return np.linalg.inv(np.linalg.cholesky(covariance))

    def _sums(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost, gradients by cell of both ways in turn, and the normal matrix."""
        cost, gradients, normal = 0.0, [], np.zeros((len(self.rows),) * 2)
        for (error, J), way, cells in zip(
            self.residuals(x), self.ways, self.cells, strict=True
        ):
            part, by_cell, more = transfer_equations(
                error,
                J,
                self._whitening(way),
                np.full(len(error), self.weight),
                starts_of_cells(cells),
                CUT,
            )
            cost += part
            gradients.append(by_cell)
            normal += more
        return cost, np.concatenate(gradients), normal

    def _own_scores(
        self, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Gradients of cells, normal matrix and groupings where the term would go."""
        _, gradients, normal = self._sums(self._own_end(x))
        if not (np.isfinite(gradients).all() and np.isfinite(normal).all()):
            _, gradients, normal = self._sums(x)
        keys = np.concatenate([np.unique(cells) for cells in self.cells])
        cells = cells_at(keys)
        return gradients, normal, [cell_keys(cells // side) for side in BLOCK_SIDES]

    def _own_end(self, x: np.ndarray) -> np.ndarray:
        limits = np.concatenate([one.limits for one in self.increments])
        return own_end(self.linearise(x), x, limits, self.rows)


def _share(ways: tuple[Correspondences, Correspondences]) -> float:
    """How much of a correspondence is independent: others are partly redundant.

    Each place is found twice, from either photo to the other, and windows overlap.
    """
    return 0.5 * min(1.0, ways[0].stride_px * ways[1].stride_px / WINDOW_PX2)


def extra_variance(
    squares: Float[np.ndarray, "n"],
    noise: Float[np.ndarray, "n"],
    unit: Float[np.ndarray, "n"],
) -> float:
    """The variance v for which squares / (noise + v unit) has the median of chance.

    0 where noise alone explains them.
    """
    if len(squares) == 0:
        return 0.0

    def excess(variance: float) -> float:
        spread = np.maximum(noise + variance * unit, 1e-300)
        return float(np.median(squares / spread)) - CHI_SQUARE_MEDIAN

    if excess(0.0) <= 0.0:
        return 0.0
    high = float(np.max(squares / np.maximum(unit, 1e-300))) / CHI_SQUARE_MEDIAN
    low = 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return high


def _taken(way: Correspondences, order: np.ndarray) -> Correspondences:
    arrays: Sequence[str] = (
        "points",
        "own_px",
        "shifts_px",
        "other_px",
        "transfer",
        "along_normal",
        "covariance",
    )
    return dataclasses.replace(
        way, **{name: getattr(way, name)[order] for name in arrays}
    )
