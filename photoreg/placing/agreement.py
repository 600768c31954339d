"""Which poses of several photos belong together: the surface has one colour in all of them.

What is compared is the detail of a middle size, as light that differs from photo to photo
changes the rest; and how well each outline fits counts more, as colours alone may agree by
chance.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from photoreg.geometry.camera import reduced_size
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import SurfaceSamples, sample_surface
from photoreg.geometry.visibility import visible
from photoreg.imaging.blur import blurred_within
from photoreg.imaging.colour import convert
from photoreg.imaging.photo import MIN_SIDE_PX, Photo
from photoreg.placing.outline_candidates import Candidate, differ

SIDE_PX = 200
FINE_PX, COARSE_PX = 1.2, 7.0
"""Blurs between which the detail lies."""
N_POINTS = 1_500
MIN_COSINE = 0.3
"""Points seen flatter than this are smeared."""
DEFICIT_WEIGHT = 4.0
"""How much more an outline's overlap counts than the correlation of colours."""
DISTINCT_DEG = 12.0
"""Poses that differ by less are taken for one answer: refining leads to the same end."""


@dataclasses.dataclass(frozen=True, eq=False)
class Readings:
    """What each candidate of one photo reads of the surface."""

    detail: Float[np.ndarray, "k n 3"]
    """Colours, 0 where a point is not seen."""
    seen: Float[np.ndarray, "k n"]
    """1 where a point is seen."""
    deficit: Float[np.ndarray, "k"]
    """How much less the outline overlaps than the photo's best one."""


def readings_of(
    mesh: Mesh,
    samples: SurfaceSamples,
    photo: Photo,
    covered: Bool[np.ndarray, "h w"],
    candidates: Sequence[Candidate],
) -> Readings:
    """What a photo shows of points on a surface as each candidate sees it.

    Args:
        mesh: The surface, for what is hidden.
        samples: Points of it.
        photo: The photo.
        covered: The object in it, at any size.
        candidates: At least one.
    """
    size = reduced_size(photo.width, photo.height, SIDE_PX, MIN_SIDE_PX)
    colours = convert(photo.pixels_at(size), "lab")
    inside = cv2.resize(covered.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    # The background must not bleed into the object.
    fine, coarse = (
        blurred_within(colours, inside, sigma_px) for sigma_px in (FINE_PX, COARSE_PX)
    )
    detail = fine - coarse
    cameras = [one.camera.resized(*size) for one in candidates]
    seen = visible(samples, cameras, mesh, "rays", MIN_COSINE)
    values = np.zeros((len(cameras), len(samples), 3))
    for k, camera in enumerate(cameras):
        index = np.flatnonzero(seen[k])
        columns, rows = np.rint(camera.project(samples.points[index])).astype(int).T
        is_shown = inside[rows, columns] > 0.5
        seen[k, index] = is_shown
        values[k, index[is_shown]] = detail[rows[is_shown], columns[is_shown]]
    best = max(one.overlap for one in candidates)
    deficit = np.array([best - one.overlap for one in candidates])
    return Readings(values, seen.astype(np.float64), deficit)


def surface_points(mesh: Mesh) -> SurfaceSamples:
    """Points by which photos are compared."""
    return sample_surface(mesh, N_POINTS, 0)


def agreements(a: Readings, b: Readings) -> Float[np.ndarray, "k l"]:
    """How well each candidate of one photo goes with each of another, at most 1.

    The correlation of what both read, times the root of the share of what either sees
    that both see, less the deficits of their outlines.
    """
    # Without BLAS, whose sums depend on the number of threads.
    product = np.einsum("knc,lnc->kl", a.detail, b.detail)
    energy_a = np.einsum("knc,ln->kl", a.detail**2, b.seen)
    energy_b = np.einsum("kn,lnc->kl", a.seen, b.detail**2)
    both = np.einsum("kn,ln->kl", a.seen, b.seen)
    either = a.seen.sum(axis=1)[:, None] + b.seen.sum(axis=1)[None] - both
    correlation = product / np.sqrt(np.maximum(energy_a * energy_b, 1e-12))
    share = both / np.maximum(either, 1.0)
    deficits = a.deficit[:, None] + b.deficit[None]
    return correlation * np.sqrt(share) - DEFICIT_WEIGHT * deficits


@dataclasses.dataclass(frozen=True, eq=False)
class Choice:
    """One candidate of each photo."""

    chosen: tuple[int, ...]
    margin: float
    """How much better it is than the best choice that differs."""


def ranked_choices(
    candidates: Sequence[Sequence[Candidate]],
    readings: Sequence[Readings],
    n: int,
) -> list[Choice]:
    """The best choices that differ, of photos that each have candidates.

    Args:
        candidates: Of each photo, two photos or more.
        readings: Of the same.
        n: How many choices at most.

    Returns:
        The best first; each margin is to the best of those that differ from it.
    """
    n_photos = len(candidates)
    scores = {
        (i, k): agreements(readings[i], readings[k])
        for i, k in itertools.combinations(range(n_photos), 2)
    }
    i, k = max(scores, key=lambda pair: float(scores[pair].max()))
    pair = scores[i, k]
    ranked = np.argsort(-pair.ravel(), kind="stable")
    found: list[tuple[float, tuple[int, ...]]] = []
    for flat in ranked:
        a, b = divmod(int(flat), pair.shape[1])
        if all(
            _differs(candidates[i], a, chosen[i])
            or _differs(candidates[k], b, chosen[k])
            for _, chosen in found
        ):
            chosen = _completed({i: a, k: b}, scores, n_photos)
            found.append((float(pair[a, b]), chosen))
        # One more than is asked for: the last one's margin.
        if len(found) > n:
            break
    best = found[0][0]
    choices = []
    for place, (score, chosen) in enumerate(found[:n]):
        other = found[1][0] if place == 0 and len(found) > 1 else best
        margin = score - other if len(found) > 1 else 1.0
        choices.append(Choice(chosen, margin))
    return choices


def _differs(candidates: Sequence[Candidate], a: int, b: int) -> bool:
    return differ(candidates[a].camera, candidates[b].camera, DISTINCT_DEG)


def _completed(
    chosen: dict[int, int],
    scores: dict[tuple[int, int], np.ndarray],
    n_photos: int,
) -> tuple[int, ...]:
    """The other photos' candidates, each as it goes best with those that are chosen."""
    while len(chosen) < n_photos:
        ways = []
        for photo in set(range(n_photos)) - set(chosen):
            total = np.mean(
                [
                    scores[photo, other][:, place]
                    if photo < other
                    else scores[other, photo][place]
                    for other, place in chosen.items()
                ],
                axis=0,
            )
            ways.append((float(total.max()), -photo, int(total.argmax())))
        _, minus, place = max(ways)
        chosen = {**chosen, -minus: place}
    return tuple(chosen[photo] for photo in range(n_photos))
