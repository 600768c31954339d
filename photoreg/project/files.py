"""The files of a project: what was uploaded, and what lies elsewhere."""

import contextlib
import dataclasses
import hashlib
import re
import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

from photoreg.errors import InputError, OutputError
from photoreg.limits import Limits, variable
from photoreg.names import path_of, stored_path
from photoreg.project.folder import KEPT, has_content, partial_name, write_new
from photoreg.sources import SourceFile, source_file

MAX_NAME_CHARACTERS = 150
"""Length of a file name that is kept; file systems end at 255 bytes."""


SHA256 = re.compile("[0-9a-f]{64}")


@dataclasses.dataclass(frozen=True)
class FileProblem:
    """A file that is not as it was when the project last used it."""

    key: str
    path: Path
    """Where it was."""
    kind: Literal["missing", "changed"]

    @property
    def sentence(self) -> str:
        """What is wrong, for the user."""
        if self.kind == "missing":
            return f"{self.path} is not there any more."
        return f"{self.path} is not the file it was: its content has changed."


class ProjectFiles:
    """The table of files. A path within the project's folder is kept relative to it."""

    def __init__(
        self,
        connection: sqlite3.Connection,
        folder: Path,
        limits: Limits | None = None,
    ) -> None:
        self._connection = connection
        self._limits = limits or Limits.of_environment()
        self._folder = folder.absolute()
        self._assumed: dict[str, SourceFile] = {}

    def assume(self, files: Mapping[str, SourceFile]) -> None:
        """Takes files, by key, for those of the project, without writing it down."""
        self._assumed = dict(files)

    def add(self, source: SourceFile) -> str:
        """Remembers a file; returns its key.

        A known one stays where it was found, but for a copy in the project itself.
        """
        self._connection.execute(
            "INSERT OR IGNORE INTO files VALUES (?, ?, ?, ?)",
            (source.sha256, self._stored_path(source.path), source.sha256, source.size),
        )
        if self._is_kept(source.path):
            self._connection.execute(
                "UPDATE files SET path = ? WHERE key = ? AND sha256 = key",
                (self._stored_path(source.path), source.sha256),
            )
        return source.sha256

    def find(self, key: str) -> SourceFile:
        """The file of a key, as it was last accepted.

        Raises:
            InputError: if the project does not know it, or knows nonsense of it.
        """
        if key in self._assumed:
            return self._assumed[key]
        row = self._connection.execute(
            "SELECT path, sha256, size FROM files WHERE key = ?", (key,)
        ).fetchone()
        if row is None:
            raise InputError(f"The project knows no file {key!s:.12}; it is damaged.")
        path, sha256, size = row
        if (
            not isinstance(path, str | bytes)
            or path_of(path).as_posix().count("\0")
            or not SHA256.fullmatch(str(sha256))
            or type(size) is not int
            or size < 0
        ):
            raise InputError(
                f"The project's database is damaged: what it knows of the file "
                f"{key!s:.12} is no path, SHA-256 and size."
            )
        return SourceFile(self._folder / path_of(path), sha256, size)

    def problem(self, key: str) -> FileProblem | None:
        """What is wrong with a file; reads all of it. None: nothing.

        Raises:
            InputError: if it is larger than files may be.
        """
        known = self.find(key)
        if known.size > self._limits.file_bytes:
            raise InputError(
                f"{known.path} has {known.size / 1e6:.0f} MB; up to "
                f"{self._limits.file_mb:g} MB are read. If you trust the project, set "
                f"{variable('file_mb')} higher."
            )
        try:
            same = (
                known.path.stat().st_size == known.size
                and source_file(known.path).sha256 == known.sha256
            )
        except OSError:
            return FileProblem(key, known.path, "missing")
        return None if same else FileProblem(key, known.path, "changed")

    def __iter__(self) -> Iterator[str]:
        """The keys of all files, in the order of their paths."""
        rows = self._connection.execute("SELECT key FROM files ORDER BY path")
        return iter([row[0] for row in rows])

    def is_same(self, key: str, path: Path) -> bool:
        """Whether what is at ``path`` is what the file of a key was.

        Raises:
            InputError: if it cannot be read.
        """
        return _fingerprint(path).sha256 == self.find(key).sha256

    def use(self, key: str, path: Path, even_changed: bool = False) -> None:
        """Takes ``path`` as the file of a key from now on.

        Args:
            key: The file.
            path: Where it is now.
            even_changed: Take it even though its content is another.

        Raises:
            InputError: if it cannot be read, or is another and that was not allowed.
        """
        now, known = _fingerprint(path), self.find(key)
        if now.sha256 != known.sha256 and not even_changed:
            raise InputError(
                f"{path} is not the same file as {known.path.name} was: its content "
                "differs. To use it all the same, choose the changed file."
            )
        self._connection.execute(
            "UPDATE files SET path = ?, sha256 = ?, size = ? WHERE key = ?",
            (self._stored_path(now.path), now.sha256, now.size, key),
        )

    def place(self, key: str, path: Path) -> None:
        """Says where the file of a key is, whose content is known to be the same."""
        self._connection.execute(
            "UPDATE files SET path = ? WHERE key = ?", (self._stored_path(path), key)
        )

    def forget(self, needed: set[str]) -> None:
        """Forgets all files but those of the keys ``needed``."""
        self._connection.executemany(
            "DELETE FROM files WHERE key = ?",
            [(key,) for key in self if key not in needed],
        )

    def paths(self) -> list[Path]:
        """Where all files are."""
        return [self.find(key).path for key in self]

    def is_kept(self, key: str) -> bool:
        """Whether a file lies among those that the project itself holds."""
        return self._is_kept(self.find(key).path)

    def _is_kept(self, path: Path) -> bool:
        return path.is_relative_to(self._folder / KEPT)

    def _stored_path(self, path: Path) -> str | bytes:
        with contextlib.suppress(ValueError):
            path = path.relative_to(self._folder)
        return stored_path(path)


def _fingerprint(path: Path) -> SourceFile:
    try:
        return source_file(path)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read: {error.strerror or error}. Check the path."
        ) from error


def plain_name(name: str, fallback: str = "file") -> str:
    """The last part of a name that a browser sent, safe as a file name anywhere.

    No folder, no control characters, none that Windows refuses, no leading dot, and
    not too long; spaces, quotes that are allowed, and Unicode stay.
    """
    plain = name.replace("\\", "/").rpartition("/")[2]
    plain = "".join("_" if ord(c) < 32 or c in '<>:"|?*\x7f' else c for c in plain)
    plain = plain.encode("utf-8", "replace").decode()
    plain = plain.strip().strip(".").strip()
    stem, dot, suffix = plain.rpartition(".")
    if not dot:
        stem, suffix = suffix, ""
    while len(stem.encode()) > MAX_NAME_CHARACTERS:
        stem = stem[:-1]
    return (stem + dot + suffix[:20]) or fallback


def keep_file(folder: Path, name: str, content: bytes) -> Path:
    """Writes a file under its own name into a folder that is no project's.

    If another one has that name already, it goes into a numbered folder beside it; what
    is there with the same content is not written again, and nothing is written over.

    Raises:
        OutputError: if it cannot be written.
    """
    plain = Path(plain_name(name))
    sha256, number = hashlib.sha256(content).hexdigest(), 1
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / plain
        while not has_content(path, len(content), sha256):
            path.parent.mkdir(exist_ok=True)
            try:
                write_new(path, content, path.with_name(partial_name()))
            except FileExistsError:
                number += 1
                path = folder / str(number) / plain
    except OSError as error:
        raise OutputError(
            f"{plain} could not be kept in {folder}: {error.strerror or error}."
        ) from error
    return path
