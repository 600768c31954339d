"""The refinement as its user drives it: start, pause, stop, go on, accept, revert."""

import dataclasses
import datetime
from collections.abc import Callable

from app.engine.client import Worker
from app.model import session as rules
from app.model.messages import Refine
from app.model.pictures import Compared
from app.model.run import Run, Status
from app.model.session import Session
from app.model.state import Document, State
from app.model.wanted_pictures import current_comparison, wanted_view
from photoreg.errors import RefinementError
from photoreg.report.run_report import RunReport, report_html

NOT_BELIEVED = "The answer does not convince, so its errors are not estimated."


class RunControl:
    """Runs of the document that is open, one at a time."""

    def __init__(
        self, session: Session, worker: Worker, send_scene: Callable[[Document], None]
    ) -> None:
        self._session, self._worker = session, worker
        self._send_scene = send_scene
        # Shared with the session: listeners run under it.
        self._lock = session.lock

    def start(self, is_wider: bool = False) -> None:
        """Starts the refinement of the photos used.

        Args:
            is_wider: Whether to search wider than the settings say.
        """
        with self._lock:
            state = self._session.state
            must_be_ready(state)
            document = state.document
            cameras, settings = document.used_cameras, state.settings
            run = Run(
                status="starting",
                number=1 + max((run.number for run in state.runs), default=0),
                began=f"{datetime.datetime.now():%Y-%m-%d %H:%M:%S}",
                preset=state.preset,
                config=settings.searching_wider() if is_wider else settings,
                photo_names=tuple(entry.name for entry in document.used),
                start=cameras,
                cameras=cameras,
                freedom=state.freedom,
                step="Starting",
            )
            self._session.change(
                None, rules.setting(run=run, kept_search=None, note="")
            )
            self._send(run)

    def go_on(self) -> None:
        """Goes on with the run on screen, which was cut short, from where it was.

        Raises:
            RefinementError: if it cannot.
        """
        with self._lock:
            state = self._session.state
            run, kept = state.run, state.kept_search
            if not state.can_go_on or kept is None:
                raise RefinementError(
                    "This run cannot go on: only the last one can, if it was cut short. "
                    "Start a new one from its cameras."
                )
            if run.photo_names != tuple(entry.name for entry in state.document.used):
                raise RefinementError(
                    f"This run was about {', '.join(run.photo_names)}. Use just these "
                    "photos to go on with it."
                )
            run = dataclasses.replace(
                run,
                status="starting",
                step="Starting",
                outcome="",
                is_unwanted=False,
                curve=tuple(point for point in run.curve if point.step <= kept.step),
            )
            self._session.change(None, rules.setting(run=run, compared_with=0))
            self._send(run)

    def _send(self, run: Run) -> None:
        state = self._session.state
        self._send_scene(state.document)
        assert run.config is not None
        self._worker.send(
            Refine(
                cameras=run.start,
                config=run.config,
                view=wanted_view(state),
                truth=state.document.true_cameras(run.photo_names),
                freedom=run.freedom,
                number=run.number,
                kept=state.kept_search,
                level=run.curve[-1].best if run.curve else 1.0,
            )
        )

    def pause(self) -> None:
        """Halts the refinement where it is."""
        if self._session.change(None, _with_status("paused", "running", "starting")):
            self._worker.pause_refinement()

    def resume(self) -> None:
        """Goes on with a refinement that was halted."""
        if self._session.change(None, _with_status("running", "paused")):
            self._worker.resume_refinement()

    def stop(self, revert: bool = False) -> None:
        """Ends the refinement; the best so far waits to be accepted, or is dropped."""

        def stopping(state: State) -> State:
            if not state.run.is_active:
                return state
            run = dataclasses.replace(
                state.run, status="stopping", step="Stopping", is_unwanted=revert
            )
            return dataclasses.replace(state, run=run)

        if self._session.change(None, stopping):
            self._worker.stop_refinement()

    def start_again(self) -> None:
        """Accepts the run on screen and starts the next one from its cameras.

        A run that did not convince would find the same again: the next one searches wider.
        """
        with self._lock:
            grade = self._session.state.run.grade
            self.accept()
            self.start(is_wider=grade is not None and grade != "convincing")

    def accept(self) -> None:
        """Takes the refined cameras into the document, as one undo step."""
        self._session.change("Refine", rules.accepted)

    def revert(self) -> None:
        """Goes back to the cameras from before the refinement."""
        self._session.change(None, rules.reverted)

    def report(self) -> tuple[str, bytes]:
        """The run on screen as a file of HTML: its name and its content.

        Raises:
            RefinementError: if no run is on screen, or its pictures are not there yet.
        """
        state = self._session.state
        comparison = current_comparison(state)
        if state.run.status != "review":
            raise RefinementError(
                "A report tells of a run that has ended. Choose one in the list of runs."
            )
        if comparison is None:
            raise RefinementError(
                "The pictures for the report are still being drawn. Try again in a "
                "moment."
            )
        text = report_html(report_of(state, comparison))
        return f"photoreg-run-{state.run.number}.html", text.encode()


def report_of(state: State, compared: Compared) -> RunReport:
    """What the report of the run on screen tells."""
    run, mesh = state.run, state.document.mesh
    errors = costs = None
    if run.start_error_px is not None and run.error_px is not None:
        errors = run.start_error_px, run.error_px
    if run.start_cost is not None and run.cost is not None:
        costs = run.start_cost, run.cost
    return RunReport(
        title=f"Run {run.number}: {', '.join(run.photo_names)}",
        subtitle=f"{mesh.name if mesh is not None else ''} · {run.began} · "
        f"{run.settings_name}",
        outcome=f"{run.outcome} {run.verdict}",
        warnings=run.warnings,
        comparisons=compared.photos,
        left=f"run {state.compared_with}" if state.compared_with else "start",
        elapsed_s=run.elapsed_s,
        generations=run.generation,
        evaluations=run.evaluations,
        errors_px=errors,
        expected_error_px=run.told_error_px,
        costs=costs,
        certainty=(NOT_BELIEVED,)
        if run.grade == "unconvincing"
        else (*run.standard_errors, *run.undetermined),
        curve=run.curve,
        photo_names=run.photo_names,
        start=run.start,
        cameras=run.cameras,
        unit=state.document.unit,
        config=run.config,
    )


def must_be_ready(state: State) -> None:
    """Refuses what needs a mesh and photos, and nothing else going on.

    Raises:
        RefinementError: if one of these is missing.
    """
    must_be_idle(state)
    if state.document.mesh is None:
        raise RefinementError("There is no mesh yet. Load one in the Data tab.")
    if not state.document.used:
        raise RefinementError(
            "No photo is in use. Add one, or tick one, in the Data tab."
        )


def must_be_idle(state: State) -> None:
    """Refuses what cannot be done while something else is going on.

    Raises:
        RefinementError: if something is.
    """
    if state.run.is_active:
        raise RefinementError("The refinement is running. Stop it first.")
    if state.run.status == "review":
        raise RefinementError("Accept or revert the refinement first.")
    if state.job is not None:
        raise RefinementError(f"{state.job.title} is still going on. Wait for its end.")


def _with_status(status: Status, *before: Status) -> Callable[[State], State]:
    """Puts the run into a status if it is in one of those ``before``."""

    def change(state: State) -> State:
        if state.run.status not in before:
            return state
        run = dataclasses.replace(state.run, status=status)
        return dataclasses.replace(state, run=run)

    return change
