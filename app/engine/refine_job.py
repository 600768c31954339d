"""One refinement in the worker process: run it, tell of it, pause it, stop it."""

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterator

import numpy as np

from app.engine.overlay_job import Drawing
from app.engine.picture_stream import PictureStream
from app.model.messages import (
    Event,
    Job,
    Live,
    Pause,
    Refine,
    Refined,
    Resume,
    SearchKept,
    Stop,
    Watch,
)
from app.model.pictures import Cloud, OverlayView
from app.model.run import KeptSearch
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.registration.checkpoint import Checkpoint
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Event as Step
from photoreg.registration.events import Finished, Progress
from photoreg.registration.refinement import refine
from photoreg.report.cost_curve import CostCurve, CurvePoint

PICTURE_PERIOD_S = 0.16
"""Time between overlay pictures during a refinement: six a second. Cameras, cost
and text are sent with them: nobody reads faster, and each redraws the page."""

N_CLOUD = 80
"""Individuals whose camera centres are shown."""

KEEP_PERIOD_S = 1.0
"""Time between states that a run can go on from: 2 ms each, 60 to 200 KB."""

JUDGE_PERIOD_S = 0.3
"""Time between measurements during a refinement: 2 ms each, under a hundredth of it."""


class Preparation:
    """A refinement begun before it was asked for, and halted at its first generation.

    What takes a third of a second there (photos made ready, points drawn, the first
    population valued) is then done when the user presses Refine. It is the very
    refinement that would be begun then, so the answer has the same bits.
    """

    def __init__(
        self,
        mesh: Mesh,
        photos: tuple[Photo, ...],
        cameras: tuple[Camera, ...],
        config: RegistrationConfig,
        freedom: Freedom,
    ) -> None:
        """Begins it.

        Raises:
            PhotoregError: if these cameras cannot be refined so.
        """
        self._cameras, self._config, self._freedom = cameras, config, freedom
        self._steps = refine(mesh, photos, cameras, config, freedom)
        # Getting ready, and the first generation.
        self._first = [next(self._steps), next(self._steps)]
        self._halted_at = time.monotonic()

    def is_for(self, job: Refine) -> bool:
        """Whether it is what ``job`` asks for, to the last bit."""
        return (
            job.kept is None
            and (self._config, self._freedom) == (job.config, job.freedom)
            and len(self._cameras) == len(job.cameras)
            and all(map(_is_identical, self._cameras, job.cameras))
        )

    def go_on(self) -> tuple[Iterator[Step], float]:
        """All its steps, once, and for how many seconds it stood still."""
        halted_s = time.monotonic() - self._halted_at
        return itertools.chain(self._first, self._steps), halted_s


def _is_identical(a: Camera, b: Camera) -> bool:
    return (a.width, a.height, a.lens) == (b.width, b.height, b.lens) and all(
        np.array_equal(x, y)
        for x, y in (
            (a.K, b.K),
            (a.R_cam_world, b.R_cam_world),
            (a.t_cam_world, b.t_cam_world),
        )
    )


class RefineJob:
    """A refinement and the events sent while it runs."""

    def __init__(
        self,
        job: Refine,
        mesh: Mesh,
        photos: tuple[Photo, ...],
        drawing: Drawing,
        picture_stream: PictureStream,
        measure: Callable[[tuple[Camera, ...]], None],
        send: Callable[[Event], None],
        preparation: Preparation | None = None,
    ) -> None:
        self._job, self._mesh, self._photos = job, mesh, photos
        self._preparation = preparation
        self._drawing, self._picture_stream = drawing, picture_stream
        self._measure, self._send = measure, send
        self._view = job.view
        self._best = job.cameras
        self._paused_s = 0.0
        self._kept_at, self._kept_phase = -np.inf, ""
        self._search_step = -1 if job.kept is None else job.kept.step

    def run(self, messages: Callable[[bool], Iterator[Job]]) -> None:
        """Refines to the end, or until it is told to stop.

        Args:
            messages: What the app sent since it was asked last; if told so, it waits
                for something.
        """
        job = self._job
        start_error = self._drawing.true_error(job.truth, job.cameras)
        finished, last, curve = None, None, []
        resume = None if job.kept is None else Checkpoint.from_bytes(job.kept.content)
        self._costs = _curve_from(job, resume)
        due = judged_at = -np.inf
        try:
            for event in self._steps(resume):
                self._best = tuple(event.cameras)
                if isinstance(event, Finished):
                    finished = event
                    break
                last = event
                if event.phase == "prepare":
                    # The start is on screen already; drawing would hold up what follows.
                    self._send(self._live(event, []))
                    continue
                now = time.monotonic()
                curve.extend(self._costs.points(event))
                self._keep(event, now)
                if now >= due:
                    due = max(due + PICTURE_PERIOD_S, now)
                    self._send(self._live(event, curve))
                    curve.clear()
                    if now - judged_at >= JUDGE_PERIOD_S:
                        judged_at = now
                        self._measure(self._best)
                    self._paint()
                if self._must_stop(messages):
                    break
        finally:
            # Also where the engine breaks: what was reached until then is known.
            if last is not None:
                self._send(self._live(last, curve))
                if finished is None:
                    self._keep(last, np.inf)
        self._measure(self._best)
        self._picture_stream.finish()
        self._send(
            self._drawing.picture(self._best, self._view, job.truth, job.cameras)
        )
        error = self._drawing.true_error(job.truth, self._best)
        self._send(Refined(self._best, finished, start_error, error, self._paused_s))

    def _steps(self, resume: Checkpoint | None) -> Iterator[Step]:
        """The refinement's steps, from the preparation if that is for this job."""
        job, preparation = self._job, self._preparation
        if preparation is not None and preparation.is_for(job):
            steps, self._paused_s = preparation.go_on()
            return steps
        return refine(
            self._mesh, self._photos, job.cameras, job.config, job.freedom, resume
        )

    def _live(self, event: Progress, curve: list[CurvePoint]) -> Live:
        cloud = None
        if event.population is not None:
            cloud = Cloud(event.population.centers(N_CLOUD).astype(np.float32))
        return Live(_light(event), tuple(curve), self._paused_s, cloud)

    def _keep(self, event: Progress, now: float) -> None:
        """Sends where the run can go on, every so often and where the polish begins."""
        checkpoint = event.checkpoint
        if checkpoint is None:
            return
        is_due = now - self._kept_at >= KEEP_PERIOD_S
        if event.phase == "search":
            self._search_step = self._costs.step
            if not is_due:
                return
        elif self._kept_phase == checkpoint.phase:
            return  # Of a polish its beginning is kept.
        self._kept_at, self._kept_phase = now, checkpoint.phase
        content = dataclasses.replace(
            checkpoint, elapsed_s=checkpoint.elapsed_s - self._paused_s
        ).to_bytes()
        self._send(SearchKept(KeptSearch(self._job.number, self._search_step, content)))

    def _paint(self) -> None:
        job = self._job
        self._picture_stream.offer(
            self._drawing, self._best, self._view, job.truth, job.cameras
        )

    def _must_stop(self, messages: Callable[[bool], Iterator[Job]]) -> bool:
        is_paused, began = False, time.monotonic()
        while True:
            for message in messages(is_paused):
                match message:
                    case Stop():
                        return True
                    case OverlayView():
                        self._view = message
                        if is_paused:
                            self._paint()
                    case Watch():
                        self._picture_stream.is_watched = message.on
                        if is_paused:
                            self._paint()
                    case Pause():
                        is_paused, began = True, time.monotonic()
                    case Resume() if is_paused:
                        is_paused = False
                        self._paused_s += time.monotonic() - began
            if not is_paused:
                return False


def _curve_from(job: Refine, resume: Checkpoint | None) -> CostCurve:
    if job.kept is None or resume is None:
        return CostCurve()
    return CostCurve(resume.search.best_cost, job.level, job.kept.step)


def _light(event: Progress) -> Progress:
    """The event without the population: 55 KB that the page has no use for."""
    return dataclasses.replace(event, population=None, checkpoint=None)
