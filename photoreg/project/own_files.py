"""The files that a project has made itself: the only ones that it ever removes.

Each is recorded, with its content's hash, before it is written. So what a killed process
leaves can be told apart from what somebody else put there, which stays whatever its name.
"""

import contextlib
import hashlib
import os
import re
import sqlite3
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from pathlib import Path, PurePosixPath
from typing import Literal

from photoreg.errors import OutputError
from photoreg.limits import Limits
from photoreg.project.files import plain_name
from photoreg.project.folder import (
    KEPT,
    Identity,
    has_content,
    identity,
    is_file,
    is_folder,
    look,
    partial_name,
    write_new,
)
from photoreg.project.types import check_value

OWN_PATH = re.compile(r"files(/[0-9]+)?(/(?!\.\.?$)[^/\\:\0]+)?")
"""Paths that are made here; a database from elsewhere may name others."""
PARTIAL = re.compile(r"\.photoreg-[0-9a-f]{32}\.part")

Kind = Literal["folder", "file", "part"]
_COLUMNS = (str, Kind, str | None, int | None)
Row = tuple[str, Kind, str | None, int | None]


class OwnFiles:
    """What this program made in a project's folder.

    Args:
        connection: The open database.
        folder: The project's folder.
        writing: What makes writes to the database one, and says when they fail.
    """

    def __init__(
        self,
        connection: sqlite3.Connection,
        folder: Path,
        writing: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self._connection = connection
        self._folder = folder
        self._writing = writing
        self._max_bytes = Limits.of_environment().file_bytes

    def keep(self, name: str, content: bytes) -> Path:
        """Writes a file under its own name, by which photos are identified.

        If another one has that name already, it goes into a numbered folder beside it;
        what is there with the same content is not written again. Not to be called
        within a transaction: the note must be on disk before the file is.

        Raises:
            OutputError: if it cannot be written.
        """
        assert not self._connection.in_transaction
        plain = plain_name(name)
        sha256, number = hashlib.sha256(content).hexdigest(), 0
        while True:
            number += 1
            inside = KEPT if number == 1 else f"{KEPT}/{number}"
            path = self._folder / inside / plain
            parent = look(path.parent)
            if parent is not None and not is_folder(parent):
                if number == 1:
                    raise OutputError(
                        f"{path.parent} should be a folder of the project's own and is "
                        "a link or a file, so nothing is written there. Move it away."
                    )
                continue
            if has_content(path, len(content), sha256):
                return path
            if parent is not None and not self._made(inside):
                continue  # Somebody else's: it could not be tidied up there.
            if look(path) is None and self._write(inside, path, content, sha256):
                return path

    def _write(self, inside: str, path: Path, content: bytes, sha256: str) -> bool:
        """Whether the file was written; not if somebody was quicker with a name."""
        relative, partial = f"{inside}/{path.name}", f"{inside}/{partial_name()}"
        folders = [
            folder
            for folder in dict.fromkeys((KEPT, inside))
            if look(self._folder / folder) is None
        ]
        with self._writing():
            for folder in folders:
                self._note((folder, "folder", None, None))
            self._note((partial, "part", None, None))
            self._note((relative, "file", sha256, len(content)))
        try:
            while folders:
                (self._folder / folders[0]).mkdir()
                del folders[0]
            write_new(path, content, self._folder / partial)
        except OSError as error:
            with contextlib.suppress(OutputError), self._writing():
                self._forget([partial, relative, *folders])
            if isinstance(error, FileExistsError):
                return False
            raise OutputError(
                f"{path.name} could not be kept in {path.parent}: "
                f"{error.strerror or error}."
            ) from error
        with self._writing():
            self._forget([partial])
        return True

    def files(self) -> list[Path]:
        """The files of its own that are there as they were written."""
        return [
            self._folder / relative
            for relative, kind, sha256, size in self._rows()
            if kind == "file" and self._is_same(relative, size, sha256)
        ]

    def note_folder(self) -> None:
        """Notes down that the project's folder itself was made here."""
        with self._writing():
            self._note((".", "folder", None, None))

    @property
    def made_folder(self) -> bool:
        """Whether the project's folder itself was made here."""
        return self._made(".")

    def sweep(self, used: Iterable[Path]) -> list[Path]:
        """Removes files of its own that are not used, and what a kill left of others.

        Args:
            used: Files that stay.

        Returns:
            What else lies among them that is not its own; it stays.
        """
        stay = {identity(found) for path in used if (found := _followed(path))}
        done = []
        for relative, kind, sha256, size in self._rows():
            path = self._folder / relative
            if kind == "folder" or not self._is_in_own_folder(relative):
                continue
            found = look(path)
            if found is not None and identity(found) in stay:
                continue
            if kind == "part":
                is_same = is_file(found) and PARTIAL.fullmatch(path.name)
            else:
                is_same = self._is_same(relative, size, sha256)
            if is_same:
                with contextlib.suppress(OSError):
                    path.unlink()
                if look(path) is not None:
                    continue
            # It is gone, or somebody has changed it: then it is theirs.
            done.append(relative)
        done += self._remove_folders(f"{KEPT}/")
        if done:
            with self._writing():
                self._forget(done)
        return self._foreign(stay)

    def remove(self) -> None:
        """Removes all of its own but the project's folder itself."""
        self.sweep(())
        self._remove_folders(KEPT)

    def _remove_folders(self, beginning: str) -> list[str]:
        gone = []
        for relative, kind, *_ in self._rows():
            if kind == "folder" and relative.startswith(beginning):
                path = self._folder / relative
                if self._is_in_own_folder(relative) and is_folder(look(path)):
                    with contextlib.suppress(OSError):
                        path.rmdir()
                if look(path) is None:
                    gone.append(relative)
        return gone

    def _foreign(self, stay: set[Identity]) -> list[Path]:
        own = {self._folder / row[0] for row in self._rows()}
        kept, found = self._folder / KEPT, []
        if look(kept) is not None and not is_folder(look(kept)):
            return [kept]
        for name, folders, files in os.walk(kept):
            here = Path(name)
            links = [each for each in folders if not is_folder(look(here / each))]
            for path in sorted(here / each for each in (*files, *links)):
                there = _followed(path)
                is_used = there is not None and identity(there) in stay
                if path not in own and not is_used:
                    found.append(path)
        return found

    def _is_in_own_folder(self, relative: str) -> bool:
        """Whether the folder of a path was made here, and no link leads along it."""
        inside = PurePosixPath(relative)
        return (relative == KEPT or self._made(str(inside.parent))) and all(
            is_folder(look(self._folder / p)) for p in inside.parents
        )

    def _made(self, path: str) -> bool:
        query = "SELECT 1 FROM own WHERE path = ? AND kind = 'folder'"
        return self._connection.execute(query, (path,)).fetchone() is not None

    def _is_same(self, relative: str, size: int | None, sha256: str | None) -> bool:
        """Whether a file is as it was written."""
        # None is written that is larger than any may be, so none such is read.
        size = size or 0
        path = self._folder / relative
        return size <= self._max_bytes and bool(has_content(path, size, sha256 or ""))

    def _rows(self) -> list[Row]:
        """What is noted of paths as they are made here, the folder itself apart."""
        rows = self._connection.execute(
            "SELECT path, kind, sha256, size FROM own ORDER BY path DESC"
        ).fetchall()
        for row in rows:
            for value, hint in zip(row, _COLUMNS, strict=True):
                check_value(value, hint, "a file that the project notes as its own")
        return [row for row in rows if OWN_PATH.fullmatch(row[0])]

    def _note(self, *rows: Row) -> None:
        self._connection.executemany(
            "INSERT OR REPLACE INTO own VALUES (?, ?, ?, ?)", rows
        )

    def _forget(self, paths: Iterable[str]) -> None:
        self._connection.executemany(
            "DELETE FROM own WHERE path = ?", [(path,) for path in paths]
        )


def _followed(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except OSError:
        return None
