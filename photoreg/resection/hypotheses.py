"""The search for a camera that explains point pairs, some of them grossly wrong.

The poses come from OpenCV: P3P of triples and SQPnP of all pairs. Which triples, and which
explanation is the best, is decided here: OpenCV's own choice (USAC, MAGSAC) knows no
prior of the focal length and no price of a pair left out. In four runs with gross pairs
on the bench's temple the triples found these in all, SQPnP alone in three, and USAC in
place of the triples in two, taking four times as long.
"""

import itertools
from collections.abc import Sequence

import cv2
import numpy as np

from photoreg.errors import InputError
from photoreg.geometry.rotations import rotation_matrices
from photoreg.resection import pinhole_model
from photoreg.resection.pinhole_model import Models, Pairs

NOISE_FACTORS = (1.0, 2.0, 4.0)
"""How much worse than expected all clicks may be, before some are called outliers."""
OUTLIER_SHARE = 0.1
"""Share of pairs expected to be grossly wrong, anywhere in the photo."""
MOST_TWO_FLIPS = 10
"""Up to this many pairs, explanations that differ in two are compared; beyond, in one."""
MAX_TRIPLES = 24
"""At most so many triples give hypotheses; they take most of the time."""


class HypothesisSearch:
    """Hypotheses, robust refinement, and the choice of the best explanation."""

    def __init__(
        self, pairs: Pairs, n_free: int, n_pixels: int, click_sigma_px: float, seed: int
    ) -> None:
        self.pairs = pairs
        self.n_free = n_free
        self.n_pixels = n_pixels
        self.click_sigma_px = click_sigma_px
        self.triples = _triples(pairs, seed)
        # Fewer pairs than this always agree on some camera.
        self.least = max(4 if n_free == 6 else 5, len(pairs.X) // 2 + 1)
        spread = pairs.log_f_sigma
        steps = [0.0] if n_free == 6 else [-spread, 0.0, spread]
        if spread > 0.3 and n_free > 6:
            steps = [
                -1.4 * spread,
                -0.5 * spread,
                0.3 * spread,
                1.2 * spread,
                2.2 * spread,
            ]
        self.log_fs = [pairs.log_f + step for step in steps]

    def best(self) -> tuple[Models, np.ndarray, float, bool]:
        """The best model, its inliers, the noise, and whether another is as good."""
        few = max(4, 24 // len(self.log_fs))
        models = self._hypotheses(self.triples[:few], whole=True)
        everything = np.ones((1, len(self.pairs.X)), dtype=bool)
        found: list[tuple[Models, np.ndarray, np.ndarray, float]] = []
        if len(models) > 0:
            start = self._best_by_score(models, self.click_sigma_px, 12)
            start, _ = self._fit(start, self.click_sigma_px, None, 12)
            found += self._judged(start, everything)
        sigma = self.click_sigma_px
        if not found or min(f[1].min() for f in found) > self._price(sigma):
            # Leaving out even one pair costs as much: only then look for outliers.
            more = self._hypotheses(self.triples[few:], whole=False)
            models = pinhole_model.joined(
                [m for m in (models, more) if len(m) > 0] or [more]
            )
            if len(models) > 0:
                found += self._robust(models)
        found = [f for f in found if len(f[0]) > 0]
        if not found:
            raise InputError(
                "No camera sees these points like this; check that each number marks the same "
                "point in the photo and on the surface."
            )
        models = pinhole_model.joined([f[0] for f in found])
        costs = np.concatenate([f[1] for f in found])
        inliers = np.concatenate([f[2] for f in found])
        sigmas = np.concatenate([np.full(len(f[0]), f[3]) for f in found])
        best = int(np.argmin(costs))
        turned = models.R @ models.R[best].T
        angle = np.arccos(
            np.clip(0.5 * (np.trace(turned, axis1=1, axis2=2) - 1), -1, 1)
        )
        twin = bool(np.any((angle > 0.1) & (costs < costs[best] + 3.0)))
        return models[best : best + 1], inliers[best], float(sigmas[best]), twin

    def _price(self, sigma_px: float) -> float:
        """What leaving a pair out costs, in squared standard errors.

        Twice the logarithm of how much likelier a pair at its place is under a click's
        error than anywhere in the photo by mistake.
        """
        density = self.n_pixels / (2.0 * np.pi * sigma_px**2)
        return 2.0 * float(
            np.log(max(density, 2.0) * (1 - OUTLIER_SHARE) / OUTLIER_SHARE)
        )

    def _robust(
        self, models: Models
    ) -> list[tuple[Models, np.ndarray, np.ndarray, float]]:
        """Explanations with outliers, and with clicks worse than expected."""
        found = []
        for factor in NOISE_FACTORS:
            sigma = factor * self.click_sigma_px
            # The first round leaves few models worth another.
            models = self._best_by_score(models, sigma, 16 if factor == 1.0 else 8)
            scales = ((12.0, 6), (4.0, 5)) if factor == 1.0 else ((4.0, 4),)
            for scale, n_steps in scales:
                models, _ = pinhole_model.fit(
                    models, self.pairs, self.n_free, sigma, None, scale * sigma, n_steps
                )
            inliers = self._inliers(models, sigma)
            few, _ = self._fit(models, sigma, inliers, 4)
            found += self._judged(few, self._inliers(few, sigma), sigma)
            if factor == 1.0:
                found += self._neighbours(found[-1])
            else:
                everything = np.ones_like(inliers)
                few, _ = self._fit(models, sigma, everything, 6)
                found += self._judged(few, everything[:1], sigma)
        return found

    def _neighbours(
        self, found: tuple[Models, np.ndarray, np.ndarray, float]
    ) -> list[tuple[Models, np.ndarray, np.ndarray, float]]:
        """Explanations that differ from the best by one or two pairs, in or out."""
        models, costs, inliers, sigma = found
        n = len(self.pairs.X)
        flips = [*itertools.combinations(range(n), 1)]
        if n <= MOST_TWO_FLIPS:
            flips += itertools.combinations(range(n), 2)
        changed = np.zeros((len(flips), n), dtype=bool)
        for row, flip in enumerate(flips):
            changed[row, list(flip)] = True
        better = []
        for _ in range(2):
            if len(costs) == 0:
                break
            best = int(np.argmin(costs))
            sets = inliers[best] ^ changed
            sets = sets[sets.sum(axis=1) >= self.least]
            start = models[np.full(len(sets), best)]
            start, _ = self._fit(start, sigma, sets, 5)
            better += self._judged(start, sets, sigma)
            models, new_costs, inliers, sigma = better[-1]
            if len(new_costs) == 0 or new_costs.min() >= costs.min():
                break
            costs = new_costs
        return better

    def _fit(
        self, models: Models, sigma: float, inliers: np.ndarray | None, n_steps: int
    ) -> tuple[Models, np.ndarray]:
        weights = None if inliers is None else inliers.astype(np.float64)
        return pinhole_model.fit(
            models, self.pairs, self.n_free, sigma, weights, np.inf, n_steps
        )

    def _squared(self, models: Models) -> np.ndarray:
        offsets = pinhole_model.project(models, self.pairs.X, self.pairs.A)
        return ((offsets - self.pairs.pixels) ** 2).sum(axis=2)

    def _inliers(self, models: Models, sigma: float) -> np.ndarray:
        """Pairs worth their price; never fewer than the least."""
        squared = self._squared(models)
        inliers = squared < self._price(sigma) * sigma**2
        nearest = np.argsort(squared, axis=1)[:, : self.least]
        np.put_along_axis(inliers, nearest, True, axis=1)
        return inliers

    def _judged(
        self, models: Models, inliers: np.ndarray, sigma: float | None = None
    ) -> list[tuple[Models, np.ndarray, np.ndarray, float]]:
        """Models with all inliers in front, and what each explanation costs."""
        sigma = sigma or self.click_sigma_px
        inliers = np.broadcast_to(inliers, (len(models), len(self.pairs.X)))
        front = np.all(
            (pinhole_model.depths(models, self.pairs.X) > 0.01) | ~inliers, axis=1
        )
        models, inliers = models[front], inliers[front]
        steps = self.pairs.prior_steps(models)[:, : self.n_free]
        noisier = np.log(sigma / self.click_sigma_px)
        cost = (
            np.where(
                inliers, self._squared(models) / sigma**2 + 4.0 * noisier, 0.0
            ).sum(1)
            + self._price(self.click_sigma_px) * (~inliers).sum(axis=1)
            + steps**2 @ self.pairs.prior_weights[: self.n_free]
            + (noisier / 0.5) ** 2
        )
        return [(models, cost, inliers, sigma)]

    def _best_by_score(self, models: Models, sigma: float, n: int) -> Models:
        """The n models that agree best, most pairs counting more than the worst ones."""
        loose = 10.0 * sigma
        score = np.log1p(self._squared(models) / loose**2).sum(axis=1)
        return models[np.argsort(score, kind="stable")[:n]]

    def _hypotheses(self, triples: Sequence[np.ndarray], whole: bool) -> Models:
        """Poses of each triple, and of all pairs, for each focal length."""
        pairs, parts = self.pairs, []
        for log_f in self.log_fs:
            rays = np.linalg.solve(pairs.A, (pairs.pixels - pairs.c).T).T / np.exp(
                log_f
            )
            vectors, shifts = [], []
            for triple in triples:
                _, r, t = cv2.solveP3P(
                    pairs.X[triple],
                    rays[triple],
                    np.eye(3),
                    None,
                    flags=cv2.SOLVEPNP_AP3P,
                )
                vectors += list(r)
                shifts += list(t)
            if whole:
                _, r, t, _ = cv2.solvePnPGeneric(
                    pairs.X, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
                )
                vectors += list(r)
                shifts += list(t)
            if vectors:
                parts.append(self._models(np.array(vectors), np.array(shifts), log_f))
        if not parts:
            return self._models(np.zeros((0, 3, 1)), np.zeros((0, 3, 1)), 0.0)
        return pinhole_model.joined(parts)

    def _models(self, vectors: np.ndarray, shifts: np.ndarray, log_f: float) -> Models:
        vectors, shifts = vectors.reshape(-1, 3), shifts.reshape(-1, 3)
        usable = np.isfinite(vectors).all(axis=1) & np.isfinite(shifts).all(axis=1)
        usable &= shifts[:, 2] > 1e-3
        vectors, shifts = vectors[usable], shifts[usable]
        m, f = len(vectors), np.exp(log_f)
        c = np.broadcast_to(self.pairs.c, (m, 2))
        a = c + f * (shifts[:, :2] / shifts[:, 2:]) @ self.pairs.A.T
        log_s = log_f - np.log(shifts[:, 2])
        return Models(rotation_matrices(vectors), a, log_s, np.full(m, log_f), c)


def _triples(pairs: Pairs, seed: int) -> list[np.ndarray]:
    """Triples of pairs, the widest in the photo first, then a seeded mix."""
    n = len(pairs.X)
    if n <= 12:
        triples = np.array(list(itertools.combinations(range(n), 3)))
    else:
        rng = np.random.default_rng(seed)
        triples = np.array([rng.choice(n, 3, replace=False) for _ in range(220)])
    areas = []
    for places in (pairs.X, pairs.pixels):
        first, second = (places[triples[:, k]] - places[triples[:, 0]] for k in (1, 2))
        gram = (first**2).sum(1) * (second**2).sum(1) - (first * second).sum(1) ** 2
        areas.append(np.sqrt(np.maximum(gram, 0.0)))
    usable = (areas[0] > 1e-3) & (areas[1] > 1e-6 * pairs.unit_px**2)
    triples, areas = triples[usable], areas[1][usable]
    order = np.argsort(-areas, kind="stable")
    return list(triples[order][:MAX_TRIPLES])
