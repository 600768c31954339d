"""The polish of cameras: levels, terms, prior; from rough cameras to precise ones."""

import concurrent.futures
import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface
from photoreg.geometry.surface_view import (
    SurfaceView,
    camera_rays,
    surface_view,
    surface_views,
)
from photoreg.imaging.photo import Photo
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.increments import (
    N_INCREMENTS,
    Increments,
    free_directions,
)
from photoreg.polish.levenberg_marquardt import Damping, Prior, minimise
from photoreg.polish.misfit import Disagreement, disagreement
from photoreg.polish.photometric_term import (
    EDGE_MARGIN_PX,
    PairPoints,
    PairTerm,
    opponent_channels,
    pair_points,
)
from photoreg.polish.silhouette_term import (
    OUTLINE_SIGMA_PX,
    RimTerm,
    find_edges,
    find_rim,
)

SETTLING_POINTS = 500
"""Surface points by which a level is seen to have settled."""


MOST_POINTS = 10_000_000
"""Of a level: each takes some hundred bytes for every pair of photos."""

MOST_ROUNDS = 1_000_000


@dataclasses.dataclass(frozen=True)
class PolishConfig:
    """Settings of the polish."""

    blurs_px: tuple[float, ...] = (8.0, 4.0, 2.0, 1.0, 0.5)
    """Blur of each level, coarse to fine, in pixels of a photo 1,024 px wide."""
    points: tuple[int, ...] = (8_000, 12_000, 16_000, 30_000, 60_000)
    """Surface points of each level over all pairs of photos."""
    rounds: tuple[int, ...] = (3, 2, 2, 1, 2)
    """How often each level renews visibility, exposure and noise, at least."""
    extra_rounds: int = 6
    """Rounds more a level, at most, while a round still moves the surface in the photos
    by more than half the level's blur."""
    iterations: int = 8
    """Steps of the minimisation a round, at most."""
    min_cosine: float = 0.25
    """Least cosine between the surface's normal and the view of a point that counts."""
    cell_px: float = 32.0
    """Side of the cells that share an offset of light, in pixels of 1,024."""
    max_side_px: int = 2048
    """Photos are reduced to this many pixels on the longer side at most."""
    use_colour: bool = True
    """Compare the photos' colours on the surface."""
    use_silhouette: bool = True
    """Draw the mesh's rim to the photos' edges."""
    rim_reaches_px: tuple[float, ...] = (40.0, 25.0, 12.0, 6.0, 4.0)
    """How far each level looks for the edge, in pixels of a photo 1,024 px wide."""
    rim_points: int = 1200
    """Rim points a photo, at most about."""

    def __post_init__(self) -> None:
        n = len(self.blurs_px)
        if n == 0 or len(self.points) != n or len(self.rounds) != n:
            raise InputError(
                "The polish needs blurs_px, points and rounds of one length, at least "
                f"one level, but they have {n}, {len(self.points)}, {len(self.rounds)}."
            )
        if not all(np.isfinite(b) and b >= 0.0 for b in self.blurs_px):
            raise InputError(f"blurs_px should be 0 or more, but is {self.blurs_px}.")
        if self.extra_rounds < 0:
            raise InputError(
                f"extra_rounds should be 0 or more, but is {self.extra_rounds}."
            )
        if min(self.points) < 100 or min(self.rounds) < 1 or self.iterations < 1:
            raise InputError(
                "A level of the polish needs at least 100 points, 1 round and 1 iteration."
            )
        if max(self.points) > MOST_POINTS:
            raise InputError(
                f"A level of the polish takes up to {MOST_POINTS:,} points, but points "
                f"is {max(self.points):g}."
            )
        if max(*self.rounds, self.extra_rounds, self.iterations) > MOST_ROUNDS:
            raise InputError(
                f"The polish takes up to {MOST_ROUNDS:,} rounds and iterations."
            )
        if not 0.0 < self.min_cosine < 1.0:
            raise InputError(
                f"min_cosine should be between 0 and 1, but is {self.min_cosine}."
            )
        if not 0.0 < self.cell_px < np.inf:
            raise InputError(f"cell_px should be above 0, but is {self.cell_px}.")
        if self.max_side_px < 16:
            raise InputError(
                f"max_side_px should be at least 16, but is {self.max_side_px}."
            )
        if self.use_silhouette and len(self.rim_reaches_px) < n:
            raise InputError(
                f"rim_reaches_px should have one reach a level, {n}, but has "
                f"{len(self.rim_reaches_px)}."
            )
        if not all(0.0 <= reach < np.inf for reach in self.rim_reaches_px):
            raise InputError(
                f"rim_reaches_px should be 0 or more, but is {self.rim_reaches_px}."
            )
        if not 0 <= self.rim_points <= MOST_POINTS:
            raise InputError(
                f"rim_points should be 0 to {MOST_POINTS:,}, but is {self.rim_points:g}."
            )


@dataclasses.dataclass(frozen=True, eq=False)
class PolishStep:
    """One step of a running polish; the last one is the answer."""

    level: int
    """0 is the coarsest."""
    n_levels: int
    iteration: int
    """Steps so far, over all levels."""
    cost: float
    """Robust cost of this level's round; comparable only within the round."""
    cameras: tuple[Camera, ...]
    """The cameras now."""
    x: Float[np.ndarray, "p"]
    """Nine increments a camera, in units of the prior."""
    normal: Float[np.ndarray, "p p"]
    """Normal matrix of the cost at x, in the same units."""
    increments: tuple[Increments, ...]
    """What the numbers mean."""
    directions: Float[np.ndarray, "p q"]
    """What moved by itself; see ``increments.free_directions``."""
    warnings: tuple[str, ...]
    """What the user should know, in sentences."""
    scatter: Float[np.ndarray, "p p"] | None = None
    """Of the last step of each level: covariance of the cost's gradient, in inverse
    units. ``uncertainty`` tells from it how sure the cameras are."""
    disagreement: Disagreement | None = None
    """Of the last step only: ``agreement.disagreement`` of these cameras."""
    start_disagreement: Disagreement | None = None
    """Of the last step only: the same of the cameras it started from. Its total is
    never lower."""


def polish_cameras(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    prior_cameras: Sequence[Camera],
    config: PolishConfig | None = None,
    seed: int = 0,
    prior_scales: PriorScales | None = None,
    start_disagreement: Disagreement | None = None,
    freedom: Freedom | None = None,
) -> Iterator[PolishStep]:
    """Moves all cameras at once to where the photos agree on the surface.

    Args:
        mesh: The surface.
        photos: At least one photo.
        cameras: Where to start, one a photo.
        prior_cameras: The pre-registration.
        config: Settings; None: the defaults.
        seed: Of the sampling.
        prior_scales: One sigma of the prior around it; None: the paper's intervals.
        start_disagreement: ``agreement.disagreement`` of ``cameras``, if known.
        freedom: What may move; None: everything. What is held, and shared focal
            lengths, ``cameras`` have as ``prior_cameras`` do.

    Raises:
        InputError: if photos, cameras and priors are not of one number.
        RefinementError: if a camera does not see the mesh.

    Yields:
        Every accepted step, each round's first included, and where a level ends its last
        one again, with how sure it is. The last one of all holds the answer, which by ``agreement.disagreement`` is never worse than the start.
    """
    config = config or PolishConfig()
    if not len(photos) == len(cameras) == len(prior_cameras) or len(photos) == 0:
        raise InputError(
            "The polish needs one camera and one prior camera a photo, but got "
            f"{len(photos)} photos, {len(cameras)} cameras, {len(prior_cameras)} priors."
        )
    scales = prior_scales or PriorScales()
    sizes = [_working_size(photo, config.max_side_px) for photo in photos]
    freedom = freedom or Freedom()
    increments = tuple(
        Increments(
            _shaped_as(prior, camera),
            _pivot(mesh, camera, photo.name),
            scales,
            freedom.of(i),
        )
        for i, (prior, camera, photo) in enumerate(
            zip(prior_cameras, cameras, photos, strict=True)
        )
    )
    directions = free_directions(increments, freedom)
    limits = np.concatenate([increment.limits for increment in increments])
    x_start = np.concatenate(
        [inc.of_camera(c) for inc, c in zip(increments, cameras, strict=True)]
    )
    prior = Prior(np.zeros_like(x_start), np.eye(len(x_start)))
    n_levels = len(config.blurs_px)
    surface = sample_surface(mesh, SETTLING_POINTS, seed).points
    x, done = x_start, 0
    latest = None
    terms: list[PairTerm | RimTerm] = []
    for level in range(n_levels):
        moved_px = np.inf
        for turn in range(config.rounds[level] + config.extra_rounds):
            settled = moved_px <= 0.5 * config.blurs_px[level]
            if settled and turn >= config.rounds[level]:
                break
            x_before, round_seed = x, seed + 101 * level + turn
            terms = _terms(
                mesh, photos, increments, x, sizes, level, config, round_seed
            )
            warnings = _missing(terms, photos, config)
            if level + turn > 0:
                # In the first round the scores are dominated by the misalignment.
                terms = [term.tempered(x) for term in terms]
            damping = Damping(max_iterations=config.iterations)
            for step in minimise([prior, *terms], x, damping, directions, limits):
                x = step.x
                done += step.iteration > 0
                latest = PolishStep(
                    level,
                    n_levels,
                    done,
                    step.model.cost,
                    tuple(_cameras(increments, x)),
                    x,
                    step.model.normal,
                    increments,
                    directions,
                    warnings,
                )
                yield latest
            moved_px = _moved_px(
                surface, _cameras(increments, x_before), _cameras(increments, x)
            )
        assert latest is not None  # A level has at least one round.
        latest = dataclasses.replace(
            latest,
            # The prior's gradient is as uncertain as the prior says.
            scatter=prior.precision + sum(term.scatter(x) for term in terms),
        )
        if level < n_levels - 1:
            yield latest
    assert latest is not None  # A configuration has at least one level.
    before = start_disagreement
    if before is None:
        before = disagreement(mesh, photos, cameras, config.min_cosine)
    yield _better_end(mesh, photos, cameras, before, x_start, latest, config)


def _moved_px(
    points_world: np.ndarray, before: Sequence[Camera], after: Sequence[Camera]
) -> float:
    """How far surface points move in the photo where they move most.

    The mean distance, in pixels of a photo 1,024 px wide, of points in front of both
    cameras; seen or not.
    """
    moves_px = []
    for old, new in zip(before, after, strict=True):
        apart = new.project(points_world) - old.project(points_world)
        moves_px.append(
            np.nanmean(np.hypot(*apart.T)) * 1024.0 / new.width
            if np.isfinite(apart).any()
            else np.inf
        )
    return float(max(moves_px))


def _better_end(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    before: Disagreement,
    x_start: np.ndarray,
    latest: PolishStep,
    config: PolishConfig,
) -> PolishStep:
    """The polished cameras, or those it started from where they fit better."""
    after = disagreement(mesh, photos, latest.cameras, config.min_cosine)
    if after.total <= before.total:
        return dataclasses.replace(
            latest, disagreement=after, start_disagreement=before
        )
    return dataclasses.replace(
        latest,
        cameras=tuple(cameras),
        x=x_start,
        disagreement=before,
        start_disagreement=before,
        warnings=(
            *latest.warnings,
            "The polish found nothing better; the cameras are as they came. Where the "
            "overlay is off, align them more closely, or try the preset thorough.",
        ),
    )


def _missing(
    terms: Sequence[PairTerm | RimTerm], photos: Sequence[Photo], config: PolishConfig
) -> tuple[str, ...]:
    """What the terms lack, in sentences."""
    warnings = []
    compared = {i for term in terms if isinstance(term, PairTerm) for i in term.pair}
    drawn = {term.photo for term in terms if isinstance(term, RimTerm)}
    for i, photo in enumerate(photos):
        if config.use_colour and i not in compared and len(photos) > 1:
            warnings.append(
                f"{photo.name} shares too little visible surface with the other photos: "
                "its colours were not compared. Align it more closely, or add a photo "
                "from between."
            )
        if config.use_silhouette and i not in drawn:
            warnings.append(
                f"{photo.name} shows no outline of the mesh that could be used, so colour "
                "alone holds its camera. Where the overlay is off, add a photo that "
                "shows the object's rim."
            )
    return tuple(warnings)


def _shaped_as(prior: Camera, camera: Camera) -> Camera:
    """``prior`` with the ratio of focal lengths and the skew of ``camera``."""
    K = prior.K.copy()
    K[:2, :2] = camera.K[:2, :2] * (prior.focal_px / camera.focal_px)
    return dataclasses.replace(prior, K=K)


def _cameras(increments: Sequence[Increments], x: np.ndarray) -> list[Camera]:
    return [
        inc.camera(x[i * N_INCREMENTS : (i + 1) * N_INCREMENTS])
        for i, inc in enumerate(increments)
    ]


def _working_size(photo: Photo, max_side_px: int) -> tuple[int, int]:
    scale = min(1.0, max_side_px / max(photo.width, photo.height))
    return max(1, round(photo.width * scale)), max(1, round(photo.height * scale))


def _pivot(mesh: Mesh, camera: Camera, name: str) -> np.ndarray:
    scale = min(1.0, 128 / max(camera.width, camera.height))
    small = camera.resized(
        max(2, round(camera.width * scale)), max(2, round(camera.height * scale))
    )
    view = surface_view(mesh, small)
    if not view.covered.any():
        raise RefinementError(
            f"The camera of {name} does not see the mesh; align it by hand first."
        )
    rows, columns = np.nonzero(view.covered)
    origins, directions = camera_rays(small, np.column_stack([columns, rows]) * 1.0)
    return (origins + view.depth[rows, columns][:, None] * directions).mean(axis=0)


def _terms(
    mesh: Mesh,
    photos: Sequence[Photo],
    increments: Sequence[Increments],
    x: np.ndarray,
    sizes: Sequence[tuple[int, int]],
    level: int,
    config: PolishConfig,
    seed: int,
) -> list[PairTerm | RimTerm]:
    blur, n_points = config.blurs_px[level], config.points[level]
    small: list[Camera] = []
    blurs: list[float] = []
    for camera, size in zip(_cameras(increments, x), sizes, strict=True):
        sigma = blur * size[0] / 1024.0 if blur > 0.5 else blur
        reduction = 2 ** max(0, int(np.floor(np.log2(max(sigma, 1.0) / 1.5))))
        small.append(
            camera.resized(
                max(16, round(size[0] / reduction)), max(16, round(size[1] / reduction))
            )
        )
        blurs.append(sigma / reduction)
    views = surface_views(mesh, small)
    n_compared = len(photos) if config.use_colour else 0
    pairs = [(i, k) for k in range(n_compared) for i in range(k)]

    def rim_term(i: int) -> RimTerm | None:
        return _rim_term(mesh, photos[i], views[i], i, increments[i], level, config)

    def shared_points(pair: tuple[int, int]) -> PairPoints:
        i, k = pair
        return pair_points(
            mesh,
            (photos[i], photos[k]),
            (views[i], views[k]),
            max(500, n_points // len(pairs)),
            config.cell_px * views[i].camera.width / 1024.0,
            EDGE_MARGIN_PX,
            config.min_cosine,
            seed,
        )

    with concurrent.futures.ThreadPoolExecutor() as threads:
        surfaces = threads.map(shared_points, pairs)
        images = threads.map(opponent_channels, photos, views, blurs) if pairs else []
        found = threads.map(
            rim_term, range(len(photos) if config.use_silhouette else 0)
        )
        surfaces, images = list(surfaces), list(images)
        terms: list[PairTerm | RimTerm] = [t for t in found if t is not None]
    for (i, k), surface in zip(pairs, surfaces, strict=True):
        if len(surface.points) < 200:
            continue
        seen = float(views[i].covered.sum())
        blob = 4.0 * np.pi * (blurs[i] ** 2 + 0.25)
        independent = min(1.0, seen / blob / len(surface.points))
        terms.append(
            PairTerm.measured(
                (i, k),
                surface,
                (images[i], images[k]),
                (increments[i], increments[k]),
                x,
                independent * 2.0 / len(photos),
            )
        )
    return terms


def _rim_term(
    mesh: Mesh,
    photo: Photo,
    view: SurfaceView,
    index: int,
    increments: Increments,
    level: int,
    config: PolishConfig,
) -> RimTerm | None:
    """The outline of one photo; None where there is too little of it."""
    scale = view.camera.width / 1024.0
    rim = find_rim(mesh, view, config.rim_points)
    if len(rim.points) < 50:
        return None
    reach_px = max(3.0, config.rim_reaches_px[level] * scale)
    return RimTerm.measured(
        index,
        rim,
        find_edges(photo, view, rim, reach_px),
        (view.camera.width, view.camera.height),
        increments,
        OUTLINE_SIGMA_PX * scale,
        0.5,
    )
