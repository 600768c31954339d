"""The last stage of the polish: correspondences, with what colours and outlines add.

Where photos differ in appearance by a little over large areas, colours pull both cameras
along the surface together, by pixels, though the photos lie on each other within a
fraction of one. Matched patches do not see such differences. So they lead, and
colours and outlines count as far as their own scatter, and their agreement with the
correspondences, allow.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import surface_views
from photoreg.imaging.pairs import points_of_pair, weight_of_pair
from photoreg.imaging.photo import Pair, Photo
from photoreg.parameters.increments import Increments
from photoreg.polish.correspondence_term import CorrespondenceTerm
from photoreg.polish.correspondences import Correspondences, find_correspondences
from photoreg.polish.disagreement import MeshError
from photoreg.polish.levenberg_marquardt import (
    Damping,
    Iterate,
    Prior,
    among_all,
    minimise,
    total,
)
from photoreg.polish.mesh_field import MeshField
from photoreg.polish.photometric_term import PairTerm
from photoreg.polish.sandwich_term import SURPRISE, SandwichTerm
from photoreg.polish.silhouette_term import RimTerm

CELL_PX = 48.0
"""Side of the cells over which errors are summed, in pixels of a photo 1,024 px wide."""
MIN_CORRESPONDENCES = 200
"""Fewer, both ways together, say nothing about their own noise."""
MAX_SIGMA_PX = 1.0
"""Matches that scatter by more all round are found by chance: those scatter by 2."""


@dataclasses.dataclass(frozen=True, eq=False)
class CorrespondenceStep:
    """One step of the last stage."""

    iterate: Iterate
    mesh_error: MeshError
    """In pixels of the views."""
    warnings: tuple[str, ...]
    """Which terms disagree beyond their noise, in sentences."""
    scatter: Float[np.ndarray, "p p"] | None = None
    """Of the last one only: covariance of the cost's gradient."""


def correspondence_terms(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    increments: Sequence[Increments],
    x: Float[np.ndarray, "p"],
    n_patches: int,
    min_cosine: float,
    pairs: Sequence[Pair],
) -> list[CorrespondenceTerm]:
    """A term for every one of ``pairs`` in which enough is found.

    Args:
        mesh: The surface.
        photos: All photos.
        cameras: Their cameras at ``x``, of the size in which patches are looked for.
        increments: Of all cameras.
        x: Where to look.
        n_patches: At most about so many, over all pairs and either way; see
            ``points_of_pair``.
        min_cosine: Least cosine between the surface's normal and the view.
        pairs: Which photos are compared.
    """
    terms = []
    found = _both_ways(mesh, photos, cameras, n_patches, min_cosine, pairs)
    for (i, k), ways in zip(pairs, found, strict=True):
        if sum(len(way.points) for way in ways) < MIN_CORRESPONDENCES:
            continue
        term = CorrespondenceTerm.measured(
            (i, k),
            ways,
            (
                (cameras[i].width, cameras[i].height),
                (cameras[k].width, cameras[k].height),
            ),
            (increments[i], increments[k]),
            x,
            CELL_PX * cameras[i].width / 1024.0,
            weight_of_pair(1.0, len(photos), len(pairs)),
        )
        if term.sigma_px <= MAX_SIGMA_PX:
            terms.append(term)
    return terms


def median_shift_px(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    n_patches: int,
    min_cosine: float,
    pairs: Sequence[Pair],
) -> float | None:
    """How far off the photos' details are, carried over the surface onto each other.

    It distinguishes better cameras from worse ones where colours drift slowly, as in haze:
    patches are matched whatever their brightness. A patch that is not found counts as
    farther off than all others, so that cameras gain nothing by what they no longer share.

    Args:
        mesh: The surface.
        photos: All photos.
        cameras: Their cameras, of the size in which patches are looked for.
        n_patches: As for ``correspondence_terms``.
        min_cosine: Least cosine between the surface's normal and the view.
        pairs: Which photos are compared.

    Returns:
        The median over all patches of all pairs, in pixels of ``cameras``; None where it
        is not found, or fewer than ``MIN_CORRESPONDENCES`` are.
    """
    found = _both_ways(mesh, photos, cameras, n_patches, min_cosine, pairs)
    ways = list(itertools.chain.from_iterable(found))
    shifts_px = np.concatenate([way.shifts_px for way in ways])
    if len(shifts_px) < MIN_CORRESPONDENCES:
        return None
    n_lost = sum(way.n_looked_for for way in ways) - len(shifts_px)
    median = float(np.median(np.append(shifts_px, np.full(n_lost, np.inf))))
    return median if np.isfinite(median) else None


def _both_ways(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    n_patches: int,
    min_cosine: float,
    pairs: Sequence[Pair],
) -> Iterator[tuple[Correspondences, Correspondences]]:
    """What is found of each pair, in its first photo and in its second."""
    views = surface_views(mesh, cameras)
    sides = list(zip(photos, views, strict=True))
    n = points_of_pair(n_patches, len(pairs), 0) // 2
    for i, k in pairs:
        yield (
            find_correspondences(mesh, sides[i], sides[k], n, min_cosine),
            find_correspondences(mesh, sides[k], sides[i], n, min_cosine),
        )


def polish_by_correspondences(
    terms: Sequence[CorrespondenceTerm],
    others: Sequence[PairTerm | RimTerm],
    names: Sequence[str],
    prior: Prior,
    x: Float[np.ndarray, "p"],
    damping: Damping,
    directions: Float[np.ndarray, "p q"],
    limits: Float[np.ndarray, "p"],
) -> Iterator[CorrespondenceStep]:
    """First to where correspondences alone lead, then to where all terms do.

    Args:
        terms: At least one.
        others: Colours and outlines, with the noise of the level before.
        names: Names of the photos.
        prior: The pre-registration.
        x: Where to begin.
        damping: Of the minimisations.
        directions: What may move.
        limits: Of each number.
    """
    sigmas = [(term.mesh_sigma, term.mesh_sigma_px) for term in terms]
    mesh_error = MeshError(*np.median(sigmas, axis=0).tolist())
    last = None
    leading = [term.tempered(x) for term in terms]
    for step in minimise([prior, *leading], x, damping, directions, limits):
        x = step.x
        last = CorrespondenceStep(step, mesh_error, ())
        yield last
    by_mesh = _MeshErrors.of(leading, prior, x)
    trusted = [_weighed(term, x, by_mesh.scatter_of(term, x)) for term in leading]
    warnings: tuple[str, ...] = ()
    # Colours first: with them, an outline that disagrees is easier to recognise.
    for kind in (PairTerm, RimTerm):
        inner = total([prior, *trusted], x).along(directions)
        covariance = directions @ np.linalg.inv(inner.normal) @ directions.T
        for term in [term for term in others if isinstance(term, kind)]:
            more = by_mesh.scatter_of(term, x)
            doubted = _weighed(term, x, more).doubted(x, covariance)
            if doubted.surprise < SURPRISE:
                warnings += (_disagreement(term, names),)
            trusted.append(doubted)
        for step in minimise([prior, *trusted], x, damping, directions, limits):
            x = step.x
            last = CorrespondenceStep(step, mesh_error, warnings)
            yield last
    assert last is not None  # A minimisation yields its start at least.
    # Colours and correspondences come from the same pixels and the same mesh, so their
    # errors may be the same: the variance of a sum is at most twice the sum of variances.
    alike = [term for term in trusted if not isinstance(term.term, RimTerm)]
    scatter = last.iterate.model.normal + total(alike, x).normal
    yield dataclasses.replace(last, scatter=scatter)


@dataclasses.dataclass(frozen=True, eq=False)
class _MeshErrors:
    """What the mesh's own error, which is correlated over some length, does to each term."""

    fields: dict[tuple[int, int], MeshField]
    """Of the pairs that have correspondences."""
    scatters: dict[tuple[int, int], Float[np.ndarray, "k k"]]
    """Of their gradients."""
    moves: dict[tuple[int, int], Float[np.ndarray, "k k"]]
    """Covariance by it of the numbers of both cameras."""

    @classmethod
    def of(
        cls,
        terms: Sequence[CorrespondenceTerm],
        prior: Prior,
        x: Float[np.ndarray, "p"],
    ) -> "_MeshErrors":
        fields, scatters, moves = {}, {}, {}
        for term in terms:
            field, scatter = term.mesh_scatter(x)
            held = prior.precision[np.ix_(term.rows, term.rows)]
            inverse = np.linalg.inv(term.linearise(x).normal + held)
            fields[term.pair], scatters[term.pair] = field, scatter
            moves[term.pair] = inverse @ scatter @ inverse
        return cls(fields, scatters, moves)

    def scatter_of(
        self, term: CorrespondenceTerm | PairTerm | RimTerm, x: Float[np.ndarray, "p"]
    ) -> Float[np.ndarray, "k k"]:
        """Covariance of the term's gradient at ``x``, of its ``rows``."""
        if isinstance(term, RimTerm):
            own = [field for pair, field in self.fields.items() if term.photo in pair]
            field = max(own, key=lambda one: one.sigma, default=MeshField(0.0, 0.0))
            return term.mesh_scatter(x, field)
        if term.pair not in self.scatters:
            return np.zeros((len(term.rows),) * 2)
        if isinstance(term, CorrespondenceTerm):
            return self.scatters[term.pair]
        # What it does to the cameras by correspondences, it does by colours as well.
        normal = term.linearise(x).normal
        return normal @ self.moves[term.pair] @ normal


def _weighed(
    term: CorrespondenceTerm | PairTerm | RimTerm,
    x: Float[np.ndarray, "p"],
    more: Float[np.ndarray, "k k"],
) -> SandwichTerm:
    """The term, its scatter being that of its blocks and ``more``."""
    model = term.linearise(x).handy(len(x))
    scatter = term.scatter(x) + more
    if model.rows is None:
        scatter = among_all(scatter, term.rows, len(x))
    return SandwichTerm.measured(term, model.normal, scatter)


def _disagreement(term: PairTerm | RimTerm, names: Sequence[str]) -> str:
    if isinstance(term, RimTerm):
        return (
            f"The outline in {names[term.photo]} and what the photos show on the surface "
            "disagree by more than their noise, so the outline counts less: the scan may "
            "be too fat or too thin at its rim."
        )
    first, second = (names[i] for i in term.pair)
    return (
        f"The colours of {first} and {second} and their details disagree by more than "
        "their noise, so the colours count less: the photos may differ in haze or light."
    )
