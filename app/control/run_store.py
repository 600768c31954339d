"""Keeps each run in the project as it goes, so that it can go on after any end."""

import copy

from app.model.run import KeptSearch, Run
from app.model.state import State
from photoreg.project.runs import ProjectRuns, StoredGeneration


class RunStore:
    """Writes runs, their course and where they can go on; reads that again.

    Whoever writes the rest of the state calls it, in one transaction with that: what
    the page shows of a run and from where it goes on are of one moment.
    """

    def __init__(self, runs: ProjectRuns) -> None:
        self._runs = runs
        self._id = self._number = 0
        self._step = -1
        self._written: KeptSearch | None = None

    def copy(self, runs: ProjectRuns | None = None) -> "RunStore":
        """The same, to write on with; ``runs``: those of a copy of the project."""
        other: RunStore = copy.copy(self)
        other._runs = runs or self._runs
        return other

    def take_up(self, run: Run, ended: tuple[Run, ...]) -> KeptSearch | None:
        """From where the last run can go on, if it was cut short.

        Args:
            run: The run that was on screen.
            ended: Those in the list.
        """
        unfinished = self._runs.unfinished_run()
        if unfinished is None:
            return None
        self._id = unfinished.id
        self._number = max([run.number, *(other.number for other in ended)])
        kept = self._runs.checkpoint(unfinished.id)
        if kept is not None:
            self._written = KeptSearch(self._number, kept.generation, kept.content)
        return self._written

    def write(self, state: State) -> None:
        """Writes what is new."""
        run, kept = state.run, state.kept_search
        if run.is_active and run.number != self._number:
            self._end(state)
            seed = None if run.config is None else run.config.seed
            settings = {"preset": run.preset, "freedom": run.freedom, "all": run.config}
            self._id = self._runs.add_run(settings, seed, run.photo_names, run.start)
            self._number, self._step, self._written = run.number, -1, None
        if self._id == 0:
            return
        if run.number == self._number:
            self._add_course(run)
        if kept is not None and kept.run == self._number:
            if kept is not self._written:
                self._runs.add_checkpoint(
                    self._id, kept.content, kept.step, run.cameras or None
                )
                self._written = kept
        elif not run.is_active:
            self._end(state)

    def _add_course(self, run: Run) -> None:
        new = [point for point in run.curve if point.step > self._step]
        if new:
            self._runs.add_generations(
                self._id, [StoredGeneration(p.step, p.best, p.median) for p in new]
            )
        if run.curve:
            self._step = run.curve[-1].step

    def _end(self, state: State) -> None:
        """Ends the run that was written last, if it has not ended yet."""
        if self._id == 0:
            return
        run = next((run for run in state.runs if run.number == self._number), None)
        if run is None:
            self._runs.remove_run(self._id)  # It failed, or nobody wanted it.
        else:
            self._runs.end_run(
                self._id,
                run.cameras,
                run.cost,
                start_cost=run.start_cost,
                outcome=run.outcome,
                figures={
                    "elapsed_s": run.elapsed_s,
                    "evaluations": run.evaluations,
                    "error_px": run.error_px,
                    "expected_errors_px": run.expected_errors_px,
                    "warnings": run.warnings,
                },
            )
        self._id = 0
