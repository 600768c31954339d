"""Keeps the session in its project as it changes: there is no Save to forget.

A listener marks what has changed, and a thread of its own writes it. Who shows a state
calls `wait` first: what the page shows as done is on disk.
"""

import dataclasses
import functools
import logging
import threading
import time
import typing
from collections.abc import Callable
from typing import Any

from app.control.run_store import RunStore
from app.model.run import Run
from app.model.session import Session, setting
from app.model.state import Document, State, Texture
from app.model.undo_history import UndoStep
from photoreg.errors import InputError, OutputError, PhotoregError
from photoreg.project.project import Project, StoredStep
from photoreg.project.result import RESULT, ProjectResult
from photoreg.project.types import fits

log = logging.getLogger(__name__)

RUN_PERIOD_S = 1.0
"""Time between writes of a run's progress; its start and end are written at once."""

RETRY_S = 3.0
"""Time until a write that failed is tried again; a full disk may be emptied."""

WATCH_S = 1.0
"""How often a look is taken whether the project's folder is still there."""

PATIENCE_S = 2.0
"""How long a write is waited for before the page says that it is still going on."""

PASSING = frozenset(
    [
        "document",
        "run",
        "runs",
        "kept_search",
        "reach",
        "job",
        "texture",
        "drawn",
        "shows_other",
        "surface_glb",
        "cloud",
        "comparison",
        "worker",
        "note",
        "notice",
        "project",
        "read_only",
        "waiting",
        "saving",
        "agreement",
        "chosen_pair",
        "solution",
        "readiness",
        "speed",
        "undo_name",
        "redo_name",
    ]
)
"""Fields of the state that are not choices of the user, or are kept otherwise."""


def _types_of(hint: Any, found: dict[Any, None]) -> dict[Any, None]:
    """The dataclasses that a type consists of, however deep."""
    is_new = isinstance(hint, type) and hint not in found
    if is_new and dataclasses.is_dataclass(hint):
        found[hint] = None
        for part in typing.get_type_hints(hint).values():
            _types_of(part, found)
    for part in typing.get_args(hint):
        _types_of(part, found)
    return found


CHOICES: dict[str, Any] = {
    name: hint
    for name, hint in typing.get_type_hints(State).items()
    if name not in PASSING
}
"""The user's choices and their types; new ones are kept without a word here."""

DOCUMENT_TYPES = tuple(
    functools.reduce(
        lambda found, hint: _types_of(hint, found),
        [Document, Run, Texture, ProjectResult, *CHOICES.values()],
        {},
    )
)
"""What a project may hold besides the engine's own."""


RUNS_TYPE = tuple[Run, ...]
TEXTURE_TYPE = Texture | None


class Autosave:
    """Writes a session's history, choices and run into a project until it is closed."""

    def __init__(self, session: Session, project: Project) -> None:
        self._session = session
        self.project = project
        self._runs = RunStore(project.runs)
        self._between_writes = threading.Lock()
        self._condition = threading.Condition()
        self._changed = 0
        self._kept = 0
        self._failed = False
        self._closed = False
        self._run_written_at = 0.0
        self._first = 0
        self._written: list[UndoStep] = []
        self._written_now = -1
        self._thread = threading.Thread(
            target=self._write_on, daemon=True, name="autosave"
        )

    def take_up(self) -> Callable[[], None] | None:
        """Reads what the project holds.

        Returns:
            What puts it on screen; None: it is empty.

        Raises:
            InputError: if it cannot be read.
        """
        first, steps, now = self.project.read_history(kind=Document)
        if not steps:
            return None
        self._first = first
        self._written = [UndoStep(step.name, step.document) for step in steps]
        self._written_now = now - first
        run = self.project.read_setting("run", Run(), Run)
        runs = self.project.read_setting("runs", (), RUNS_TYPE)
        if run.is_active and cut_short(run).status == "review":
            others = (other for other in runs if other.number != run.number)
            runs = (*others, cut_short(run))
        note = ""
        try:
            stored = self.project.read_setting("choices", {}, dict)
        except InputError as error:
            # They are quickly chosen again; the work must not wait for them.
            log.warning("Choices of the page were not read: %s", error)
            stored, note = {}, f"What was chosen on the page is as at first: {error}"
        choices = {
            name: value
            for name, value in stored.items()
            if name in CHOICES and fits(value, CHOICES[name])
        }
        choices |= {
            "note": note,
            "runs": runs,
            "texture": self.project.read_setting("texture", None, TEXTURE_TYPE),
            "kept_search": self._runs.take_up(run, runs),
        }
        return lambda: self._session.restore(
            self._written, now - first, choices, cut_short(run)
        )

    def copy(self, make: Callable[[], Project]) -> "Autosave":
        """The same for a copy of the project, which ``make`` makes between two writes."""
        with self._between_writes:
            copy = Autosave(self._session, make())
            copy._first, copy._written = self._first, self._written
            copy._written_now = self._written_now
            copy._runs = self._runs.copy(copy.project.runs)
        return copy

    def start(self) -> None:
        """Begins to write; what is on screen first."""
        self._stop_listening = self._session.listen(self._listen)
        self._mark()
        self._thread.start()

    def close(self, then: Callable[[], None] | None = None) -> None:
        """Writes what is left, and ends.

        Args:
            then: Puts something else on screen, with no change between the last that is
                kept and that; None: the program ends.

        Raises:
            OutputError: if what is left cannot be kept and would be lost by ``then``;
                nothing has ended.
        """
        while not self._closed:
            self.wait(None)
            with self._session.lock:
                with self._condition:
                    if self._kept < self._changed and not self._failed:
                        continue
                    if self._kept < self._changed and then is not None:
                        raise OutputError(
                            f"{self._session.state.saving} Until it is kept, nothing "
                            "else can be opened; saving as another project helps."
                        )
                    self._closed = True
                    self._condition.notify_all()
                self._stop_listening()
                if then is not None:
                    then()
        self._thread.join()

    def wait(self, timeout_s: float | None = PATIENCE_S) -> bool:
        """Waits until all changes so far are on disk; returns whether they are.

        If they cannot be saved, the state says so and this returns at once.
        """
        with self._condition:
            wanted = self._changed
            self._condition.wait_for(
                lambda: self._kept >= wanted or self._failed or self._closed, timeout_s
            )
            return self._kept >= wanted

    def _listen(self, old: State, new: State) -> None:
        run_goes_on = old.run.is_active and old.run.status == new.run.status
        if (
            new.document is not old.document
            or new.texture is not old.texture
            or _choices(new) != _choices(old)
            or (
                new.run is not old.run
                and (
                    not run_goes_on
                    or time.monotonic() - self._run_written_at > RUN_PERIOD_S
                )
            )
        ):
            self._mark()

    def _mark(self) -> None:
        with self._condition:
            self._changed += 1
            self._condition.notify_all()

    def _write_on(self) -> None:
        while True:
            with self._condition:
                is_due = self._condition.wait_for(
                    lambda: self._changed > self._kept or self._closed, WATCH_S
                )
                if self._closed:
                    return
            try:
                with self._between_writes:
                    self.project.check_place()
                    kept = self._write() if is_due else self._kept
            except PhotoregError as error:
                self._fail(str(error))
            except Exception:
                log.exception("The work could not be kept")
                self._fail("Your work is not being kept; the log has the details.")
            else:
                with self._condition:
                    self._kept = max(self._kept, kept)
                    self._failed = False
                    self._condition.notify_all()
                if self._session.state.saving:
                    self._say("")

    def _fail(self, sentence: str) -> None:
        if not self._failed:
            log.error("Not kept: %s", sentence)
        # Before the waiters are released, so that whoever sees the change sees this too.
        self._say(sentence)
        with self._condition:
            self._failed = True
            self._condition.notify_all()
            self._condition.wait_for(lambda: self._closed, RETRY_S)

    def _say(self, sentence: str) -> None:
        try:
            self._session.change(None, setting(saving=sentence))
        except Exception:
            # Somebody who listens has failed; the work is kept all the same.
            log.exception("A change was not followed")

    def _write(self) -> int:
        with self._session.lock:
            changed, state = self._changed, self._session.state
            steps, now = self._session.history()
        after, first, new = self._first - 1, self._first, steps
        offset = _find(self._written, steps[0].document)
        if offset is not None:
            first += offset
            same = 1
            while (
                same < len(steps)
                and offset + same < len(self._written)
                and _same(steps[same], self._written[offset + same])
            ):
                same += 1
            after, new = first + same - 1, steps[same:]
        self._run_written_at = time.monotonic()
        with self.project.writing():
            if (
                new
                or len(steps) != len(self._written) - (offset or 0)
                or now != self._written_now - (offset or 0)
            ):
                stored = [StoredStep(step.name, step.document) for step in new]
                self.project.write_history(after, stored, first + now)
            self.project.write_settings(
                {
                    "choices": _choices(state),
                    "run": state.run,
                    "runs": state.runs,
                    "texture": state.texture,
                    RESULT: result_of(state),
                }
            )
            runs = self._runs.copy()
            runs.write(state)
        # Only what has come to the disk is remembered as written.
        self._runs = runs
        self._first, self._written, self._written_now = first, steps, now
        return changed


def result_of(state: State) -> ProjectResult:
    """What the project has come to, for programs that do not know its documents."""
    run = state.document_run
    return ProjectResult(
        cameras={entry.name: entry.camera for entry in state.document.used},
        grade=None if run is None else run.grade,
        sentence="" if run is None else run.verdict,
        expected_error_px=None if run is None else run.expected_error_px,
    )


def _find(written: list[UndoStep], document: object) -> int | None:
    return next((i for i, s in enumerate(written) if s.document is document), None)


def _same(a: UndoStep, b: UndoStep) -> bool:
    return a.document is b.document and a.name == b.name


def _choices(state: State) -> dict[str, Any]:
    return {name: getattr(state, name) for name in CHOICES}


def cut_short(run: Run) -> Run:
    """A run as it is shown after the program has ended in the middle of it."""
    if not run.is_active:
        return run
    if not run.curve:
        return Run()
    return dataclasses.replace(
        run,
        status="review",
        step="",
        outcome="photoreg was ended meanwhile; this is the best until then.",
    )
