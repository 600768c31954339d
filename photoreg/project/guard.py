"""Checks made before a project's database is used: it is untrusted input.

SQLite runs what a schema contains: views, triggers, expressions of generated columns. So
the schema must be exactly the one that this program makes, and the pages must be intact.
"""

import contextlib
import re
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from photoreg.errors import InputError
from photoreg.limits import Limits, variable
from photoreg.project.folder import DATABASE, DATABASE_COMPANIONS, is_file, look

HEADER = b"SQLite format 3\0"
WAL = 2
"""Byte 18 of a database that has a write-ahead log."""

MAX_ROWS = {
    "parts": 2_000_000,
    "files": 200_000,
    "steps": 1_000_000,
    "settings": 10_000,
    "runs": 100_000,
    "generations": 20_000_000,
    "checkpoints": 100_000,
    "own": 200_000,
}
"""Rows of each table; years of work stay far below."""

DAMAGE = (
    sqlite3.Error,
    zlib.error,
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)
"""What reading something damaged raises."""


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Whatever goes wrong within it raises an error of one sentence.

    Raises:
        InputError: if the database is damaged.
    """
    try:
        yield
    except MemoryError as error:
        raise InputError(
            f"{path} cannot be read: it takes more memory than there is."
        ) from error
    except DAMAGE as error:
        raise InputError(
            f"{path} is damaged, so this cannot be read ({described(error)}). A copy from "
            "a backup is needed."
        ) from error


def described(error: Exception) -> str:
    """An error in a few words of one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text:.120}" if text else type(error).__name__


def check_files(folder: Path, limits: Limits) -> None:
    """Checks the files before SQLite opens them: it follows links and waits at pipes.

    Raises:
        InputError: if one is not a regular file, or too large.
        sqlite3.DatabaseError: if it is no database.
    """
    for name in (DATABASE, *DATABASE_COMPANIONS):
        path = folder / name
        found = look(path)
        if found is None:
            continue
        if not is_file(found):
            raise InputError(
                f"{path} is not a regular file (a link, a folder, a pipe?), so this is "
                "not opened as a project; nothing was changed."
            )
        if found.st_size > limits.project_bytes:
            raise InputError(
                f"{path} has {found.st_size / 1e6:.0f} MB; up to {limits.project_mb:g} MB "
                f"are opened. If you trust it, set {variable('project_mb')} higher."
            )
    found = look(folder / DATABASE)
    if found is not None and 0 < found.st_size < 512:
        # SQLite would take it for an empty one and write over it.
        raise sqlite3.DatabaseError("it is too short")


def harden(connection: sqlite3.Connection, limits: Limits) -> None:
    """Makes SQLite wary of what it reads."""
    # The schema runs no functions.
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    connection.execute("PRAGMA mmap_size = 0")
    longest = min(limits.project_bytes, 1_000_000_000)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, longest)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 1)


def check_schema(
    connection: sqlite3.Connection, path: Path, migrations: Sequence[str]
) -> None:
    """Checks that the tables are exactly those that this program makes.

    Args:
        connection: The open database.
        path: Its file.
        migrations: What leads to its version from an empty one.

    Raises:
        InputError: if there are others, views, triggers or indices besides, or they
            have other columns.
    """
    with contextlib.closing(sqlite3.connect(":memory:")) as model:
        for script in migrations:
            model.executescript(script)
        expected = _schema(model)
    found = _schema(connection)
    if found == expected:
        return
    wrong = sorted(found - expected) or sorted(expected - found)
    kind, name = wrong[0][:2]
    raise InputError(
        f"{path} is not as photoreg makes it: its {kind:.20} {name!r:.60} is foreign, "
        "changed or missing. So it is not opened; nothing was changed."
    )


def check_pages(connection: sqlite3.Connection) -> None:
    """Checks the whole file for damage (1 s a GB).

    Raises:
        sqlite3.DatabaseError: if there is any.
    """
    found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if found != "ok":
        raise sqlite3.DatabaseError(" ".join(str(found).split())[:200])


def check_rows(connection: sqlite3.Connection, path: Path) -> None:
    """Checks how many rows the tables have.

    Raises:
        InputError: if one has more than any work makes.
    """
    for table, most in MAX_ROWS.items():
        if connection.execute(
            "SELECT 1 FROM sqlite_schema WHERE name = ?", (table,)
        ).fetchone():
            # Names of ours, nobody's text.
            count = connection.execute(
                f"SELECT count(*) FROM (SELECT 1 FROM {table} LIMIT {most + 1})"
            ).fetchone()[0]
            if count > most:
                raise InputError(
                    f"{path} has more than {most} rows of {table}, far more than "
                    "photoreg writes, so it is not opened."
                )


def _schema(connection: sqlite3.Connection) -> set[tuple[str, str, str, str]]:
    rows = connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_schema")
    return {
        (str(kind), str(name), str(table), _plain(sql))
        for kind, name, table, sql in rows.fetchmany(1000)
    }


def _plain(sql: object) -> str:
    """A statement without comments and layout, which may change between versions."""
    if sql is None:
        return ""
    return "".join(re.sub(r"--[^\n]*", "", str(sql)).split()).lower()
