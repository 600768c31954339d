"""What is in a project's folder, examined without following links.

A folder may hold other files beside the project, of any name and kind. Only regular files
at their own place are read or written here.
"""

import contextlib
import hashlib
import os
import stat
import uuid
from pathlib import Path

from photoreg.errors import OutputError
from photoreg.sources import open_for_reading, open_regular

DATABASE = "project.db"
DATABASE_COMPANIONS = tuple(f"{DATABASE}-{end}" for end in ("wal", "shm", "journal"))
"""Files that SQLite puts beside the database."""
LOCK = "project.lock"
KEPT = "files"
"""Folder, within a project, of the files that were uploaded."""
SUBFOLDER = "photoreg-project"
"""Name of the folder that is offered where a folder holds other things already."""

Identity = tuple[int, int]
"""Device and number of a file: the same under another name, another after a copy."""

MAKE_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL
"""How a file is opened that must not be there yet."""

_JUNCTION = 0xA0000003


class FolderInUseError(OutputError):
    """A folder that holds other things, in which no project is begun.

    Attributes:
        folder: The folder.
        suggestion: A folder in it that is free.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.suggestion = free_subfolder(folder)
        super().__init__(
            f"{folder} is not an empty folder, and a project is begun only in a new or "
            "an empty one, so that nothing of yours is touched. A free one would be "
            f"{self.suggestion}."
        )


def look(path: Path | str) -> os.stat_result | None:
    """What is at ``path``, a link as a link; None: nothing."""
    try:
        return os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None


def is_folder(found: os.stat_result | None) -> bool:
    """Whether that is a folder, and no link to one."""
    return (
        found is not None
        and stat.S_ISDIR(found.st_mode)
        and getattr(found, "st_reparse_tag", 0) != _JUNCTION
    )


def is_file(found: os.stat_result | None) -> bool:
    """Whether that is a regular file, and no link to one."""
    return found is not None and stat.S_ISREG(found.st_mode)


def identity(found: os.stat_result) -> Identity:
    """Which file that is, whatever its name."""
    return found.st_dev, found.st_ino


def has_content(path: Path, size: int, sha256: str) -> os.stat_result | None:
    """The regular file at ``path`` if its content is that; None otherwise."""
    found = look(path)
    if found is None or not is_file(found) or found.st_size != size:
        return None
    try:
        with open_for_reading(path, follow_link=False) as file:
            if identity(os.fstat(file.fileno())) != identity(found):
                return None
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
    return found if digest == sha256 else None


def partial_name() -> str:
    """A name that nobody else gives a file, for one that is being written."""
    return f".photoreg-{uuid.uuid4().hex}.part"


def write_new(path: Path, content: bytes, partial: Path) -> None:
    """Writes a file that is not there yet: whole or not at all, and over nothing.

    Args:
        path: Where it goes.
        content: What it holds.
        partial: Where it grows, in the same folder; it is gone afterwards.

    Raises:
        FileExistsError: if something is at ``path``.
        OSError: if it cannot be written.
    """
    handle = open_regular(partial, MAKE_NEW, follow_link=False)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        _put(partial, path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()
    _sync_folder(path.parent)


def _put(partial: Path, path: Path) -> None:
    """Gives a file its name, unless something has that name."""
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:
        # A file system without hard links: the name is taken first, then filled.
        os.close(open_regular(path, MAKE_NEW, follow_link=False))
        partial.replace(path)


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":
        with contextlib.suppress(OSError):
            handle = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)


def holds_project(folder: Path) -> bool:
    """Whether a project was begun there, as far as a look tells."""
    found = look(folder / DATABASE)
    return found is not None and not (is_file(found) and found.st_size == 0)


def is_free(folder: Path) -> bool:
    """Whether a project may be begun there: nothing is, or an empty folder.

    What the making of a project leaves that was killed at once does not count.
    """
    found = look(folder)
    if found is None:
        return True
    if not folder.is_dir():
        return False
    leftovers = {LOCK, DATABASE, *DATABASE_COMPANIONS}
    with os.scandir(folder) as entries:
        return not holds_project(folder) and all(
            entry.name in leftovers and is_file(entry.stat(follow_symlinks=False))
            for entry in entries
        )


def check_is_free(folder: Path) -> None:
    """Makes sure that a project may be begun in a folder.

    Raises:
        FolderInUseError: if something is there.
        OutputError: if it is no folder, or cannot be looked into.
    """
    try:
        if look(folder) is not None and not folder.is_dir():
            raise OutputError(f"{folder} is not a folder. Choose another name.")
        free = is_free(folder)
    except OSError as error:
        raise OutputError(
            f"{folder} cannot be looked into: {error.strerror or error}. Choose another "
            "folder."
        ) from error
    if not free:
        raise FolderInUseError(folder)


def free_subfolder(folder: Path) -> Path:
    """A folder in ``folder`` that is not there yet."""
    path, number = folder / SUBFOLDER, 2
    while look(path) is not None:
        path = folder / f"{SUBFOLDER}-{number}"
        number += 1
    return path
