"""A project: a folder that keeps all work as it happens, whatever becomes of the program.

`project.db` (SQLite) holds the document after every step, the runs, and choices of the
page; `files/` what was uploaded. Files opened from disk stay where they are, and are
remembered by path and SHA-256. One program writes a project at a time; a second one
opens it to look.
"""

import contextlib
import dataclasses
import os
import shutil
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from photoreg.camera import Camera
from photoreg.errors import InputError, OutputError
from photoreg.mesh import Mesh, load_mesh
from photoreg.photo import Photo, load_photo
from photoreg.project_files import (
    KEPT,
    FileProblem,
    FolderLock,
    ProjectFiles,
    is_on_network,
    keep_file,
)
from photoreg.project_runs import ProjectRuns
from photoreg.project_schema import now_utc, prepare, transaction
from photoreg.project_values import FromFile, Values

DATABASE = "project.db"
MAX_CHECKED_BYTES = 64 << 20
"""Databases up to this size are checked for damage when opened (0.1 s)."""


@dataclasses.dataclass(frozen=True)
class Step:
    """The document after a step of the work."""

    name: str | None
    """Name of the step that led to it; None for the first."""
    document: Any


class Project:
    """An open project. Safe to use from any thread; what a call wrote is on disk.

    Args:
        folder: Its folder. It is made, and so is the project, if it is not there.
        types: The dataclasses that its documents consist of, besides the engine's.
        create: Whether a project that is not there is made.

    Raises:
        InputError: if there is no project, or one that cannot be opened.
        OutputError: if it cannot be made there.
    """

    def __init__(
        self, folder: Path | str, types: Iterable[type] = (), create: bool = True
    ) -> None:
        self.folder = Path(folder).absolute()
        self.path = self.folder / DATABASE
        self._types = (*types, Camera, Mesh, Photo)
        is_new = not self.path.exists()
        if is_new and not create:
            if not self.folder.exists():
                raise InputError(f"There is no folder {self.folder}. Check its name.")
            raise InputError(
                f"{self.folder} holds no project: there is no {DATABASE} in it."
            )
        self._lock = FolderLock(self.folder)
        self.read_only = ""
        """Why nothing can be written, in one sentence; empty where all can."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            taken = self._lock.take()
        except OSError as error:
            if is_new:
                raise OutputError(
                    f"No project can be made in {self.folder}: "
                    f"{error.strerror or error}. Choose another folder."
                ) from error
            taken = False
            self.read_only = (
                f"{self.folder} cannot be written ({error.strerror or error}), so it "
                "is open to look at only."
            )
        if not taken and not self.read_only:
            holder = self._lock.holder
            self.read_only = (
                f"{self.folder.name} is open in another photoreg"
                f"{f' ({holder})' if holder else ''}, so here it is open to look at "
                "only. Close it there, or save it as a project of its own."
            )
        self._access = threading.RLock()
        try:
            self._open()
        except BaseException:
            self._lock.release()
            raise

    def _open(self) -> None:
        mode = "ro" if self.read_only else "rwc"
        log = self.path.with_name(f"{DATABASE}-wal")
        if self.read_only and not log.exists() and not os.access(self.folder, os.W_OK):
            # SQLite wants to make its log even for reading.
            mode = "ro&immutable=1"
        connection = None
        try:
            if self.path.exists() and 0 < self.path.stat().st_size < 512:
                # SQLite would take it for an empty one and write over it.
                raise sqlite3.DatabaseError("it is too short")
            connection = sqlite3.connect(
                f"{self.path.as_uri()}?mode={mode}",
                uri=True,
                check_same_thread=False,
                isolation_level=None,
                timeout=10.0,
            )
            # A project may come from anybody; its schema runs no functions.
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA foreign_keys = ON")
            if not self.read_only:
                # The WAL's index is shared memory, which does not work between machines.
                mode = "DELETE" if is_on_network(self.folder) else "WAL"
                connection.execute(f"PRAGMA journal_mode = {mode}")
                # Each commit reaches the disk: killed at any moment, or cut from
                # power, the last state that was reported as kept is there.
                connection.execute("PRAGMA synchronous = FULL")
            self._check_damage(connection)
            self.old_copy = prepare(connection, self.path, not self.read_only)
        except (InputError, OutputError):
            if connection is not None:
                connection.close()
            raise
        except sqlite3.Error as error:
            if connection is not None:
                connection.close()
            raise InputError(
                f"{self.path} cannot be opened as a project ({error}). If it is "
                "damaged, a copy from a backup is needed; nothing was changed."
            ) from error
        self._connection = connection
        self.files = ProjectFiles(connection, self.folder)
        self._values = Values(
            connection,
            self._types,
            {
                Photo: FromFile(load_photo, ("pixels",)),
                Mesh: FromFile(load_mesh, ("vertices", "faces", "corner_uv")),
            },
            self.files.find,
            self.files.add,
        )
        self.runs = ProjectRuns(connection, self._values, self._access, self.writing)

    def _check_damage(self, connection: sqlite3.Connection) -> None:
        if self.path.stat().st_size <= MAX_CHECKED_BYTES:
            found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
            if found != "ok":
                raise sqlite3.DatabaseError(found)

    def close(self) -> None:
        """Ends the use of the project; others may write it from now on."""
        with self._access:
            with contextlib.suppress(sqlite3.Error):
                self._connection.close()
            self._lock.release()

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Makes the writes within it one: all are kept, or none.

        Raises:
            OutputError: if the project is read-only or the disk refuses.
        """
        if self.read_only:
            raise OutputError(self.read_only)
        with self._access:
            outermost = not self._connection.in_transaction
            try:
                with transaction(self._connection):
                    yield
            except BaseException as error:
                if outermost:
                    self._values.forget()
                if isinstance(error, sqlite3.Error):
                    raise OutputError(
                        f"The work could not be kept in {self.folder} ({error}). Is the "
                        "disk full?"
                    ) from error
                raise

    # The document and its history.

    def write_history(self, after: int, steps: Sequence[Step], now: int) -> None:
        """Replaces what follows a position of the history.

        Args:
            after: Steps up to this position stay; -1: none.
            steps: What follows them.
            now: Position of the document that is in force.
        """
        with self.writing():
            self._connection.execute("DELETE FROM steps WHERE position > ?", (after,))
            for position, step in enumerate(steps, start=after + 1):
                text = self._values.text_of(step.document)
                self._connection.execute(
                    "INSERT INTO steps VALUES (?, ?, ?, ?)",
                    (position, step.name, now_utc(), text),
                )
            self._put("position", now)

    def read_history(self, n_back: int = 200) -> tuple[int, list[Step], int]:
        """The history around the document in force.

        Steps that cannot be read any more, because a file of theirs is gone, and what
        lies beyond them, are left out; they stay in the project.

        Args:
            n_back: How many steps back at most.

        Returns:
            Position of the first step returned, the steps, and the position of the
            document in force. No steps: the project is empty.

        Raises:
            InputError: if the document in force cannot be read.
        """
        with self._access:
            now = self._get("position", 0)
            rows = self._connection.execute(
                "SELECT position, name, document FROM steps WHERE position >= ? "
                "ORDER BY position",
                (now - n_back,),
            ).fetchall()
            here = next((i for i, row in enumerate(rows) if row[0] == now), None)
            if here is None:
                if rows:
                    raise InputError(f"{self.path} is damaged: it lacks step {now}.")
                return 0, [], 0
            steps = [Step(rows[here][1], self._values.value_of(rows[here][2]))]
            first = here
            while first > 0 and (step := self._step(rows[first - 1])) is not None:
                steps.insert(0, step)
                first -= 1
            for row in rows[here + 1 :]:
                step = self._step(row)
                if step is None:
                    break
                steps.append(step)
            return rows[first][0], steps, now

    def _step(self, row: tuple[Any, ...]) -> Step | None:
        try:
            return Step(row[1], self._values.value_of(row[2]))
        except InputError:
            return None

    def file_problems(self) -> list[FileProblem]:
        """The files of the document in force that are missing or changed.

        Reads all of them. They must be located, or the change accepted, by
        `files.use` before the history can be read.
        """
        with self._access:
            row = self._connection.execute(
                "SELECT document FROM steps WHERE position = ?",
                (self._get("position", 0),),
            ).fetchone()
            keys = self._values.needs(row[0])[1] if row is not None else ()
            found = [self.files.problem(key) for key in sorted(keys)]
            return [problem for problem in found if problem is not None]

    @property
    def is_untouched(self) -> bool:
        """Whether nothing was done since it was made: one step, no file, no run."""
        with self._access:
            counts = self._connection.execute(
                "SELECT (SELECT count(*) FROM steps), (SELECT count(*) FROM runs)"
            ).fetchone()
        kept = self.folder / KEPT
        has_files = kept.is_dir() and any(kept.iterdir())
        return counts[0] <= 1 and counts[1] == 0 and not has_files

    # Choices.

    def write_settings(self, settings: Mapping[str, object]) -> None:
        """Keeps values by name, like choices of the page."""
        with self.writing():
            for name, value in settings.items():
                self._put(name, value)

    def read_setting(self, name: str, default: Any = None) -> Any:
        """A value by name."""
        with self._access:
            return self._get(name, default)

    def _put(self, name: str, value: object) -> None:
        self._connection.execute(
            "INSERT OR REPLACE INTO settings VALUES (?, ?)",
            (name, self._values.text_of(value)),
        )

    def _get(self, name: str, default: Any) -> Any:
        row = self._connection.execute(
            "SELECT value FROM settings WHERE name = ?", (name,)
        ).fetchone()
        return default if row is None else self._values.value_of(row[0])

    # Files.

    def keep_file(self, name: str, content: bytes) -> Path:
        """Keeps an uploaded file in the project; returns its path.

        Raises:
            OutputError: if it cannot be written.
        """
        if self.read_only:
            raise OutputError(self.read_only)
        with self._access:
            return keep_file(self.folder / KEPT, name, content)

    def save_as(self, folder: Path | str) -> None:
        """Copies the project, uploaded files included, into a new folder.

        Raises:
            OutputError: if the folder is not empty or cannot be written.
        """
        folder = Path(folder).absolute()
        check_is_free(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (self.folder / KEPT).is_dir():
                shutil.copytree(self.folder / KEPT, folder / KEPT)
            with self._access:
                self._connection.execute("VACUUM INTO ?", (str(folder / DATABASE),))
        except (OSError, sqlite3.Error) as error:
            raise OutputError(f"Cannot save as {folder}: {error}.") from error

    def collect_garbage(self) -> int:
        """Removes parts and uploads that no step, setting or run needs.

        Returns:
            How many parts.
        """
        with self.writing():
            texts = self._connection.execute(
                "SELECT document FROM steps UNION ALL SELECT value FROM settings "
                "UNION ALL SELECT start FROM runs UNION ALL SELECT cameras FROM runs "
                "UNION ALL SELECT cameras FROM checkpoints"
            )
            needed: set[str] = set()
            files: set[str] = set()
            for (text,) in texts.fetchall():
                if text is not None:
                    self._values.add_needs(text, needed, files)
            rows = self._connection.execute("SELECT hash FROM parts").fetchall()
            unused = [row for row in rows if row[0] not in needed]
            self._connection.executemany("DELETE FROM parts WHERE hash = ?", unused)
            self.files.forget(files)
            # The cache may name what has gone.
            self._values.forget()
        with self._access:
            self.files.sweep()
        return len(unused)


def check_is_free(folder: Path) -> None:
    """Raises OutputError unless nothing would be overwritten in ``folder``."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(
            f"{folder} is not an empty folder. Choose a new one, so that nothing is "
            "overwritten."
        )
