"""The files of a project: what was uploaded, what lies elsewhere, and who holds it."""

import contextlib
import dataclasses
import datetime
import os
import socket
import sqlite3
import sys
from pathlib import Path
from typing import IO, Literal

from photoreg.errors import InputError, OutputError
from photoreg.sources import SourceFile, source_file

KEPT = "files"
"""Folder, within a project, of the files that were uploaded."""

MAX_NAME_CHARACTERS = 150
"""Length of a file name that is kept; file systems end at 255 bytes."""


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

    def __init__(self, connection: sqlite3.Connection, folder: Path) -> None:
        self._connection = connection
        self._folder = folder.absolute()

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
            InputError: if the project does not know it.
        """
        row = self._connection.execute(
            "SELECT path, sha256, size FROM files WHERE key = ?", (key,)
        ).fetchone()
        if row is None:
            raise InputError(f"The project knows no file {key!s:.12}; it is damaged.")
        return SourceFile(self._folder / row[0], row[1], row[2])

    def problem(self, key: str) -> FileProblem | None:
        """What is wrong with a file; reads all of it. None: nothing."""
        known = self.find(key)
        try:
            same = (
                known.path.stat().st_size == known.size
                and source_file(known.path).sha256 == known.sha256
            )
        except OSError:
            return FileProblem(key, known.path, "missing")
        return None if same else FileProblem(key, known.path, "changed")

    def keys(self) -> list[str]:
        """All files, in the order of their paths."""
        rows = self._connection.execute("SELECT key FROM files ORDER BY path")
        return [row[0] for row in rows]

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

    def forget(self, needed: set[str]) -> None:
        """Forgets all files but those of the keys ``needed``."""
        self._connection.executemany(
            "DELETE FROM files WHERE key = ?",
            [(key,) for key in self.keys() if key not in needed],
        )

    def sweep(self) -> None:
        """Removes uploads that are not among the files; what lies elsewhere stays."""
        kept = self._folder / KEPT
        used = {self.find(key).path for key in self.keys()}
        for path in sorted(kept.rglob("*"), reverse=True):
            with contextlib.suppress(OSError):
                if path.is_dir():
                    path.rmdir()  # Only where nothing is left in it.
                elif path not in used:
                    path.unlink()

    def gather(self) -> None:
        """Copies all files into the project, so that it can be taken along.

        Raises:
            InputError: if one is missing or has changed; none is copied then.
            OutputError: if they cannot be written.
        """
        away = [key for key in self.keys() if not self._is_kept(self.find(key).path)]
        for key in away:
            problem = self.problem(key)
            if problem is not None:
                raise InputError(f"{problem.sentence} So no copy of it can be made.")
        for key in away:
            path = self.find(key).path
            self.use(key, keep_file(self._folder / KEPT, path.name, path.read_bytes()))

    def _is_kept(self, path: Path) -> bool:
        return path.is_relative_to(self._folder / KEPT)

    def _stored_path(self, path: Path) -> str:
        with contextlib.suppress(ValueError):
            path = path.relative_to(self._folder)
        return path.as_posix()


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
    """Writes a file under its own name; photos are told by it.

    If another one has that name already, it goes into a numbered folder beside it; what
    is there with the same content is not written again.

    Raises:
        OutputError: if it cannot be written.
    """
    plain = Path(plain_name(name))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path, number = folder / plain, 2
        while path.exists():
            if path.is_file() and path.read_bytes() == content:
                return path
            path = folder / str(number) / plain
            number += 1
        path.parent.mkdir(exist_ok=True)
        partial = path.with_name(path.name + ".part")
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise OutputError(
            f"{plain} could not be kept in {folder}: {error.strerror or error}."
        ) from error
    return path


class FolderLock:
    """Held by the one program that may write a project; ends with its process."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "project.lock"
        self._file: IO[str] | None = None

    def take(self) -> bool:
        """Tries to take it; returns whether that worked."""
        file = self._path.open("a+", encoding="utf-8")
        if not _lock(file):
            file.close()
            return False
        self._file = file
        file.seek(0)
        file.truncate()
        since = f"{datetime.datetime.now():%Y-%m-%d %H:%M}"
        file.write(f"process {os.getpid()} on {socket.gethostname()} since {since}\n")
        file.flush()
        return True

    @property
    def holder(self) -> str:
        """Who holds it, as far as is known."""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            return self._path.read_text(encoding="utf-8").strip()
        return ""

    def release(self) -> None:
        """Lets others have it. The file stays: removing it would let two in."""
        if self._file is not None:
            self._file.close()
            self._file = None


if sys.platform == "win32":
    import msvcrt

    def _lock(file: IO[str]) -> bool:
        # Far behind the text, which others may read.
        file.seek(1 << 30)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _lock(file: IO[str]) -> bool:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True


NETWORK_FILE_SYSTEMS = """
9p afpfs afs beegfs ceph cifs coda davfs fuse.ceph fuse.davfs2 fuse.glusterfs fuse.rclone
fuse.s3fs fuse.smbnetfs fuse.sshfs gfs2 glusterfs lustre ncpfs nfs nfs4 ocfs2 panfs smb2
smb3 smbfs vboxsf
"""


def is_on_network(folder: Path, mounts: Path = Path("/proc/self/mountinfo")) -> bool:
    """Whether other machines may have the folder too, as far as the system tells.

    Args:
        folder: The folder.
        mounts: Linux's list of what is mounted where.
    """
    resolved = folder.resolve()
    if sys.platform == "win32":
        import ctypes  # noqa: PLC0415

        remote = ctypes.windll.kernel32.GetDriveTypeW(resolved.anchor) == 4
        return remote or resolved.anchor.startswith("\\\\")
    try:
        lines = mounts.read_text("utf-8", "replace").splitlines()
    except OSError:
        return False
    kind, longest = "", -1
    for line in lines:
        before, _, after = line.partition(" - ")
        place = before.split()[4].encode().decode("unicode_escape")
        if resolved.is_relative_to(place) and len(place) >= longest:
            kind, longest = after.split()[0], len(place)
    return kind in NETWORK_FILE_SYSTEMS.split()
