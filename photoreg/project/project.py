"""A project: a folder that keeps all work as it happens, whatever becomes of the program.

`project.db` (SQLite) holds the document after every step, the runs, and choices of the
page; `files/` what was uploaded. Files opened from disk stay where they are, and are
remembered by path and SHA-256. One program writes a project at a time; a second one
opens it to look. It is begun in a folder of its own, and what others put there later is
neither changed nor removed.
"""

import contextlib
import ctypes
import dataclasses
import os
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from photoreg.errors import InputError, OutputError, PhotoregError
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.limits import Limits
from photoreg.project.files import FileProblem, ProjectFiles
from photoreg.project.folder import (
    DATABASE,
    DATABASE_COMPANIONS,
    KEPT,
    LOCK,
    Identity,
    check_is_free,
    holds_project,
    identity,
    is_folder,
    look,
)
from photoreg.project.guard import HEADER, WAL, check_files, harden, reading
from photoreg.project.lock import FolderLock, is_on_network
from photoreg.project.own_files import OwnFiles
from photoreg.project.runs import ProjectRuns
from photoreg.project.schema import now_utc, prepare, transaction, why
from photoreg.project.types import check_value
from photoreg.project.values import FromFile, Loaded, Values
from photoreg.sources import open_for_reading, read_regular

MAX_CHECKED_BYTES = 64 << 20
"""Databases up to this size are checked for damage when opened (0.1 s)."""


@dataclasses.dataclass(frozen=True)
class StoredStep:
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
        look_only: Only look: nothing is written, locked or brought up to date, and
            the database is checked for damage whatever its size.
        limits: How large it and its files may be; None: as the environment says.
        loaded: Meshes and photos that need not be read from their files again.

    Raises:
        InputError: if there is no project, or one that cannot be opened, is damaged or
            not as photoreg makes it.
        OutputError: if it cannot be made there; `FolderInUseError` if the folder holds
            other things.
    """

    def __init__(
        self,
        folder: Path | str,
        types: Iterable[type] = (),
        create: bool = True,
        *,
        look_only: bool = False,
        limits: Limits | None = None,
        loaded: Loaded | None = None,
    ) -> None:
        folder = Path(folder).absolute()
        # Where a link leads may change while the project is open.
        self.folder = Path(os.path.realpath(folder)) if folder.is_symlink() else folder
        self.path = self.folder / DATABASE
        self._types = (*types, Camera, Mesh, Photo)
        self._looks_only = look_only
        self._limits = limits or Limits.of_environment()
        self._is_new = not holds_project(self.folder)
        if self._is_new and (look_only or not create):
            if not self.folder.exists():
                raise InputError(f"There is no folder {self.folder}. Check its name.")
            raise InputError(
                f"{self.folder} holds no project: there is no {DATABASE} in it."
            )
        made = False
        if self._is_new:
            check_is_free(self.folder)
            made = self._make_folder()
        self._lock = FolderLock(self.folder)
        self.read_only = ""
        """Why nothing can be written, in one sentence; empty where all can."""
        if look_only:
            self.read_only = f"{self.folder} is only looked at."
        try:
            taken = not look_only and self._lock.take()
        except OSError as error:
            if self._is_new:
                raise self._not_made(error) from error
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
            self._open(loaded)
        except BaseException:
            self._lock.release()
            raise
        if made:
            self._own.note_folder()

    def _make_folder(self) -> bool:
        """Whether it was not there."""
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            return False
        except OSError as error:
            raise self._not_made(error) from error
        return True

    def _not_made(self, error: OSError) -> OutputError:
        return OutputError(
            f"No project can be made in {self.folder}: {error.strerror or error}. "
            "Choose another folder."
        )

    def _open(self, loaded: Loaded | None) -> None:
        connection = None
        try:
            check_files(self.folder, self._limits)
            connection = sqlite3.connect(
                f"{self.path.as_uri()}?mode={self._mode()}",
                uri=True,
                check_same_thread=False,
                isolation_level=None,
                timeout=10.0,
            )
            harden(connection, self._limits)
            connection.execute("PRAGMA foreign_keys = ON")
            # Each commit reaches the disk: killed at any moment, or cut from power, the
            # last state that was reported as kept is there.
            connection.execute("PRAGMA synchronous = FULL")
            is_small = self.path.stat().st_size <= MAX_CHECKED_BYTES
            self.old_copy = prepare(
                connection,
                self.path,
                not self.read_only,
                self._may_begin,
                check_all=is_small or self._looks_only,
                look_only=self._looks_only,
            )
            if not self.read_only:
                # The WAL's index is shared memory, which does not work between machines.
                mode = "DELETE" if is_on_network(self.folder) else "WAL"
                connection.execute(f"PRAGMA journal_mode = {mode}")
            version = connection.execute("PRAGMA data_version").fetchone()
        except BaseException as error:
            if connection is not None:
                connection.close()
            if isinstance(error, PhotoregError) or not isinstance(error, Exception):
                raise
            raise InputError(
                f"{self.path} cannot be opened as a project ({' '.join(str(error).split()):.200}). If it "
                "is damaged, a copy from a backup is needed; nothing was changed."
            ) from error
        self._connection = connection
        self._data_version = version
        self.foreign: tuple[Path, ...] = ()
        """What lies among the uploaded files and is not the project's; it stays."""
        self._places: dict[Path, Identity] = {}
        self._is_networked = is_on_network(self.folder)
        self._note_places()
        self.files = ProjectFiles(connection, self.folder, self._limits)
        self._own = OwnFiles(connection, self.folder, self.writing)
        self._values = Values(
            connection,
            self._types,
            {
                Photo: FromFile(load_photo, ("pixels",)),
                Mesh: FromFile(load_mesh, ("vertices", "faces", "corner_uv")),
            },
            self.files.find,
            self.files.add,
            self._limits,
            loaded,
        )
        self.runs = ProjectRuns(connection, self._values, self._reading, self.writing)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        with self._access, reading(self.path):
            yield

    @property
    def _may_begin(self) -> bool:
        names = {DATABASE, LOCK, *DATABASE_COMPANIONS}
        return {entry.name for entry in os.scandir(self.folder)} <= names

    def _mode(self) -> str:
        """How SQLite opens the database."""
        if not self.read_only:
            return "rwc"
        log = look(self.path.with_name(f"{DATABASE}-wal"))
        with contextlib.suppress(OSError):
            with open_for_reading(self.path, follow_link=False) as file:
                head = file.read(100)
            if head[: len(HEADER)] != HEADER:
                raise sqlite3.DatabaseError("it is no database")
            journal = look(self.path.with_name(f"{DATABASE}-journal"))
            if self._looks_only and journal is not None and journal.st_size > 0:
                return "rw"  # A write was cut short: what was half written goes.
            if self._looks_only and log is None and head[18] == WAL:
                return "ro&immutable=1"  # Nobody has it open, and no log is made.
        if log is None and not os.access(self.folder, os.W_OK):
            # SQLite wants to make its log even for reading.
            return "ro&immutable=1"
        return "ro"

    def close(self) -> None:
        """Ends the use of the project; others may write it from now on."""
        with self._access:
            self._close_database()
            self._lock.release()

    def _close_database(self) -> None:
        if self._moved() in (self.folder, self.path):
            # At its end SQLite removes its log by name. That name is somebody else's
            # now, so this connection has no end.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._connection))
            return
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()

    def remove(self, also: Iterable[str] = ()) -> bool:
        """Closes a project that nobody has worked in, and removes what it made.

        Whatever else lies in its folder stays, and then so does the folder.

        Args:
            also: Names of files in the folder that belong to it, too.

        Returns:
            Whether the folder has gone; it stays, untouched, if it was not made here.
        """
        with self._access:
            if self.read_only or self._moved() or not self._own.made_folder:
                self.close()
                return False
            self._own.remove()
            self._close_database()
            for name in (*also, DATABASE, *DATABASE_COMPANIONS):
                with contextlib.suppress(OSError):
                    (self.folder / name).unlink()
            self._lock.remove()
            with contextlib.suppress(OSError):
                self.folder.rmdir()  # Only where nothing is left in it.
            return look(self.folder) is None

    # Whether it is still there.

    def check_place(self) -> None:
        """Makes sure that what is written comes to where the project is.

        A folder that was renamed or removed would still take it, out of sight.

        Raises:
            OutputError: if its folder or its files are not those that were opened, or
                another program may write them.
        """
        moved = self._moved()
        if moved is not None:
            raise OutputError(
                f"Your work is not being kept: {moved} was removed, renamed or replaced "
                "while it was open. Put it back, and it is kept again; or save as "
                "another project (tab 1)."
            )
        if not self.read_only and not self._lock.is_held():
            raise OutputError(
                f"Your work is not being kept: {self.folder / LOCK} was replaced, so "
                "another photoreg may have this project open. Close it there and remove "
                "that file; or save as another project (tab 1)."
            )

    def _moved(self) -> Path | None:
        """What is not at its place any more, the folder first; None: all is."""
        for path, known in self._places.items():
            found = look(path)
            # Network file systems may number a file anew; there it must be there.
            if found is None or not (self._is_networked or identity(found) == known):
                return path
        return None

    def _note_places(self) -> None:
        """Remembers which files are open, as soon as SQLite has made them."""
        if not self.read_only:
            for path in (self.folder, self.path, Path(f"{self.path}-wal")):
                found = None if path in self._places else look(path)
                if found is not None:
                    self._places[path] = identity(found)

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Makes the writes within it one: all are kept, or none.

        Raises:
            OutputError: if the project is read-only, is not where it was, was written by
                another program, or the disk refuses.
        """
        if self.read_only:
            raise OutputError(self.read_only)
        with self._access:
            outermost = not self._connection.in_transaction
            if outermost:
                self.check_place()
            try:
                with transaction(self._connection):
                    if outermost:
                        self._check_alone()
                    yield
            except BaseException as error:
                if outermost:
                    self._values.forget()
                if isinstance(error, sqlite3.Error):
                    raise OutputError(
                        f"The work could not be kept in {self.folder}: {why(error)}"
                    ) from error
                raise
            if outermost:
                self._note_places()

    def _check_alone(self) -> None:
        """Whatever happened to the locks, what another program wrote is not overwritten."""
        version = self._connection.execute("PRAGMA data_version").fetchone()
        if version != self._data_version:
            raise OutputError(
                f"Your work is not being kept: another program has written in "
                f"{self.path} since it was opened here. Open the project again to see "
                "its work, or save yours as another project (tab 1)."
            )

    # The document and its history.

    def write_history(self, after: int, steps: Sequence[StoredStep], now: int) -> None:
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

    def read_history(
        self, n_back: int = 200, kind: Any = Any
    ) -> tuple[int, list[StoredStep], int]:
        """The history around the document in force.

        Steps that cannot be read any more, because a file of theirs is gone, and what
        lies beyond them, are left out; they stay in the project.

        Args:
            n_back: How many steps back at most.
            kind: The type of the documents.

        Returns:
            Position of the first step returned, the steps, and the position of the
            document in force. No steps: the project is empty.

        Raises:
            InputError: if the document in force cannot be read.
        """
        with self._reading(), self._values.one_reading():
            now = self._position()
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
            steps = [self._read_step(rows[here], kind)]
            first = here
            while first > 0 and (step := self._step(rows[first - 1], kind)) is not None:
                steps.insert(0, step)
                first -= 1
            for row in rows[here + 1 :]:
                step = self._step(row, kind)
                if step is None:
                    break
                steps.append(step)
            return rows[first][0], steps, now

    def _step(self, row: tuple[Any, ...], kind: Any) -> StoredStep | None:
        try:
            return self._read_step(row, kind)
        except InputError:
            return None

    def _read_step(self, row: tuple[Any, ...], kind: Any) -> StoredStep:
        check_value(row[1], str | None, "the name of a step")
        return StoredStep(row[1], self._values.value_of(row[2], kind, "a document"))

    def _position(self) -> int:
        return self._get("position", 0, int)

    def take(self, loaded: Loaded) -> None:
        """Takes meshes and photos that need not be read from their files again."""
        self._values.take(loaded)

    def file_problems(self) -> list[FileProblem]:
        """The files of the document in force that are missing or changed.

        Reads all of them. They must be located, or the change accepted, by
        `files.use` before the history can be read.
        """
        with self._reading():
            row = self._connection.execute(
                "SELECT document FROM steps WHERE position = ?", (self._position(),)
            ).fetchone()
            keys = self._values.needs(row[0])[1] if row is not None else ()
            found = [self.files.problem(key) for key in sorted(keys)]
            return [problem for problem in found if problem is not None]

    @property
    def is_untouched(self) -> bool:
        """Whether nothing was done since it was made: one step, no file, no run."""
        with self._reading():
            counts = self._connection.execute(
                "SELECT (SELECT count(*) FROM steps), (SELECT count(*) FROM runs)"
            ).fetchone()
        kept = self.folder / KEPT
        found = look(kept)
        has_files = found is not None and not (
            is_folder(found) and not any(kept.iterdir())
        )
        return counts[0] <= 1 and counts[1] == 0 and not has_files

    # Choices.

    def write_settings(self, settings: Mapping[str, object]) -> None:
        """Keeps values by name, like choices of the page."""
        with self.writing():
            for name, value in settings.items():
                self._put(name, value)

    def read_setting(self, name: str, default: Any = None, kind: Any = Any) -> Any:
        """A value by name.

        Args:
            name: Its name.
            default: What it is where it was never written.
            kind: The type that it should be of.

        Raises:
            InputError: if it is damaged or of another type.
        """
        with self._reading():
            return self._get(name, default, kind)

    def _put(self, name: str, value: object) -> None:
        self._connection.execute(
            "INSERT OR REPLACE INTO settings VALUES (?, ?)",
            (name, self._values.text_of(value)),
        )

    def _get(self, name: str, default: Any, kind: Any) -> Any:
        row = self._connection.execute(
            "SELECT value FROM settings WHERE name = ?", (name,)
        ).fetchone()
        if row is None:
            return default
        return self._values.value_of(row[0], kind, f"the value {name!r}")

    # Files.

    def keep_file(self, name: str, content: bytes) -> Path:
        """Keeps an uploaded file in the project; returns its path.

        Raises:
            OutputError: if it cannot be written.
        """
        if self.read_only:
            raise OutputError(self.read_only)
        with self._access:
            self.check_place()
            return self._own.keep(name, content)

    def gather(self) -> None:
        """Copies all files into the project, so that it can be taken along.

        Raises:
            InputError: if one is missing or has changed; none is copied then.
            OutputError: if they cannot be written.
        """
        with self._reading():
            away = [key for key in self.files if not self.files.is_kept(key)]
            for key in away:
                problem = self.files.problem(key)
                if problem is not None:
                    raise InputError(
                        f"{problem.sentence} So no copy of it can be made."
                    )
            for key in away:
                path = self.files.find(key).path
                kept = self.keep_file(path.name, read_regular(path))
                with self.writing():
                    self.files.use(key, kept)

    def save_as(self, folder: Path | str) -> list[Path]:
        """Copies the project, with the files that it holds, into a new folder.

        What else lies in its folder is not copied.

        Returns:
            Files of it that are not there, so that they could not be copied.

        Raises:
            OutputError: if the folder is not empty or cannot be written.
        """
        folder = Path(folder).absolute()
        check_is_free(folder)
        made = look(folder) is None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with self._access:
                self._connection.execute("VACUUM INTO ?", (str(folder / DATABASE),))
                return self._copy_files(folder, made)
        except (OSError, sqlite3.Error, OutputError) as error:
            for name in (DATABASE, *DATABASE_COMPANIONS):
                with contextlib.suppress(OSError):
                    (folder / name).unlink()
            with contextlib.suppress(OSError):
                if made:
                    folder.rmdir()
            raise OutputError(f"Cannot save as {folder}: {error}.") from error

    def _copy_files(self, folder: Path, made: bool) -> list[Path]:
        """Copies the files of the project to a copy of its database."""
        with contextlib.ExitStack() as end:
            copy = sqlite3.connect(folder / DATABASE, isolation_level=None)
            end.callback(copy.close)
            own = OwnFiles(copy, folder, lambda: transaction(copy))
            theirs, missing = ProjectFiles(copy, folder), []
            copy.execute("DELETE FROM own")
            if made:
                own.note_folder()
            end.callback(own.remove)
            places = {key: self.files.find(key).path for key in self.files}
            kept = {key for key in places if self.files.is_kept(key)}
            copied: dict[Path, Path] = {}
            for path in sorted({*self._own.files(), *(places[key] for key in kept)}):
                try:
                    copied[path] = own.keep(path.name, self._read_kept(path))
                except OSError:
                    missing.append(path)
            for key, path in places.items():
                # What lies beside the project's own files is not the project's.
                theirs.place(key, copied.get(path, path))
            end.pop_all()
            copy.close()
        return missing

    def _read_kept(self, path: Path) -> bytes:
        """An uploaded file, even if the folder has been renamed meanwhile."""
        handle = self._lock.open_inside(path.relative_to(self.folder))
        if handle is None:
            return read_regular(path, follow_link=False)
        with os.fdopen(handle, "rb") as file:
            return file.read()

    def collect_garbage(self) -> int:
        """Removes parts and uploads that no step, setting or run needs.

        Returns:
            How many parts.

        Raises:
            OutputError: if the disk refuses.
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
        try:
            with self._reading():
                self.check_place()
                self.foreign = tuple(self._own.sweep(self.files.paths()))
        except OSError as error:
            raise OutputError(f"{self.folder} cannot be tidied up: {error}.") from error
        return len(unused)
