"""The whole refinement: prepare, search, polish, and the events that tell of it."""

import dataclasses
import time
from collections.abc import Generator, Iterator, Sequence

import numpy as np

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface
from photoreg.geometry.visibility import visible
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.genes import GeneMap
from photoreg.polish.misfit import Disagreement, against_chance, disagreement
from photoreg.polish.polish_cameras import PolishStep, polish_cameras
from photoreg.polish.uncertainty import Uncertainty, estimate_uncertainty
from photoreg.registration.checkpoint import Checkpoint, problem_digest
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Event, Finished, Phase, Population, Progress
from photoreg.registration.genetic_search import GeneticSearch
from photoreg.registration.readiness import check_readiness
from photoreg.registration.verdict import Verdict, decide_verdict, is_better
from photoreg.words import listed

MIN_OVERLAP = 0.1
"""Share of what the photos see that two must see, lest the user is warned."""

FIRST_POLISH_SHARE = 0.9
"""Share of the progress bar at which the first polish ends; a second is rare."""

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

    Stop iterating to cancel: every event holds the best cameras so far. The last
    event is a ``Finished``.

    Args:
        mesh: The surface.
        photos: Two or more.
        cameras: The pre-registration, one a photo, in the same order.
        config: Settings; None: the default preset.
        freedom: What may move; None: everything. What is held stays to the last bit.
        resume: Go on from this ``Progress.checkpoint`` of the same refinement, to the
            answer that it would have had without the break, bit for bit.

    Raises:
        InputError: if photos and cameras do not match, if ``freedom`` leaves nothing
            to move, if ``resume`` is of another refinement, or if there is nothing to
            compare: see ``Readiness.refusals``.
        RefinementError: if no camera sees the surface, or no two see a common part.
    """
    if len(photos) < 2:
        raise InputError(f"A refinement needs two photos or more, not {len(photos)}.")
    if len(photos) != len(cameras):
        raise InputError(
            f"There are {len(photos)} photos but {len(cameras)} cameras; give one camera "
            "a photo, in the same order."
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
        self.mesh, self.config = mesh, config
        self.given_photos, self.given = tuple(photos), tuple(cameras)
        self.given_freedom = freedom
        self.begun = freedom.begin(self.given, mesh.centroid)
        """The cameras given, with one focal length where photos share it."""
        self.active = tuple(range(len(photos)))
        """Which photos take part: those whose cameras see the surface."""
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
        self.verdict: Verdict | None = None
        self.reduced: tuple[Photo, ...] = ()
        """The photos that take part, as small as the polish wants them."""

    def go_on_from(self, checkpoint: Checkpoint) -> None:
        """Makes ``events`` go on from there."""
        checkpoint.require(self.problem)
        self.resume = checkpoint
        self.began -= checkpoint.elapsed_s
        self.generations = checkpoint.generations
        self.evaluations = checkpoint.search.evaluations

    def events(self) -> Generator[Event, None, None]:
        yield self._progress("prepare", "getting ready", 0.0, np.inf, np.inf)
        self._leave_out_the_blind()
        self._refuse_the_empty()
        search = GeneticSearch(
            self.mesh, self.photos, self.start, self.config, self.freedom
        )
        self._clock("prepare")
        yield from self._search(search)
        self._clock("search")
        if self.config.polish_after:
            if self.checkpoint is not None:
                self.checkpoint = dataclasses.replace(self.checkpoint, phase="polish")
            yield from self._polish()
            self._clock("polish")
        yield self._finished(search)

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
        """What the photos that take part are called."""
        return tuple(photo.name for photo in self.photos)

    @property
    def freedom(self) -> Freedom:
        """What may move of the photos that take part."""
        return self.given_freedom.subset(self.active)

    def _leave_out_the_blind(self) -> None:
        """Finds who sees the surface, and warns of who does not.

        Raises:
            RefinementError: if nobody does.
        """
        seen = visible(
            sample_surface(self.mesh, 2000, 0), self.begun, self.mesh, "rays", 0.0
        )
        self.active = tuple(np.flatnonzero(seen.any(axis=1)).tolist())
        self.best = self.start
        if not self.active:
            raise RefinementError(
                "No camera sees the surface from where it stands. Align the cameras "
                "first."
            )
        self.warnings += [
            f"The camera of {photo.name} does not see the surface and was left as it is; "
            "align it and refine again."
            for photo, row in zip(self.given_photos, seen, strict=True)
            if not row.any()
        ]
        either, shared = seen.any(axis=0).sum(), (seen.sum(axis=0) >= 2).sum()
        if shared < MIN_OVERLAP * either:
            self.warnings.append(
                "The photos hardly overlap on the surface: of what they see, "
                f"{100 * shared / either:.0f} % is seen twice, so the answer rests on "
                "little. Align better, or take photos from nearer viewpoints."
            )

    def _refuse_the_empty(self) -> None:
        """Ends the run where the photos hold nothing to compare.

        Raises:
            InputError: if a photo is masked nearly all over the surface, shows neither
                texture nor edges, or is another one again.
        """
        for refusal in check_readiness(self.mesh, self.photos, self.start).refusals:
            raise InputError(refusal)

    def _all(self, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
        """One camera a photo given: those left out stay where they were."""
        complete = list(self.given)
        for i, camera in zip(self.active, cameras, strict=True):
            complete[i] = camera
        return tuple(complete)

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
            yield dataclasses.replace(
                self._progress(
                    "search",
                    f"generation {self.generations} of {budget}",
                    share * done / budget,
                    last.best_cost,
                    last.median_cost,
                ),
                quartile_costs=last.quartiles,
                begins=begins,
                population=Population(last.genes, last.costs, search.gene_map),
            )
        assert last is not None
        if last.stop == "cost level":
            self.reason = (
                f"The cost fell to the level asked for ({last.best_cost:.4g})."
            )
        elif last.stop == "stagnation":
            self.reason = "The search stopped improving."
        else:
            self.reason = "All generations of the search are done."

    def _polish(self) -> Iterator[Progress]:
        """Polishes from where search or start agree better; from both when in doubt."""
        min_cosine = self.config.polish.min_cosine
        side = self.config.polish.max_side_px
        # Once for all levels: they never look at more pixels.
        self.reduced = tuple(photo.resized(side) for photo in self.photos)
        # Where the light moved, the search's colours mislead it, by 60 px once; where
        # the start is far off, only the search is near. What the polish will compare
        # tells which.
        ways = {"start": self.start}
        if self.best != self.start:
            ways["search"] = self.best
        fits = {
            way: disagreement(self.mesh, self.reduced, cameras, min_cosine)
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
        self.warnings += answer.warnings
        self.reason += " The polish is done."
        if self._is_no_better(judged, fits["start"]):
            # How sure the polish was says nothing of the start.
            expected_error_px = None
        else:
            self.uncertainty = estimate_uncertainty(self.mesh, answer, self._names)
            expected_error_px = self.uncertainty.expected_error_px
        yield dataclasses.replace(
            self._progress("polish", "polish done", 1.0, answer.cost, answer.cost),
            expected_error_px=expected_error_px,
        )

    def _is_no_better(self, answer: Disagreement, start: Disagreement) -> bool:
        """Whether the answer is no better than the start, which is then kept.

        Only of an answer that does not convince, by what the verdict measures: the
        polish's own measure falls at wrong ends too.
        """
        if self.verdict is None or self.verdict.is_credible:
            return False
        before = self._against_chance(start, self.start)
        if is_better(answer, before):
            return False
        self.best, self.cost = self.start, self.start_cost
        self.verdict = decide_verdict(before, self._names)
        self.reason = (
            "The start was kept: colours and outlines fit the photos no better with the "
            "cameras found from it."
        )
        return True

    def _against_chance(
        self, fit: Disagreement, cameras: Sequence[Camera]
    ) -> Disagreement:
        return against_chance(fit, self.mesh, self.reduced, cameras)

    def _polish_from(
        self, cameras: tuple[Camera, ...], fit: Disagreement, answer: PolishStep | None
    ) -> Iterator[tuple[PolishStep, Progress]]:
        """One polish; a second one keeps showing the ``answer`` of the first."""
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

    def _finished(self, search: GeneticSearch) -> Finished:
        if not self.config.polish_after:
            self.start_cost = search.consistency.cost(self.start)
            self.cost = search.consistency.cost(self.best)
        if not self.cost <= self.start_cost:
            self.best, self.cost = self.start, self.start_cost
            self.reason = "Nothing better than the start was found."
        if self.verdict is not None and not self.verdict.is_credible:
            self.warnings.insert(0, self.verdict.sentence)
        # The search cannot leave its box; the polish can, and by less than half an
        # interval it often rightly does.
        self.warnings += border_warnings(
            search.gene_map, self.best, 1.5 if self.config.polish_after else 0.99
        )
        return Finished(
            self._all(self.best),
            self.start_cost,
            self.cost,
            self.reason,
            tuple(self.warnings),
            self._elapsed_s,
            self.generations,
            self.evaluations,
            self.seconds,
            *self._how_sure(),
            verdict=self.verdict,
        )

    def _how_sure(
        self,
    ) -> tuple[tuple[float | None, ...], tuple[str, ...], tuple[str, ...]]:
        """Expected errors, standard errors in words, and what stays open."""
        if self.uncertainty is None:
            return (), (), ()
        expected: list[float | None] = [None] * len(self.given)
        words = []
        for i, camera in zip(self.active, self.uncertainty.cameras, strict=True):
            name = self.given_photos[i].name
            if self.given_freedom.of(i).everything:
                words.append(f"{name}: held as it was.")
                continue
            expected[i] = camera.expected_error_px
            words.append(camera.in_words(name))
        return tuple(expected), tuple(words), self.uncertainty.undetermined

    @property
    def _elapsed_s(self) -> float:
        return time.perf_counter() - self.began

    def _clock(self, phase: Phase) -> None:
        self.seconds[phase] = self._elapsed_s - sum(self.seconds.values())

    def _progress(
        self, phase: Phase, step: str, fraction: float, best: float, median: float
    ) -> Progress:
        return Progress(
            phase,
            step,
            fraction,
            self.generations,
            self.evaluations,
            best,
            median,
            self._elapsed_s,
            self._all(self.best),
            checkpoint=self.checkpoint,
        )


def border_warnings(
    gene_map: GeneMap, cameras: Sequence[Camera], limit: float
) -> list[str]:
    """A warning that names the genes at ``limit`` half-intervals or beyond, if any."""
    beyond = np.abs(gene_map.to_genes(cameras)) >= limit
    by_camera: dict[str, list[str]] = {}
    for name, is_on in zip(gene_map.names(), beyond, strict=True):
        if is_on:
            camera, _, gene = name.rpartition(": ")
            by_camera.setdefault(camera, []).append(gene)
    if not by_camera:
        return []
    genes = "; ".join(
        f"{camera}: {listed(names)}" if camera else listed(names)
        for camera, names in by_camera.items()
    )
    return [
        f"The answer lies on the border of the search box ({genes}): the true cameras "
        "may lie outside. Refine again from here, or choose a wider box."
    ]
