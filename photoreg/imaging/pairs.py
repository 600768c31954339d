"""Which photos are compared with each other.

Few photos are compared all with all. Of many, each is compared with the three to six that
tell most of it, so that time grows with their number and not with its square; search,
polish, misfit, verdict and exposure compare the same ones.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.visibility import samples_for, visible
from photoreg.imaging.photo import Pair, Photo
from photoreg.words import listed

ALL_UP_TO = 4
"""Up to so many photos are compared all with all."""
LEAST, WANTED, MOST = 3, 4, 6
"""Pairs of a photo: at least, where it shares enough with others; as a rule; at most."""
WORTH = 0.2
"""Least score of a pair that is there only to make them more, as a share of the best pair
of one of its photos: it costs as much as that."""
N_SAMPLES = 4_000
"""Surface points that tell what photos have in common."""
MIN_SHARED = 20
"""Photos that share fewer of them are not compared: they have nothing to say."""
MIN_COSINE = 0.25
"""Least cosine between the surface's normal and the view of a point that counts."""
NARROW_DEG = 10.0
"""Below this angle between two views, what both see says less of either camera."""
LEAST_ANGLE_WEIGHT = 0.01
"""Of photos from one place: they are compared where there is nothing else."""


def all_pairs(n_photos: int) -> tuple[Pair, ...]:
    """Every pair of photos."""
    return tuple((i, k) for k in range(n_photos) for i in range(k))


def choose_pairs(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> tuple[Pair, ...]:
    """The pairs of photos that are compared; the order of the photos does not matter."""
    if len(photos) <= ALL_UP_TO:
        return all_pairs(len(photos))
    return connecting_pairs(pair_scores(mesh, photos, cameras))


def pair_scores(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> Float[np.ndarray, "n n"]:
    """How much comparing each two photos tells; 0: nothing.

    The sum over the surface points that both see of both cosines, of the ratio of their
    resolutions, and of a weight that falls below ``NARROW_DEG`` between the views.

    References:
        The choice of views by M. Goesele et al., "Multi-View Stereo for Community Photo
        Collections", ICCV 2007, section 4.1, doi:10.1109/ICCV.2007.4408933.
    """
    samples = samples_for(mesh, cameras, N_SAMPLES, seed=0)
    seen = visible(samples, cameras, mesh, "rays", MIN_COSINE)
    n = len(photos)
    cosines = np.zeros(seen.shape)
    resolutions = np.zeros(seen.shape)
    directions = np.zeros((*seen.shape, 3))
    for i, (photo, camera) in enumerate(zip(photos, cameras, strict=True)):
        if photo.mask is not None:
            # The photo may be reduced, its camera not.
            small = camera.resized(photo.width, photo.height)
            at = np.rint(small.project(samples.points[seen[i]])).astype(np.int64)
            columns = np.clip(at[:, 0], 0, photo.width - 1)
            rows = np.clip(at[:, 1], 0, photo.height - 1)
            seen[i, np.flatnonzero(seen[i])] = photo.mask[rows, columns]
        towards = camera.center - samples.points
        distance = np.linalg.norm(towards, axis=1)
        directions[i] = towards / distance[:, None]
        cosines[i] = np.einsum("nd,nd->n", samples.normals, directions[i])
        resolutions[i] = camera.focal_px / distance
    scores = np.zeros((n, n))
    for i, k in all_pairs(n):
        both = np.flatnonzero(seen[i] & seen[k])
        if len(both) < MIN_SHARED:
            continue
        chord = np.linalg.norm(directions[i, both] - directions[k, both], axis=1)
        angle_deg = np.degrees(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))
        weight = np.clip((angle_deg / NARROW_DEG) ** 2, LEAST_ANGLE_WEIGHT, 1.0)
        finer = np.maximum(resolutions[i, both], resolutions[k, both])
        coarser = np.minimum(resolutions[i, both], resolutions[k, both])
        quality = cosines[i, both] * cosines[k, both] * weight * (coarser / finer)
        scores[i, k] = scores[k, i] = float(quality.sum())
    return scores


def connecting_pairs(scores: Float[np.ndarray, "n n"]) -> tuple[Pair, ...]:
    """Pairs of high score that connect all photos, with three to six for each photo.

    First the pairs of a spanning tree, the best first; then the best others that are
    worth it until each photo has ``WANTED`` pairs; then any until it has ``LEAST``. Fewer,
    and several trees, only where scores are 0; more only where a tree needs them. Equal
    scores go by index.

    Args:
        scores: Symmetric, not negative; the diagonal does not matter.
    """
    n = len(scores)
    ranked = sorted(
        (pair for pair in all_pairs(n) if scores[pair] > 0.0),
        key=lambda pair: (-scores[pair], pair),
    )
    chosen: set[Pair] = set()
    degree = np.zeros(n, dtype=np.int64)
    tree = np.arange(n)
    # The second round connects what the first could not within the usual number.
    for most in (WANTED, n):
        for i, k in ranked:
            if tree[i] != tree[k] and max(degree[i], degree[k]) < most:
                tree[tree == tree[k]] = tree[i]
                chosen.add((i, k))
                degree[[i, k]] += 1
    best = np.where(np.eye(n, dtype=bool), 0.0, scores).max(axis=1, initial=0.0)
    worth = [(i, k) for i, k in ranked if scores[i, k] >= WORTH * min(best[i], best[k])]
    for pairs, wanted, most in (
        (worth, WANTED, WANTED),
        (worth, LEAST, MOST),
        (ranked, LEAST, MOST),
    ):
        for i, k in pairs:
            fewer, more = sorted((degree[i], degree[k]))
            if (i, k) not in chosen and fewer < wanted and more < most:
                chosen.add((i, k))
                degree[[i, k]] += 1
    return in_order(chosen)


def in_order(pairs: Sequence[Pair] | set[Pair]) -> tuple[Pair, ...]:
    """Pairs as ``all_pairs`` has them in turn."""
    return tuple(sorted(pairs, key=lambda pair: (pair[1], pair[0])))


def points_of_pair(n_points: int, n_pairs: int, least: int) -> int:
    """Surface points of each pair, where all have ``n_points``, but ``least`` or more.

    Beyond the pairs of ``ALL_UP_TO`` photos each new one brings its own points.
    """
    return max(least, n_points // max(1, min(n_pairs, len(all_pairs(ALL_UP_TO)))))


def weight_of_pair(share: float, n_photos: int, n_pairs: int) -> float:
    """``share`` as it counts in one of ``n_pairs`` pairs of ``n_photos`` photos.

    n photos hold n - 1 independent comparisons, as many as a tree has pairs.
    """
    # 2 / n where all pairs are compared, to the last bit.
    return share * 2.0 / (2.0 * n_pairs / (n_photos - 1))


def hanging_in_words(names: Sequence[str], pairs: Sequence[Pair]) -> tuple[str, ...]:
    """A sentence for each of many photos that is compared with one other, or with none."""
    if len(names) <= ALL_UP_TO:
        return ()
    sentences = []
    for i, name in enumerate(names):
        others = [names[k] for pair in pairs if i in pair for k in pair if k != i]
        if len(others) <= 1:
            with_whom = f"{listed(others)} only" if others else "no other photo"
            sentences.append(
                f"{name} is compared with {with_whom}, as it shares too little visible "
                "surface with the rest: align it more closely, or add a photo from "
                "between."
            )
    return tuple(sentences)


def pairs_in_words(names: Sequence[str], pairs: Sequence[Pair]) -> str:
    """One sentence on who of many photos is compared with whom; empty for few photos."""
    if len(names) <= ALL_UP_TO or not pairs:
        return ""
    by_first: dict[int, list[str]] = {}
    for i, k in sorted(pairs):
        by_first.setdefault(i, []).append(names[k])
    parts = [f"{names[i]} with {listed(others)}" for i, others in by_first.items()]
    return f"{len(pairs)} pairs of photos were compared: {'; '.join(parts)}."
