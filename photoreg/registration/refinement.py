"""The whole refinement: prepare, search, polish, and the events that report on it."""

import dataclasses
import time
from collections.abc import Generator, Iterator, Sequence

import numpy as np

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import Camera, reduced_size
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.slippage import slippage_words
from photoreg.geometry.surface_descriptors import surface_descriptors
from photoreg.geometry.unseen import why_unseen
from photoreg.geometry.visibility import (
    middle_for,
    samples_for,
    share_seen_twice,
    visible,
)
from photoreg.geometry.winding import facing_cameras
from photoreg.imaging.pairs import (
    ALL_UP_TO,
    choose_pairs,
    hanging_in_words,
    pair_scores,
)
from photoreg.imaging.photo import MIN_SIDE_PX, Pair, Photo
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.genes import GeneMap
from photoreg.polish.disagreement import Disagreement, MeshError
from photoreg.polish.misfit import against_chance, disagreement
from photoreg.polish.polish_cameras import PolishStep, is_no_worse, polish_cameras
from photoreg.polish.uncertainty import Uncertainty, estimate_uncertainty
from photoreg.registration.check_readiness import check_readiness
from photoreg.registration.checkpoint import Checkpoint, problem_digest
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Event, Finished, Phase, Population, Progress
from photoreg.registration.genetic_search import GeneticSearch, search_genes
from photoreg.registration.growing_search import GrowingSearch
from photoreg.registration.verdict import (
    MISSED_LENS_PX,
    Verdict,
    decide_verdict,
    doubting_the_centre,
    doubting_the_lens,
    doubting_the_scan,
    failing_photos,
    far_centre_sentence,
    is_better,
    missed_lens_sentence,
)
from photoreg.registration.world import why_convincing_elsewhere, why_of_another_world
from photoreg.search.genetic import Generation
from photoreg.words import listed

MIN_OVERLAP = 0.1
"""Share of what the photos see that two must see; below it the user is warned."""

FIRST_POLISH_SHARE = 0.9
"""Share of the progress bar at which the first polish ends; a second is rare."""

MOST_PIXELS = 40_000_000
"""Of all photos together in the polish, which needs some sixty bytes per pixel: twelve
photos of 2048x1536. More photos are reduced further."""

ONE_PHOTO_SEARCHED = (
    "There is no other photo to compare colours with, so the search went by how much the "
    "colours show of the surface's shape; the paper's method needs two photos or more."
)

SEARCH_SHARE = 0.3
"""Share of the progress bar given to the search where a polish follows."""


def refine(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig | None = None,
    freedom: Freedom | None = None,
    resume: Checkpoint | None = None,
) -> Generator[Event, None, None]:
    """Refines rough cameras until the photos agree over the surface.

    One photo is compared with the surface itself: its outline, and how far the shape
    explains its shading.

    Stop iterating to cancel: every event holds the best cameras so far. The last event
    is a ``Finished``.

    Args:
        mesh: The surface.
        photos: One or more.
        cameras: The pre-registration, one a photo, in the same order.
        config: Settings; None: the default preset.
        freedom: What may move; None: everything. What is held stays to the last bit.
        resume: Go on from this ``Progress.checkpoint`` of the same refinement, to the
            answer that it would have had without the break, bit for bit.

    Raises:
        InputError: if photos and cameras do not match, if ``freedom`` leaves nothing
            to move, if ``resume`` is of another refinement, or if there is nothing to
            compare: see ``Readiness.refusals``.
        RefinementError: if no camera sees the surface, no two of several see a common
            part, or the photos agree only in another world.
    """
    if len(photos) == 0:
        raise InputError("A refinement needs at least one photo, but there is none.")
    if len(photos) != len(cameras):
        raise InputError(
            f"There are {len(photos)} photos but {len(cameras)} cameras; give one camera "
            "per photo, in the same order."
        )
    for photo, camera in zip(photos, cameras, strict=True):
        if (photo.width, photo.height) != (camera.width, camera.height):
            raise InputError(
                f"{photo.name} is {photo.width}x{photo.height} px, but its camera is for "
                f"{camera.width}x{camera.height} px."
            )
    config, freedom = config or RegistrationConfig(), freedom or Freedom()
    freedom.require(cameras, [photo.name for photo in photos])
    run = _Run(mesh, photos, cameras, config, freedom)
    if resume is not None:
        run.go_on_from(resume)
    return run.events()


class _Run:
    """One refinement: what its phases share."""

    def __init__(
        self,
        mesh: Mesh,
        photos: Sequence[Photo],
        cameras: Sequence[Camera],
        config: RegistrationConfig,
        freedom: Freedom,
    ) -> None:
        self.mesh, self.config = facing_cameras(mesh, cameras), config
        self.given_photos, self.given = tuple(photos), tuple(cameras)
        self.given_freedom = freedom
        self.begun = freedom.begin(self.given, middle_for(mesh, self.given))
        """The cameras given, with one focal length where photos share it."""
        self.active = tuple(range(len(photos)))
        """Which photos take part: those whose cameras see the surface."""
        self.pairs: tuple[Pair, ...] = ()
        """Which of those that take part are compared."""
        self.best = self.begun
        self.problem = problem_digest(mesh, photos, cameras, config, freedom)
        self.resume: Checkpoint | None = None
        self.checkpoint: Checkpoint | None = None
        self.began = time.perf_counter()
        self.seconds: dict[str, float] = {}
        self.generations = self.evaluations = 0
        self.warnings: list[str] = []
        self.reason = ""
        self.start_cost = self.cost = np.inf
        self.uncertainty: Uncertainty | None = None
        self.mesh_error: MeshError | None = None
        self.missed_px: tuple[float, ...] = ()
        """How far off each photo's camera is at least, because its lens was held."""
        self.missed_centre_px: tuple[float, ...] = ()
        """The same because its principal point could not move far enough."""
        self.far_centres: list[str] = []
        """The photos of which that is so."""
        self.verdict: Verdict | None = None
        self.judged: Disagreement | None = None
        """What the verdict was decided by."""
        self.fraction = 0.0
        self.reduced: tuple[Photo, ...] = ()
        """The photos that take part, as small as the polish wants them."""

    def go_on_from(self, checkpoint: Checkpoint) -> None:
        """Makes ``events`` resume from there."""
        checkpoint.require(self.problem)
        self.resume = checkpoint
        self.began -= checkpoint.elapsed_s
        self.generations = checkpoint.generations
        self.evaluations = checkpoint.search.evaluations

    def events(self) -> Generator[Event, None, None]:
        yield self._progress("prepare", "getting ready", 0.0, np.inf, np.inf)
        self._leave_out_the_blind()
        self._refuse_the_empty()
        warnings = list(self.warnings)
        search = yield from self._search_and_polish()
        if failed := self._failed():
            # Over again, so that the others end as they would have without the failed ones.
            self.warnings = warnings
            self._leave_out(failed)
            search = yield from self._search_and_polish()
        yield self._finished(search)

    def _search_and_polish(
        self,
    ) -> Generator[Event, None, GeneticSearch | GrowingSearch]:
        search = self._growing_search() if self._is_growing else self._whole_search()
        self._clock("prepare")
        if isinstance(search, GrowingSearch):
            yield from self._grow(search)
        else:
            yield from self._search(search)
        self._clock("search")
        if self.config.polish_after:
            if self.checkpoint is not None:
                self.checkpoint = dataclasses.replace(self.checkpoint, phase="polish")
            yield from self._polish()
            self._clock("polish")
        return search

    @property
    def photos(self) -> tuple[Photo, ...]:
        """The photos that take part."""
        return tuple(self.given_photos[i] for i in self.active)

    @property
    def start(self) -> tuple[Camera, ...]:
        """The pre-registration of the photos that take part."""
        return tuple(self.begun[i] for i in self.active)

    @property
    def _names(self) -> tuple[str, ...]:
        """Names of the photos that take part."""
        return tuple(photo.name for photo in self.photos)

    @property
    def freedom(self) -> Freedom:
        """What may move of the photos that take part."""
        return self.given_freedom.subset(self.active)

    def _leave_out_the_blind(self) -> None:
        """Finds which photos see the surface, and warns about those that do not.

        Raises:
            RefinementError: if none does, or only in another world.
        """
        why = why_of_another_world(self.mesh, self.given_photos, self.begun)
        if why is not None:
            raise RefinementError(why)
        samples = samples_for(self.mesh, self.begun, 2000, 0)
        seen = visible(samples, self.begun, self.mesh, "rays", 0.0)
        self.active = tuple(np.flatnonzero(seen.any(axis=1)).tolist())
        self.best = self.start
        if not self.active:
            raise RefinementError(
                "No camera sees the surface from where it stands. "
                f"{why_unseen(self.mesh, self.begun)}"
            )
        self.warnings += [
            f"The camera of {photo.name} does not see the surface and was left as it is; "
            "align it and refine again."
            for photo, row in zip(self.given_photos, seen, strict=True)
            if not row.any()
        ]
        either, shared = seen.any(axis=0).sum(), (seen.sum(axis=0) >= 2).sum()
        if len(self.active) > 1 and shared < MIN_OVERLAP * either:
            self.warnings.append(
                "The photos hardly overlap on the surface: of what they see, "
                f"only {100 * shared / either:.0f} % is seen twice, so the answer is poorly "
                "determined. Align better, or take photos from nearer viewpoints."
            )
        self.pairs = choose_pairs(self.mesh, self.photos, self.start)
        self.warnings += hanging_in_words(self._names, self.pairs)
        self._leave_out_the_settled()

    def _leave_out_the_settled(self) -> None:
        """Of many photos, those whose cameras are held only help those that are not.

        So held photos are not compared with each other, and those with which none is compared
        take no part.
        """
        if len(self.active) <= ALL_UP_TO:
            return
        moves = [not self.freedom.of(i).everything for i in range(len(self.active))]
        pairs = [pair for pair in self.pairs if any(moves[i] for i in pair)]
        if not pairs:
            return
        compared = {i for pair in pairs for i in pair}
        kept = [i for i, moving in enumerate(moves) if moving or i in compared]
        place = {i: k for k, i in enumerate(kept)}
        self.pairs = tuple((place[i], place[k]) for i, k in pairs)
        self.active = tuple(self.active[i] for i in kept)
        self.best = self.start

    def _failed(self) -> tuple[int, ...]:
        """Those of many photos that do not fit the rest, if the rest are the majority."""
        if len(self.active) <= ALL_UP_TO or self.judged is None:
            return ()
        failed = failing_photos(self.judged)
        rest = [i for i in range(len(self.active)) if i not in failed]
        moves = any(not self.freedom.of(i).everything for i in rest)
        return failed if moves and len(failed) < len(rest) else ()

    def _leave_out(self, failed: Sequence[int]) -> None:
        """Continues without these, and says so."""
        names = [self._names[i] for i in failed]
        self.warnings.append(
            f"{names[0]} did not fit the others, neither in colour nor by its outline, "
            "and was left out; its camera is unchanged. Align it more closely, or remove "
            "it if it shows something else."
            if len(names) == 1
            else f"{listed(names)} did not fit the others, neither in colour nor by "
            "their outlines, and were left out; their cameras are unchanged. Align "
            "them more closely, or remove them if they show something else."
        )
        self.uncertainty, self.mesh_error, self.missed_px = None, None, ()
        self.missed_centre_px, self.far_centres = (), []
        self.generations = self.evaluations = 0
        self.active = tuple(p for i, p in enumerate(self.active) if i not in failed)
        self.best = self.start
        self.pairs = choose_pairs(self.mesh, self.photos, self.start)
        self._leave_out_the_settled()

    def _refuse_the_empty(self) -> None:
        """Ends the run where the photos hold nothing to compare.

        Raises:
            InputError: if a photo is masked nearly all over the surface, shows neither
                texture nor edges, or is the same as another.
        """
        for refusal in check_readiness(self.mesh, self.photos, self.start).refusals:
            raise InputError(refusal)

    def _all(self, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
        """One camera a photo given: those left out stay where they were."""
        complete = list(self.given)
        for i, camera in zip(self.active, cameras, strict=True):
            complete[i] = camera
        return tuple(complete)

    @property
    def _is_growing(self) -> bool:
        """Whether photos are searched for one after the other.

        Not where the search alone answers: it compares all photos then.
        """
        return len(self.active) > ALL_UP_TO and self.config.polish_after

    def _whole_search(self) -> GeneticSearch:
        return GeneticSearch(
            self.mesh, self.photos, self.start, self.config, self.freedom
        )

    def _growing_search(self) -> GrowingSearch:
        # It has no checkpoint: started over it ends in the same cameras.
        self.resume, self.generations, self.evaluations = None, 0, 0
        scores = pair_scores(self.mesh, self.photos, self.start)
        return GrowingSearch(
            self.mesh,
            self.photos,
            self.start,
            self.config,
            self.freedom,
            self.pairs,
            scores,
        )

    def _grow(self, search: GrowingSearch) -> Iterator[Progress]:
        for step in search.steps():
            self.generations += step.generation > 0
            self.evaluations, self.best = step.evaluations, step.cameras
            words = f"search, photos {step.stage + 1} of {step.n_stages}"
            yield dataclasses.replace(
                self._searched(step.newest, words, SEARCH_SHARE * step.fraction),
                begins=None if step.generation else words,
            )
        self.reason = "All stages of the search are done."

    def _search(self, search: GeneticSearch) -> Iterator[Progress]:
        config, settings = self.config, self.config.genetic
        budget = settings.generations * settings.restarts
        share = SEARCH_SHARE if config.polish_after else 1.0
        last = None
        if self.resume is not None:
            self.best = search.go_on_from(self.resume)
            self.checkpoint, last = self.resume, self.resume.search
        for last in search.generations():
            self.generations += last.generation > 0
            self.evaluations = last.evaluations
            self.best = search.cameras(last)
            done = last.restart * settings.generations + last.generation
            self.checkpoint = Checkpoint(
                self.problem,
                "search",
                self.generations,
                self._elapsed_s,
                last,
                search.hidden_from,
            )
            begins = None
            if last.generation == 0:
                begins = f"restart {last.restart + 1} of {settings.restarts}"
            words = f"generation {self.generations} of {budget}"
            yield dataclasses.replace(
                self._searched(last, words, share * done / budget),
                begins=begins,
                population=Population(last.genes, last.costs, search.gene_map),
            )
        assert last is not None
        if last.stop == "cost level":
            self.reason = (
                f"The cost fell to the level that was set ({last.best_cost:.4g})."
            )
        elif last.stop == "stagnation":
            self.reason = "The search stopped improving."
        else:
            self.reason = "All generations of the search are done."

    def _polish(self) -> Iterator[Progress]:
        """Polishes from where search or start agree better; from both if in doubt."""
        min_cosine = self.config.polish.min_cosine
        side = polish_side_px(self.photos, self.config.polish.max_side_px)
        # Once for all levels: none looks at more pixels.
        self.reduced = tuple(photo.resized(side) for photo in self.photos)
        # Where the light moved, the search's colours mislead it, by 60 px once; where
        # the start is far off, only the search is near. What the polish will compare
        # decides which.
        ways = {"start": self.start}
        if self.best != self.start:
            ways["search"] = self.best
        fits = {
            way: disagreement(self.mesh, self.reduced, cameras, min_cosine, self.pairs)
            for way, cameras in ways.items()
        }
        self.start_cost = fits["start"].total
        answer: PolishStep | None = None
        judged: Disagreement | None = None
        for way in sorted(ways, key=lambda way: (fits[way].total, way)):
            last: PolishStep | None = None
            for step, event in self._polish_from(ways[way], fits[way], answer):
                last = step
                yield event
            assert last is not None
            assert last.disagreement is not None
            if answer is None or last.disagreement.total < self.cost:
                answer, self.cost = last, last.disagreement.total
                judged = self._against_chance(last.disagreement, last.cameras)
                self.verdict = decide_verdict(judged, self._names)
            self.best = answer.cameras
            if self.verdict is not None and self.verdict.is_credible:
                break
        assert answer is not None
        assert judged is not None
        self.judged = judged
        if max(answer.missed_px, default=0.0) > MISSED_LENS_PX:
            self.missed_px = answer.missed_px
            self.warnings.append(missed_lens_sentence(max(self.missed_px)))
            if self.verdict is not None:
                self.verdict = doubting_the_lens(self.verdict)
        self.missed_centre_px = answer.missed_centre_px
        self.far_centres = [
            name
            for name, missed in zip(self._names, self.missed_centre_px, strict=False)
            if missed > MISSED_LENS_PX
        ]
        self.warnings += answer.warnings
        self.reason += " The polish is done."
        if self._is_no_better(answer, judged, fits["start"]):
            # How sure the polish was says nothing about the start.
            expected_error_px = None
        else:
            self.uncertainty = estimate_uncertainty(self.mesh, answer, self._names)
            expected_error_px = self.uncertainty.expected_error_px
            self.mesh_error = answer.mesh_error
            if self.verdict is not None and self.mesh_error is not None:
                self.verdict = doubting_the_scan(
                    self.verdict, expected_error_px * 1024.0 / self._mean_width_px
                )
        yield dataclasses.replace(
            self._progress("polish", "polish done", 1.0, answer.cost, answer.cost),
            expected_error_px=expected_error_px,
        )

    @property
    def _mean_width_px(self) -> float:
        return float(np.mean([photo.width for photo in self.photos]))

    def _is_no_better(
        self, step: PolishStep, answer: Disagreement, start: Disagreement
    ) -> bool:
        """Whether the answer is no better than the start, which is then kept.

        By the polish's own measure; and by what the verdict measures where the answer
        does not convince: the polish's own falls at wrong ends too.
        """
        assert step.disagreement is not None
        # A polish that began at the start has answered that already.
        if step.start_disagreement is start or is_no_worse(
            self.mesh,
            self.reduced,
            (self.best, step.disagreement),
            (self.start, start),
            self.config.polish,
            self.pairs,
        ):
            if self.verdict is None or self.verdict.is_credible:
                return False
            before = self._against_chance(start, self.start)
            if is_better(answer, before, self._surface_kept()):
                return False
            reason = (
                "The start was kept: with the cameras that were found, colours and "
                "outlines fit the photos no better."
            )
        else:
            before = self._against_chance(start, self.start)
            reason = "Nothing better than the start was found."
        self._keep_the_start(reason)
        self.verdict = decide_verdict(before, self._names)
        return True

    def _surface_kept(self) -> float:
        """How much of the surface the photos share, over what they shared at the start."""
        if len(self.active) == 1:
            return 1.0  # One photo shares nothing, and need not.
        samples = samples_for(self.mesh, self.start, 2000, 0)
        min_cosine = self.config.polish.min_cosine
        shared, before = (
            share_seen_twice(samples, self.mesh, cameras, min_cosine)
            for cameras in (self.best, self.start)
        )
        return shared / max(before, 1e-9)

    def _keep_the_start(self, reason: str) -> None:
        self.best, self.cost = self.start, self.start_cost
        self.reason = reason

    def _against_chance(
        self, fit: Disagreement, cameras: Sequence[Camera]
    ) -> Disagreement:
        return against_chance(fit, self.mesh, self.reduced, cameras)

    def _polish_from(
        self, cameras: tuple[Camera, ...], fit: Disagreement, answer: PolishStep | None
    ) -> Iterator[tuple[PolishStep, Progress]]:
        """One polish; during a second one, events keep the ``answer`` of the first."""
        first, last = SEARCH_SHARE, FIRST_POLISH_SHARE
        error_px = None
        if answer is not None:
            first, last = FIRST_POLISH_SHARE, 1.0
            error_px = self._expected_error_px(answer)
        level, steps = -1, 0
        for step in polish_cameras(
            self.mesh,
            self.reduced,
            cameras,
            self.start,
            self.config.polish,
            self.config.seed,
            self.config.prior_scales,
            fit,
            self.freedom,
            self.config.distortion,
            self.pairs,
        ):
            if answer is None:
                self.best = step.cameras
                if step.scatter is not None:
                    error_px = self._expected_error_px(step)
            steps = steps + 1 if step.level == level else 0
            level = step.level
            within = 1.0 - 1.0 / (1.0 + 0.2 * steps)
            words = f"polish, level {step.level + 1} of {step.n_levels}"
            progress = self._progress(
                "polish",
                words,
                first + (last - first) * (step.level + within) / step.n_levels,
                step.cost,
                step.cost,
            )
            yield (
                step,
                dataclasses.replace(
                    progress,
                    begins=None if steps else words,
                    expected_error_px=error_px,
                ),
            )

    def _expected_error_px(self, step: PolishStep) -> float:
        """How far off the cameras are at the end of a level of the polish."""
        return estimate_uncertainty(self.mesh, step, self._names).expected_error_px

    def _finished(self, search: GeneticSearch | GrowingSearch) -> Finished:
        if isinstance(search, GeneticSearch) and not self.config.polish_after:
            if len(self.active) == 1:
                self.warnings.append(ONE_PHOTO_SEARCHED)
            self.start_cost = search.agreement.cost(self.start)
            self.cost = search.agreement.cost(self.best)
            if not self.cost <= self.start_cost:
                self._keep_the_start("Nothing better than the start was found.")
        if self.verdict is not None and not self.verdict.is_credible:
            self.warnings.insert(0, self.verdict.sentence)
        # The search cannot leave its box; the polish can, and by less than half an
        # interval it often rightly does. Convincing cameras are right wherever they are.
        on_border, warnings = border_warnings(
            search_genes(self.mesh, self.start, self.config, self.freedom),
            self.best,
            1.5 if self.config.polish_after else 0.99,
            self._names,
        )
        far = [n for n in self._names if n in self.far_centres or n in on_border]
        if far:
            self.warnings.append(far_centre_sentence(far))
        if self.verdict is not None:
            self.verdict = doubting_the_centre(self.verdict, far)
        if self.verdict is None or self.verdict.grade != "convincing":
            self.warnings += warnings
            why = why_convincing_elsewhere(self.mesh, self.photos, self.start)
            self.warnings += [] if why is None else [why]
        expected_errors_px, standard_errors, undetermined = self._how_sure()
        return Finished(
            cameras=self._all(self.best),
            start_cost=self.start_cost,
            cost=self.cost,
            reason=self.reason,
            warnings=tuple(self.warnings),
            elapsed_s=self._elapsed_s,
            generations=self.generations,
            evaluations=self.evaluations,
            seconds_by_phase=self.seconds,
            expected_errors_px=expected_errors_px,
            standard_errors=standard_errors,
            undetermined=undetermined,
            mesh_error=self.mesh_error,
            verdict=self.verdict,
            pairs=tuple((self.active[i], self.active[k]) for i, k in self.pairs),
        )

    def _how_sure(
        self,
    ) -> tuple[tuple[float | None, ...], tuple[str, ...], tuple[str, ...]]:
        """Expected errors, standard errors in words, and what stays open."""
        if self.uncertainty is None:
            return (), (), ()
        expected: list[float | None] = [None] * len(self.given)
        words = []
        nothing = (0.0,) * len(self.active)
        missed_px = np.hypot(
            self.missed_px or nothing, self.missed_centre_px or nothing
        ).tolist()
        for i, camera, missed in zip(
            self.active, self.uncertainty.cameras, missed_px, strict=True
        ):
            name = self.given_photos[i].name
            if self.given_freedom.of(i).everything:
                words.append(f"{name}: held as it was.")
                continue
            expected[i] = float(np.hypot(camera.expected_error_px, missed))
            words.append(camera.in_words(name))
        undetermined = self.uncertainty.undetermined
        if len(self.active) == 1 and not self.given_freedom.of(self.active[0]).pose:
            descriptors = surface_descriptors(self.mesh)
            if descriptors.colours is None:
                undetermined = (*slippage_words(self.mesh), *undetermined)
        return tuple(expected), tuple(words), undetermined

    @property
    def _elapsed_s(self) -> float:
        return time.perf_counter() - self.began

    def _clock(self, phase: Phase) -> None:
        since = self._elapsed_s - sum(self.seconds.values())
        self.seconds[phase] = self.seconds.get(phase, 0.0) + since

    def _searched(self, last: Generation, step: str, fraction: float) -> Progress:
        return dataclasses.replace(
            self._progress("search", step, fraction, last.best_cost, last.median_cost),
            quartile_costs=last.quartiles,
        )

    def _progress(
        self, phase: Phase, step: str, fraction: float, best: float, median: float
    ) -> Progress:
        # Without the photos that failed, everything starts over.
        self.fraction = max(self.fraction, fraction)
        return Progress(
            phase=phase,
            step=step,
            fraction=self.fraction,
            generation=self.generations,
            evaluations=self.evaluations,
            best_cost=best,
            median_cost=median,
            elapsed_s=self._elapsed_s,
            cameras=self._all(self.best),
            checkpoint=self.checkpoint,
        )


def polish_side_px(photos: Sequence[Photo], max_side_px: int) -> int:
    """The longer side to which photos are reduced, so that all have ``MOST_PIXELS``.

    Args:
        photos: All of them.
        max_side_px: The largest it may be.
    """
    side = max_side_px
    while True:
        sizes = [
            reduced_size(one.width, one.height, side, MIN_SIDE_PX) for one in photos
        ]
        excess = sum(width * height for width, height in sizes) / MOST_PIXELS
        if excess <= 1.0 or side <= MIN_SIDE_PX:
            return side
        side = max(MIN_SIDE_PX, min(side - 1, int(side / np.sqrt(excess))))


def border_warnings(
    gene_map: GeneMap, cameras: Sequence[Camera], limit: float, photos: Sequence[str]
) -> tuple[list[str], list[str]]:
    """What lies at ``limit`` half-intervals or beyond.

    Returns:
        Names of the photos whose principal points do; and a warning of all that do.
    """
    beyond = np.abs(gene_map.to_genes(cameras)) >= limit
    by_camera: dict[str, list[str]] = {}
    for name, is_on in zip(gene_map.names(), beyond, strict=True):
        if is_on:
            camera, _, gene = name.rpartition(": ")
            by_camera.setdefault(camera, []).append(gene)
    if not by_camera:
        return [], []
    far_centres = [
        photo
        for number, photo in enumerate(photos, start=1)
        if any("principal" in gene for gene in by_camera.get(f"camera {number}", ()))
    ]
    genes = "; ".join(
        f"{camera}: {listed(names)}" if camera else listed(names)
        for camera, names in by_camera.items()
    )
    return far_centres, [
        f"The answer lies on the border of the search box ({genes}): the true cameras "
        "may lie outside it. Refine again from here, or choose a wider box.",
    ]
