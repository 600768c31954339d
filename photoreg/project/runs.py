"""The runs of a project: settings, start, generations, checkpoint, answer."""

import dataclasses
import json
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import numpy as np

from photoreg.checks import Measured
from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.project.schema import now_utc
from photoreg.project.types import check_fields
from photoreg.project.values import Values

Cameras = tuple[Camera, ...]

T = TypeVar("T")


@dataclasses.dataclass(frozen=True, kw_only=True)
class StoredRun:
    """A refinement as the project remembers it."""

    id: int
    started_utc: str
    """ISO 8601."""
    ended_utc: str | None
    """None while it runs, and where it was cut short."""
    settings: Mapping[str, Any]
    """As they were given, as JSON has it: tuples are lists."""
    seed: int | None
    photo_names: tuple[str, ...]
    """The photos that took part."""
    start: Cameras
    """Cameras at the start, in the order of ``photo_names``."""
    cameras: Cameras | None
    """The answer; of a run that has not ended the best at its last checkpoint."""
    start_cost: Measured | None
    cost: Measured | None
    outcome: str
    """How it ended, in words."""
    figures: Mapping[str, Any]
    """Whatever else was measured, by name."""
    n_generations: int
    """How many generations were written."""


@dataclasses.dataclass(frozen=True)
class StoredGeneration:
    """One point of a run's course."""

    number: int
    best: Measured
    median: Measured


@dataclasses.dataclass(frozen=True)
class StoredCheckpoint:
    """From where a run that was cut short can go on."""

    generation: int
    cameras: Cameras | None
    """The best so far."""
    content: bytes
    """The state of the search, as the engine wrote it."""


class ProjectRuns:
    """The tables of runs. Every write is on disk when the call returns.

    Args:
        connection: The open database.
        values: Keeps the cameras.
        access: What the database is read within: holds it, and says when it is damaged.
        writing: The transaction to write in.
    """

    def __init__(
        self,
        connection: sqlite3.Connection,
        values: Values,
        access: Callable[[], AbstractContextManager[Any]],
        writing: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self._connection = connection
        self._values = values
        self._access = access
        self._writing = writing

    def add_run(
        self,
        settings: object,
        seed: int | None,
        photo_names: Sequence[str],
        start: Sequence[Camera],
    ) -> int:
        """Begins a run.

        Args:
            settings: A dataclass or a mapping, of numbers, text, and more such.
            seed: Its seed.
            photo_names: The photos that take part.
            start: Their cameras.

        Returns:
            Its number.
        """
        with self._writing():
            cursor = self._connection.execute(
                "INSERT INTO runs (started_utc, settings, seed, photo_names, start) "
                "VALUES (?, ?, ?, ?, ?)",
                (
                    now_utc(),
                    json.dumps(_plain(settings)),
                    seed,
                    json.dumps(list(photo_names)),
                    self._values.text_of(tuple(start)),
                ),
            )
            assert cursor.lastrowid is not None
            return cursor.lastrowid

    def add_generations(
        self, run: int, generations: Sequence[StoredGeneration]
    ) -> None:
        """Appends to a run's course; a number that is there already is replaced."""
        with self._writing():
            self._connection.executemany(
                "INSERT OR REPLACE INTO generations VALUES (?, ?, ?, ?)",
                [(run, g.number, float(g.best), float(g.median)) for g in generations],
            )

    def add_checkpoint(
        self,
        run: int,
        content: bytes,
        generation: int = 0,
        cameras: Sequence[Camera] | None = None,
    ) -> None:
        """Keeps the newest state of a run in place of the one before.

        Args:
            run: The run.
            content: The state of the search.
            generation: How far it is.
            cameras: The best so far.
        """
        with self._writing():
            self._connection.execute(
                "INSERT OR REPLACE INTO checkpoints VALUES (?, ?, ?, ?, ?)",
                (run, now_utc(), generation, self._cameras_text(cameras), content),
            )

    def end_run(
        self,
        run: int,
        cameras: Sequence[Camera],
        cost: float | None,
        *,
        start_cost: float | None = None,
        outcome: str = "",
        figures: object = None,
    ) -> None:
        """Ends a run with its answer; its checkpoint is not needed any more.

        Args:
            run: The run.
            cameras: The answer.
            cost: Cost of the answer, None where it was not measured.
            start_cost: The same of the start.
            outcome: How it ended, in words.
            figures: A dataclass or a mapping of whatever else was measured.
        """
        with self._writing():
            self._connection.execute(
                "UPDATE runs SET ended_utc = ?, cameras = ?, cost = ?, start_cost = ?, "
                "outcome = ?, figures = ? WHERE id = ?",
                (
                    now_utc(),
                    self._cameras_text(cameras),
                    cost,
                    start_cost,
                    outcome,
                    json.dumps(_plain(figures if figures is not None else {})),
                    run,
                ),
            )
            self._connection.execute("DELETE FROM checkpoints WHERE run = ?", (run,))

    def remove_run(self, run: int) -> None:
        """Forgets a run and all that belongs to it."""
        with self._writing():
            self._connection.execute("DELETE FROM runs WHERE id = ?", (run,))

    def all(self) -> list[StoredRun]:
        """All runs, the oldest first."""
        return self._select("ORDER BY runs.id")

    def run(self, number: int) -> StoredRun:
        """One run.

        Raises:
            InputError: if there is none of that number.
        """
        for run in self._select("WHERE runs.id = ?", number):
            return run
        raise InputError(f"There is no run {number} in this project.")

    def unfinished_run(self) -> StoredRun | None:
        """The newest run if it has not ended: it runs, or was cut short."""
        newest = self._select("ORDER BY runs.id DESC LIMIT 1")
        return newest[0] if newest and newest[0].ended_utc is None else None

    def generations(self, run: int) -> list[StoredGeneration]:
        """A run's course."""
        with self._access():
            rows = self._connection.execute(
                "SELECT number, best, median FROM generations WHERE run = ? "
                "ORDER BY number",
                (run,),
            ).fetchall()
            return [
                _checked(StoredGeneration, number=number, best=best, median=median)
                for number, best, median in rows
            ]

    def checkpoint(self, run: int) -> StoredCheckpoint | None:
        """The newest checkpoint of a run that has not ended; None if it has none."""
        with self._access():
            row = self._connection.execute(
                "SELECT generation, cameras, content FROM checkpoints WHERE run = ?",
                (run,),
            ).fetchone()
            if row is None:
                return None
            return _checked(
                StoredCheckpoint,
                generation=row[0],
                cameras=self._cameras(row[1]),
                content=row[2],
            )

    def _select(self, clause: str, *arguments: object) -> list[StoredRun]:
        # The clause is one of those above, never anybody's text.
        with self._access():
            return [self._run(row) for row in self._rows(clause, arguments)]

    def _rows(self, clause: str, arguments: tuple[object, ...]) -> list[Any]:
        return self._connection.execute(
            "SELECT runs.id, started_utc, ended_utc, settings, seed, photo_names, start, "
            "coalesce(runs.cameras, checkpoints.cameras), start_cost, cost, outcome, "
            "figures, (SELECT count(*) FROM generations WHERE run = runs.id) "
            "FROM runs LEFT JOIN checkpoints ON run = runs.id " + clause,
            arguments,
        ).fetchall()

    def _run(self, row: tuple[Any, ...]) -> StoredRun:
        start = self._cameras(row[6])
        assert start is not None
        return _checked(
            StoredRun,
            id=row[0],
            started_utc=row[1],
            ended_utc=row[2],
            settings=json.loads(row[3]),
            seed=row[4],
            photo_names=tuple(json.loads(row[5])),
            start=start,
            cameras=self._cameras(row[7]),
            start_cost=row[8],
            cost=row[9],
            outcome=row[10],
            figures=json.loads(row[11]),
            n_generations=row[12],
        )

    def _cameras_text(self, cameras: Sequence[Camera] | None) -> str | None:
        return None if cameras is None else self._values.text_of(tuple(cameras))

    def _cameras(self, text: str | None) -> Cameras | None:
        return None if text is None else self._values.value_of(text, Cameras, "cameras")


def _checked(kind: type[T], **content: Any) -> T:
    check_fields(kind, content)
    return kind(**content)


def _plain(value: object) -> Any:
    """A value as JSON can hold it."""
    match value:
        case np.generic():
            return value.item()
        case None | bool() | int() | float() | str():
            return value
        case Mapping():
            return {str(key): _plain(item) for key, item in value.items()}
        case np.ndarray():
            return value.tolist()
        case tuple() | list() | set() | frozenset():
            return [_plain(item) for item in value]
    if dataclasses.is_dataclass(value):
        return {
            field.name: _plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
        }
    return str(value)
