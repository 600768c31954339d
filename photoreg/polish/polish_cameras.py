"""The polish of cameras: levels, terms, prior; from rough cameras to precise ones."""

import concurrent.futures
import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import Camera, reduced_size
from photoreg.geometry.lens import N_TERMS, Distortion
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_descriptors import surface_descriptors
from photoreg.geometry.surface_view import (
    SurfaceView,
    camera_rays,
    surface_view,
    surface_views,
)
from photoreg.geometry.visibility import samples_for
from photoreg.imaging.pairs import choose_pairs, points_of_pair, weight_of_pair
from photoreg.imaging.photo import Pair, Photo
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.camera_parameters import PRINCIPAL
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.increments import Increments, free_directions
from photoreg.polish.config import PolishConfig
from photoreg.polish.correspondence_stage import (
    correspondence_terms,
    median_shift_px,
    polish_by_correspondences,
)
from photoreg.polish.disagreement import Disagreement, MeshError
from photoreg.polish.lens_decision import decided_step, let_go, step_back
from photoreg.polish.levenberg_marquardt import (
    Damping,
    Prior,
    minimise,
    total,
    total_scatter,
)
from photoreg.polish.misfit import SIDE_PX, disagreement
from photoreg.polish.photometric_term import (
    EDGE_MARGIN_PX,
    PairPoints,
    PairTerm,
    light_normals_of_firsts,
    opponent_channels,
    pair_points,
)
from photoreg.polish.shading_term import (
    MIN_EXPLAINED,
    ShadingTerm,
    fit_shading,
    shading_side_px,
)
from photoreg.polish.silhouette_term import (
    OUTLINE_SIGMA_PX,
    RimTerm,
    find_edges,
    find_rim,
)

PolishTerm = PairTerm | RimTerm | ShadingTerm

SETTLING_POINTS = 500
"""Surface points by which a level is seen to have settled."""

NEXT_DISTORTION: dict[Distortion, Distortion] = {"none": "k1", "auto": "full"}
"""What is tested at the end: whether the data decide so much of the lenses. With "auto",
if not, whether they decide k1."""

UNKNOWN_BIAS_PX = 1.5
"""What a single photo without an outline is taken to be off by, in pixels of a photo 1,024
px wide: as far as meshes of multi-view stereo were measured to draw it."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
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
    """The increments of each camera, in units of the prior."""
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
    units. ``uncertainty`` derives from it how sure the cameras are."""
    disagreement: Disagreement | None = None
    """Of the last step only: ``agreement.disagreement`` of these cameras."""
    start_disagreement: Disagreement | None = None
    """Of the last step only: the same of the cameras it started from. Its total is
    never lower."""
    missed_px: tuple[float, ...] = ()
    """Of the last step only, where no lens was solved though the data decide one: how
    far solving k1 would move the surface in each photo, on average, in its pixels."""
    missed_centre_px: tuple[float, ...] = ()
    """The same of letting principal points go as far as cropped photos have them: of each
    photo whose data decide that, 0 of the others; empty where none does."""
    mesh_error: MeshError | None = None
    """Of the steps by correspondences; in pixels of the cameras, on average."""
    bias_px: float = 0.0
    """Of the last step of each level, of a single photo: how far it may be off beside its
    noise, in its pixels; see ``_bias_px``."""


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
    distortion: Distortion = "none",
    pairs: Sequence[Pair] | None = None,
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
        distortion: How much of the lenses is solved, starting from those of
            ``prior_cameras``.
        pairs: Which photos are compared; None: those of ``choose_pairs`` at
            ``cameras``.

    Raises:
        InputError: if there are not as many cameras and priors as photos.
        RefinementError: if a camera does not see the mesh.

    Yields:
        Every accepted step, including each round's first, and at the end of a level its last
        one again, with how sure it is. The very last one holds the answer, which by
        ``agreement.disagreement`` is never worse than the start.
    """
    config = config or PolishConfig()
    if not len(photos) == len(cameras) == len(prior_cameras) or len(photos) == 0:
        raise InputError(
            "The polish needs one camera and one prior camera a photo, but got "
            f"{len(photos)} photos, {len(cameras)} cameras, {len(prior_cameras)} priors."
        )
    scales = prior_scales or PriorScales()
    sizes = [
        reduced_size(photo.width, photo.height, config.max_side_px) for photo in photos
    ]
    freedom = freedom or Freedom()
    if pairs is None:
        pairs = choose_pairs(mesh, photos, cameras)
    increments = tuple(
        Increments(
            _shaped_as(prior, camera),
            _pivot(mesh, camera, photo.name),
            scales,
            freedom.of(i),
            distortion,
            freedom.is_cropped(i),
        )
        for i, (prior, camera, photo) in enumerate(
            zip(prior_cameras, cameras, photos, strict=True)
        )
    )
    x_start = np.concatenate(
        [inc.of_camera(c) for inc, c in zip(increments, cameras, strict=True)]
    )
    moving = _Moving.of(increments, x_start, freedom)
    matches = config.use_correspondences and config.use_colour and len(photos) > 1
    n_levels = len(config.blurs_px) + matches
    surface = samples_for(mesh, cameras, SETTLING_POINTS, seed).points
    x, done = x_start, 0
    latest = None
    terms: list[PolishTerm] = []
    levels = list(range(len(config.blurs_px)))
    for stage, level in enumerate(levels):
        moved_px = np.inf
        for turn in range(config.rounds[level] + config.extra_rounds):
            settled = moved_px <= 0.5 * config.blurs_px[level]
            if settled and turn >= config.rounds[level]:
                break
            x_before, round_seed = x, seed + 101 * level + turn
            increments = moving.increments
            terms = _terms(
                mesh, photos, increments, x, sizes, level, config, round_seed, pairs
            )
            warnings = _missing(terms, photos, config)
            if level + turn > 0:
                # In the first round the scores are dominated by the misalignment.
                terms = [term.tempered(x) for term in terms]
            damping = Damping(max_iterations=config.iterations)
            for step in minimise(
                [moving.prior, *terms], x, damping, moving.directions, moving.limits
            ):
                x = step.x
                done += step.iteration > 0
                latest = PolishStep(
                    level=level,
                    n_levels=n_levels,
                    iteration=done,
                    cost=step.model.cost,
                    cameras=tuple(_cameras(increments, x)),
                    x=x,
                    normal=step.model.normal,
                    increments=increments,
                    directions=moving.directions,
                    warnings=warnings,
                )
                yield latest
            moved_px = _moved_px(
                surface, _cameras(increments, x_before), _cameras(increments, x)
            )
        assert latest is not None  # A level has at least one round.
        # The prior's gradient has the prior's own uncertainty.
        scatter = moving.prior.precision + total_scatter(terms, x)
        latest = dataclasses.replace(
            latest, scatter=scatter, bias_px=_bias_px(latest.cameras, terms)
        )
        if distortion == "auto" and level == len(config.blurs_px) - 2:
            # Here they are decided best: the finest level has more of the photos' noise.
            moving, x = moving.without_open_lens(x, terms, scatter, freedom)
        if stage == len(config.blurs_px) - 1 and distortion in NEXT_DISTORTION:
            wide, x_wide = moving.widened(x, NEXT_DISTORTION[distortion], freedom)
            wide_seed = seed + 101 * level
            wide_terms = _terms(
                mesh,
                photos,
                wide.increments,
                x_wide,
                sizes,
                level,
                config,
                wide_seed,
                pairs,
            )
            wide_terms = [term.tempered(x_wide) for term in wide_terms]
            step = decided_step(
                total([wide.prior, *wide_terms], x_wide),
                wide.prior.precision + total_scatter(wide_terms, x_wide),
                free_directions(wide.increments, freedom, N_TERMS[distortion]),
                wide.directions,
            )
            if distortion == "none":
                if step is not None and wide.has(x_wide + step):
                    ends = _cameras(wide.increments, x_wide + step)
                    missed_px = _moves_px(surface, latest.cameras, ends)
                    latest = dataclasses.replace(latest, missed_px=missed_px)
            elif step is not None:
                # Once more with them, from where the others are near already.
                levels.append(level)
                moving, x = wide, x_wide
        if stage == len(levels) - 1:
            latest = dataclasses.replace(
                latest,
                missed_centre_px=_missed_centres_px(
                    latest,
                    moving,
                    terms,
                    freedom,
                    surface,
                    lambda released, at=x, level=level: _terms(
                        mesh, photos, released, at, sizes, level, config, seed, pairs
                    ),
                ),
            )
        if stage < len(levels) - 1 or matches:
            yield latest
    assert latest is not None  # A configuration has at least one level.
    if matches:
        settled = dataclasses.replace(latest, level=n_levels - 1)
        latest = settled
        for step in _by_correspondences(
            mesh,
            photos,
            sizes,
            terms,
            moving.prior,
            settled,
            moving.limits,
            config,
            pairs,
        ):
            latest = step
            if step.scatter is None:
                yield latest
    before = start_disagreement
    if before is None:
        before = disagreement(mesh, photos, cameras, config.min_cosine, pairs)
    yield _better_end(
        mesh, photos, cameras, before, moving.start, latest, config, pairs
    )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class _Moving:
    """The numbers that move the cameras, and what restrains them."""

    increments: tuple[Increments, ...]
    start: Float[np.ndarray, "p"]
    """Of the cameras that the polish began with."""
    prior: Prior
    directions: Float[np.ndarray, "p q"]
    """See ``increments.free_directions``."""
    limits: Float[np.ndarray, "p"]

    @classmethod
    def of(
        cls,
        increments: tuple[Increments, ...],
        start: Float[np.ndarray, "p"],
        freedom: Freedom,
    ) -> "_Moving":
        return cls(
            increments=increments,
            start=start,
            prior=Prior(
                np.zeros_like(start),
                np.asarray(block_diag(*(one.precision for one in increments))),
            ),
            directions=free_directions(increments, freedom),
            limits=np.concatenate([one.limits for one in increments]),
        )

    def widened(
        self, x: Float[np.ndarray, "p"], distortion: Distortion, freedom: Freedom
    ) -> "tuple[_Moving, Float[np.ndarray, 'r']]":
        """With more of the lenses, and ``x`` in these numbers."""
        wider = tuple(
            dataclasses.replace(one, distortion=distortion) for one in self.increments
        )
        start, x = (_widened(at, self.increments, wider) for at in (self.start, x))
        return _Moving.of(wider, start, freedom), x

    def without_open_lens(
        self,
        x: Float[np.ndarray, "p"],
        terms: Sequence[PolishTerm],
        scatter: Float[np.ndarray, "p p"],
        freedom: Freedom,
    ) -> "tuple[_Moving, Float[np.ndarray, 'p']]":
        """Without the lenses, and one step to there, where the data do not decide them."""
        directions = free_directions(self.increments, freedom, N_TERMS["none"])
        model = total([self.prior, *terms], x)
        back = step_back(model, scatter, directions, self.directions, x)
        if back is None or not self.has(x + back):
            return self, x
        return dataclasses.replace(self, directions=directions), x + back

    def has(self, x: Float[np.ndarray, "p"]) -> bool:
        """Whether no number is beyond its limit."""
        return bool((np.abs(x) <= self.limits).all())


def _widened(
    x: np.ndarray, increments: Sequence[Increments], wider: Sequence[Increments]
) -> np.ndarray:
    """The same cameras in the numbers of ``wider``, which has more of the lens."""
    whole = np.zeros(sum(one.n for one in wider))
    for i, (old, new) in enumerate(zip(increments, wider, strict=True)):
        whole[new.own(i)][: old.n] = x[old.own(i)]
    return whole


def _missed_centres_px(
    latest: PolishStep,
    moving: _Moving,
    terms: Sequence[PolishTerm],
    freedom: Freedom,
    surface: np.ndarray,
    terms_of: Callable[[Sequence[Increments]], list[PolishTerm]],
) -> tuple[float, ...]:
    """See ``PolishStep.missed_centre_px``; ``terms_of`` measures anew what is held."""
    x, given = latest.x, moving.increments
    asked = [
        not (one.is_cropped or one.held.everything or freedom.is_cropped(i))
        for i, one in enumerate(given)
    ]
    released = tuple(
        dataclasses.replace(
            one, held=dataclasses.replace(one.held, principal_point=False)
        )
        if is_asked
        else one
        for one, is_asked in zip(given, asked, strict=True)
    )
    rows = [np.arange(one.n)[PRINCIPAL] + i * one.n for i, one in enumerate(given)]
    directions = moving.directions
    of_held = [
        row
        for group, one, is_asked in zip(rows, given, asked, strict=True)
        if is_asked and one.held.principal_point
        for row in group
    ]
    if of_held:
        directions = np.column_stack([directions, np.eye(len(x))[:, of_held]])
        terms = [term.tempered(x) for term in terms_of(released)]
    precisions = []
    for one, is_asked in zip(released, asked, strict=True):
        wide = dataclasses.replace(one, is_cropped=one.is_cropped or is_asked)
        share = np.divide(
            one.units, wide.units, out=np.ones(one.n), where=wide.units > 0.0
        )
        precisions.append(share[:, None] * wide.precision * share)
    step, is_far = let_go(
        total(terms, x),
        total_scatter(terms, x),
        x,
        Prior(np.zeros_like(x), np.asarray(block_diag(*precisions))),
        directions,
        rows,
    )
    is_far = [far and ask for far, ask in zip(is_far, asked, strict=True)]
    if not any(is_far):
        return ()
    limits = np.concatenate([one.limits for one in released])
    beyond = np.abs(step) / np.maximum(limits - np.abs(x), 1e-9)
    ends = _cameras(released, x + step / max(1.0, float(beyond.max())))
    moves_px = _moves_px(surface, latest.cameras, ends)
    return tuple(
        move if far else 0.0 for move, far in zip(moves_px, is_far, strict=True)
    )


def _by_correspondences(
    mesh: Mesh,
    photos: Sequence[Photo],
    sizes: Sequence[tuple[int, int]],
    terms: Sequence[PolishTerm],
    prior: Prior,
    latest: PolishStep,
    limits: Float[np.ndarray, "p"],
    config: PolishConfig,
    pairs: Sequence[Pair],
) -> Iterator[PolishStep]:
    """The last stage, from the end of the levels; nothing where too little matches."""
    warnings = latest.warnings
    done = latest.iteration
    scales = zip(latest.cameras, sizes, strict=True)
    photo_scale = float(np.mean([camera.width / size[0] for camera, size in scales]))
    for turn in range(config.correspondence_rounds):
        small = [
            camera.resized(*size)
            for camera, size in zip(latest.cameras, sizes, strict=True)
        ]
        found = correspondence_terms(
            mesh,
            photos,
            small,
            latest.increments,
            latest.x,
            config.patches,
            config.min_cosine,
            pairs,
        )
        if not found:
            return
        for step in polish_by_correspondences(
            found,
            # Until patches are matched from nearby, only they count.
            [term for term in terms if not isinstance(term, ShadingTerm)]
            if turn == config.correspondence_rounds - 1
            else (),
            [photo.name for photo in photos],
            prior,
            latest.x,
            Damping(max_iterations=config.iterations),
            latest.directions,
            limits,
        ):
            iterate = step.iterate
            done += iterate.iteration > 0
            latest = dataclasses.replace(
                latest,
                iteration=done,
                cost=iterate.model.cost,
                cameras=tuple(_cameras(latest.increments, iterate.x)),
                x=iterate.x,
                normal=iterate.model.normal,
                scatter=step.scatter,
                warnings=(*warnings, *step.warnings),
                mesh_error=dataclasses.replace(
                    step.mesh_error, sigma_px=step.mesh_error.sigma_px * photo_scale
                ),
            )
            yield latest


def _moved_px(
    points_world: np.ndarray, before: Sequence[Camera], after: Sequence[Camera]
) -> float:
    """How far surface points move in the photo where they move most.

    The mean distance, in pixels of a photo 1,024 px wide, of points in front of both
    cameras; seen or not.
    """
    moves_px = _moves_px(points_world, before, after)
    return max(
        move * 1024.0 / camera.width
        for move, camera in zip(moves_px, after, strict=True)
    )


def _moves_px(
    points_world: np.ndarray, before: Sequence[Camera], after: Sequence[Camera]
) -> tuple[float, ...]:
    """The mean distance that surface points move in each photo, in its pixels."""
    moves_px = []
    for old, new in zip(before, after, strict=True):
        apart = new.project(points_world) - old.project(points_world)
        moves_px.append(
            float(np.nanmean(np.hypot(*apart.T)))
            if np.isfinite(apart).any()
            else np.inf
        )
    return tuple(moves_px)


def _better_end(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    before: Disagreement,
    x_start: np.ndarray,
    latest: PolishStep,
    config: PolishConfig,
    pairs: Sequence[Pair],
) -> PolishStep:
    """The polished cameras, or those it started from where they fit better."""
    after = disagreement(mesh, photos, latest.cameras, config.min_cosine, pairs)
    if is_no_worse(
        mesh, photos, (latest.cameras, after), (cameras, before), config, pairs
    ):
        return dataclasses.replace(
            latest, disagreement=after, start_disagreement=before
        )
    return dataclasses.replace(
        latest,
        cameras=tuple(cameras),
        x=x_start,
        mesh_error=None,
        disagreement=before,
        start_disagreement=before,
        warnings=(
            *latest.warnings,
            "The polish found nothing better; the cameras are unchanged. Where the "
            "overlay is off, align them more closely, or try the preset thorough.",
        ),
    )


def is_no_worse(
    mesh: Mesh,
    photos: Sequence[Photo],
    end: tuple[Sequence[Camera], Disagreement],
    start: tuple[Sequence[Camera], Disagreement],
    config: PolishConfig,
    pairs: Sequence[Pair],
) -> bool:
    """Whether cameras fit at least as well as those they came from.

    Colours and outlines decide. Where they say no, the photos' details decide: with slow
    differences of appearance, or a scan that is fat at its rim, the right cameras look worse
    than others some pixels off.

    Args:
        mesh: The surface.
        photos: All photos.
        end: Cameras, and their ``misfit.disagreement``.
        start: The same of those that they came from.
        config: Settings of the polish.
        pairs: Which photos are compared.
    """
    if end[1].total <= start[1].total:
        return True
    if not config.use_correspondences or len(photos) < 2:
        return False
    shift_px, before_px = (
        median_shift_px(
            mesh,
            photos,
            [camera.reduced(SIDE_PX, least_px=16) for camera in cameras],
            config.patches,
            config.min_cosine,
            pairs,
        )
        for cameras, _ in (end, start)
    )
    return shift_px is not None and before_px is not None and shift_px < before_px


def _bias_px(cameras: Sequence[Camera], terms: Sequence[PolishTerm]) -> float:
    """How far a single photo's camera may be off, whatever the noise, in its pixels.

    A wrong scan takes outline and shading with it, and there is no other photo to show it.
    But stretches of the outline are off beyond their noise: so much the whole may be.
    """
    if len(cameras) > 1:
        return 0.0
    (width,) = (camera.width for camera in cameras)
    for term in terms:
        if isinstance(term, RimTerm):
            return term.tau * width / term.size[0]
    return UNKNOWN_BIAS_PX * width / 1024.0


def _missing(
    terms: Sequence[PolishTerm], photos: Sequence[Photo], config: PolishConfig
) -> tuple[str, ...]:
    """What the terms lack, in sentences."""
    warnings = []
    compared = {i for term in terms if isinstance(term, PairTerm) for i in term.pair}
    drawn = {term.photo for term in terms if isinstance(term, RimTerm)}
    rest = "colour alone"
    if len(photos) == 1:
        shaded = any(isinstance(term, ShadingTerm) for term in terms)
        rest = "shading alone" if shaded else "nothing but where it was"
    for i, photo in enumerate(photos):
        if config.use_colour and i not in compared and len(photos) > 1:
            warnings.append(
                f"{photo.name} shares too little visible surface with the other photos: "
                "its colours were not compared. Align it more closely, or add a photo "
                "from between."
            )
        if config.use_silhouette and i not in drawn:
            warnings.append(
                f"{photo.name} shows no outline of the mesh that could be used, so {rest} "
                "holds its camera. Where the overlay is off, add a photo that "
                "shows the object's rim."
            )
    return tuple(warnings)


def _shaped_as(prior: Camera, camera: Camera) -> Camera:
    """``prior`` with the ratio of focal lengths and the skew of ``camera``."""
    K = prior.K.copy()
    K[:2, :2] = camera.K[:2, :2] * (prior.focal_px / camera.focal_px)
    return dataclasses.replace(prior, K=K)


def _cameras(increments: Sequence[Increments], x: np.ndarray) -> list[Camera]:
    return [inc.camera(x[inc.own(i)]) for i, inc in enumerate(increments)]


def _pivot(mesh: Mesh, camera: Camera, name: str) -> np.ndarray:
    small = camera.reduced(128)
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
    pairs: Sequence[Pair],
) -> list[PolishTerm]:
    blur, n_points = config.blurs_px[level], config.points[level]
    small: list[Camera] = []
    blurs: list[float] = []
    for camera, size in zip(_cameras(increments, x), sizes, strict=True):
        sigma = blur * size[0] / 1024.0 if blur > 0.5 else blur
        # A blur of 1.5 px or more is left, of which pixels lose nothing: at their highest
        # frequency exp(-2 (1.5 pi / 2)^2) = 1.5e-5 of the contrast.
        reduction = 2 ** max(0, int(np.floor(np.log2(max(sigma, 1.0) / 1.5))))
        small.append(
            camera.resized(
                max(16, round(size[0] / reduction)), max(16, round(size[1] / reduction))
            )
        )
        blurs.append(sigma / reduction)
    views = surface_views(mesh, small)
    pairs = pairs if config.use_colour else ()
    normals = light_normals_of_firsts(mesh, views, pairs)

    def rim_term(i: int) -> RimTerm | None:
        return _rim_term(mesh, photos[i], views[i], i, increments[i], level, config)

    def shared_points(pair: tuple[int, int]) -> PairPoints:
        i, k = pair
        return pair_points(
            mesh,
            (photos[i], photos[k]),
            (views[i], views[k]),
            normals[i],
            points_of_pair(n_points, len(pairs), 500),
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
        terms: list[PolishTerm] = [t for t in found if t is not None]
    for (i, k), surface in zip(pairs, surfaces, strict=True):
        if len(surface.points) < 200:
            continue
        seen = float(views[i].covered.sum())
        # The area over which a Gaussian blur makes noise alike, 4 pi sigma^2; a quarter of
        # a pixel's square is the sampling's own.
        blob = 4.0 * np.pi * (blurs[i] ** 2 + 0.25)
        independent = min(1.0, seen / blob / len(surface.points))
        terms.append(
            PairTerm.measured(
                (i, k),
                surface,
                (images[i], images[k]),
                (increments[i], increments[k]),
                x,
                weight_of_pair(independent, len(photos), len(pairs)),
            )
        )
    if config.use_shading and len(photos) == 1:
        camera = _cameras(increments, x)[0]
        shading = _shading_term(
            mesh, photos[0], camera, increments[0], x, level, config
        )
        terms += [] if shading is None else [shading]
    return terms


def _shading_term(
    mesh: Mesh,
    photo: Photo,
    camera: Camera,
    increments: Increments,
    x: np.ndarray,
    level: int,
    config: PolishConfig,
) -> ShadingTerm | None:
    """The shading of the only photo; None where the surface explains nothing of it."""
    reaches_px = config.shading_reaches_px
    reach_px = reaches_px[min(level, len(reaches_px) - 1)]
    small = camera.reduced(shading_side_px(reach_px), least_px=16)
    descriptors = surface_descriptors(mesh)
    view = surface_view(descriptors.mesh, small)
    fit = fit_shading(
        photo, view, descriptors, reach_px * small.width / 1024.0, config.shading_points
    )
    if fit is None or fit.explained <= MIN_EXPLAINED:
        return None
    return ShadingTerm.measured(0, fit, view, increments, x)


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
