"""Keeps the session in its project as it changes: there is no Save to forget.

A listener marks what has changed, and a thread of its own writes it. Who shows a state
calls `wait` first: what the page shows as done is on disk.
"""

import dataclasses
import logging
import threading
import time
import typing
from typing import Any

from app.run import Run
from app.run_store import RunStore
from app.session import Session, Step, setting
from app.state import Document, State
from photoreg.errors import PhotoregError
from photoreg.project import Project
from photoreg.project import Step as StoredStep

log = logging.getLogger(__name__)

RUN_PERIOD_S = 1.0
"""Time between writes of a run's progress; its start and end are written at once."""

RETRY_S = 3.0
"""Time until a write that failed is tried again; a full disk may be emptied."""

PATIENCE_S = 2.0
"""How long the page waits for a write before it shows a state all the same."""

PASSING = frozenset(
    [
        "document",
        "run",
        "runs",
        "kept_search",
        "job",
        "texture",
        "worker",
        "note",
        "saving",
        "agreement",
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


DOCUMENT_TYPES = tuple(_types_of(Run, _types_of(Document, {})))
"""What a project may hold besides the engine's own."""


class Autosave:
    """Writes a session's history, choices and run into a project until it is closed."""

    def __init__(self, session: Session, project: Project) -> None:
        self._session = session
        self._project = project
        self._runs = RunStore(project.runs)
        self._condition = threading.Condition()
        self._changed = 0
        self._kept = 0
        self._failed = False
        self._closed = False
        self._run_written_at = 0.0
        self._first = 0
        self._written: list[Step] = []
        self._written_now = -1
        self._thread = threading.Thread(
            target=self._write_on, daemon=True, name="autosave"
        )

    def take_up(self) -> bool:
        """Puts what the project holds on screen; False: it is empty.

        Raises:
            InputError: if it cannot be read.
        """
        first, steps, now = self._project.read_history()
        if not steps:
            return False
        self._first = first
        self._written = [Step(step.name, step.document) for step in steps]
        self._written_now = now - first
        known = {field.name for field in dataclasses.fields(State)} - PASSING
        choices = self._project.read_setting("choices", {})
        run = self._project.read_setting("run", Run())
        runs = self._project.read_setting("runs", ())
        if run.is_active and cut_short(run).status == "review":
            others = (other for other in runs if other.number != run.number)
            runs = (*others, cut_short(run))
        self._session.restore(
            self._written,
            self._written_now,
            {
                **{name: value for name, value in choices.items() if name in known},
                "runs": runs,
                "kept_search": self._runs.take_up(run, runs),
            },
            cut_short(run),
        )
        return True

    def start(self) -> None:
        """Begins to write; what is on screen first."""
        self._stop_listening = self._session.listen(self._listen)
        self._mark()
        self._thread.start()

    def close(self) -> None:
        """Writes what is left, and ends."""
        if self._closed:
            return
        self.wait()
        self._stop_listening()
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(timeout=PATIENCE_S)

    def wait(self, timeout_s: float = PATIENCE_S) -> bool:
        """Waits until all changes so far are on disk; returns whether they are."""
        with self._condition:
            wanted = self._changed
            return self._condition.wait_for(
                lambda: self._kept >= wanted or self._failed, timeout_s
            ) and (self._kept >= wanted)

    def _listen(self, old: State, new: State) -> None:
        run_goes_on = old.run.is_active and old.run.status == new.run.status
        if (
            new.document is not old.document
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
                self._condition.wait_for(
                    lambda: self._changed > self._kept or self._closed
                )
                if self._closed:
                    return
            try:
                kept = self._write()
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
                    self._session.change(None, setting(saving=""))

    def _fail(self, sentence: str) -> None:
        if not self._failed:
            log.error("Not kept: %s", sentence)
        with self._condition:
            self._failed = True
            self._condition.notify_all()
        self._session.change(None, setting(saving=sentence))
        with self._condition:
            self._condition.wait_for(lambda: self._closed, RETRY_S)

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
        with self._project.writing():
            if (
                new
                or len(steps) != len(self._written) - (offset or 0)
                or now != self._written_now - (offset or 0)
            ):
                stored = [StoredStep(step.name, step.document) for step in new]
                self._project.write_history(after, stored, first + now)
            self._project.write_settings(
                {"choices": _choices(state), "run": state.run, "runs": state.runs}
            )
            self._runs.write(state)
        self._first, self._written, self._written_now = first, steps, now
        return changed


def _find(written: list[Step], document: object) -> int | None:
    return next((i for i, s in enumerate(written) if s.document is document), None)


def _same(a: Step, b: Step) -> bool:
    return a.document is b.document and a.name == b.name


def _choices(state: State) -> dict[str, Any]:
    """The user's choices that are plain values; new ones are kept without a word here."""
    return {
        field.name: value
        for field in dataclasses.fields(state)
        if field.name not in PASSING
        and isinstance(value := getattr(state, field.name), bool | int | float | str)
    }


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
