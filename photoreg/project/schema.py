"""The tables of a project's database, and how older ones are brought up to date."""

import contextlib
import datetime
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path

from photoreg.errors import InputError, OutputError
from photoreg.project.folder import look
from photoreg.project.guard import check_pages, check_rows, check_schema

APPLICATION_ID = 0x70687267
"""Marks the file as photoreg's ("phrg"), so that no foreign database is touched."""

MIGRATIONS: tuple[str, ...] = (
    """
    -- Values by the SHA-256 of their content: text of dataclasses, bytes of arrays.
    CREATE TABLE parts (hash TEXT PRIMARY KEY, content BLOB NOT NULL) WITHOUT ROWID;

    -- Files that values were read from. A path within the project is relative to it.
    CREATE TABLE files (
        key TEXT PRIMARY KEY, -- SHA-256 when it was first used; values name it
        path TEXT NOT NULL,
        sha256 TEXT NOT NULL, -- of the content that is in use now
        size INTEGER NOT NULL
    );

    -- The document after each step; undo and redo move along it.
    CREATE TABLE steps (
        position INTEGER PRIMARY KEY,
        name TEXT, -- of the step that led here; NULL for the first
        made_utc TEXT NOT NULL,
        document TEXT NOT NULL
    );

    -- Values by name: the position in the history, choices of the page, the run shown.
    CREATE TABLE settings (name TEXT PRIMARY KEY, value TEXT NOT NULL);

    CREATE TABLE runs (
        id INTEGER PRIMARY KEY,
        started_utc TEXT NOT NULL,
        ended_utc TEXT, -- NULL while it runs, and when it was cut short
        settings TEXT NOT NULL, -- JSON
        seed INTEGER,
        photo_names TEXT NOT NULL,
        start TEXT NOT NULL, -- cameras
        cameras TEXT, -- the answer
        start_cost REAL,
        cost REAL,
        outcome TEXT NOT NULL DEFAULT '',
        figures TEXT NOT NULL DEFAULT '{}' -- JSON: whatever else was measured
    );
    CREATE TABLE generations (
        run INTEGER NOT NULL REFERENCES runs ON DELETE CASCADE,
        number INTEGER NOT NULL,
        best REAL NOT NULL,
        median REAL NOT NULL,
        PRIMARY KEY (run, number)
    ) WITHOUT ROWID;
    -- The newest state of a run's search, from which it goes on; one a run.
    CREATE TABLE checkpoints (
        run INTEGER PRIMARY KEY REFERENCES runs ON DELETE CASCADE,
        made_utc TEXT NOT NULL,
        generation INTEGER NOT NULL,
        cameras TEXT, -- the best so far
        content BLOB NOT NULL
    );
    """,
    """
    -- What this program made within the folder, noted down before it was made: nothing
    -- else is ever removed. Of older projects that is not known, so what they hold stays.
    CREATE TABLE own (
        path TEXT PRIMARY KEY, -- relative; "." is the project's folder itself
        kind TEXT NOT NULL, -- folder, file, or part: a file that is being written
        sha256 TEXT, -- of a file
        size INTEGER
    ) WITHOUT ROWID;
    """,
    """
    -- Nothing is stored otherwise, but cameras may have lenses now, which a photoreg of
    -- before would pass over: it is to refuse the project instead.
    """,
)
"""What leads from each version to the next; the first makes an empty file version 1."""


def now_utc() -> str:
    """The time now, as ISO 8601 in UTC, to the second."""
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def prepare(
    connection: sqlite3.Connection,
    path: Path,
    may_write: bool,
    may_begin: bool,
    migrations: Sequence[str] = MIGRATIONS,
    *,
    check_all: bool = True,
    look_only: bool = False,
) -> Path | None:
    """Checks the database; makes the tables, or brings older ones up to date.

    Args:
        connection: The open database.
        path: Its file.
        may_write: Whether this program holds the project.
        may_begin: Whether nothing else is in the folder, so that a database that holds
            nothing is one whose making was cut short.
        migrations: What leads from each version to the next.
        check_all: Whether all of it is checked for damage.
        look_only: Whether an older version is left as it is.

    Returns:
        Where the copy of an older version was kept; None if there was none.

    Raises:
        InputError: if it is of a newer photoreg, not of photoreg at all, not as photoreg
            makes it, or older and held by another program.
        OutputError: if the copy cannot be kept.
        sqlite3.Error: if it is damaged.
    """
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    mark = connection.execute("PRAGMA application_id").fetchone()[0]
    n_tables = connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]
    newest = len(migrations)
    if mark != APPLICATION_ID and (n_tables > 0 or not may_begin):
        raise InputError(
            f"{path} is a database of another program, not a photoreg project."
        )
    if version > newest:
        raise InputError(
            f"{path.parent.name} was saved by a newer photoreg (project version "
            f"{version}; this one knows up to {newest}). Update photoreg to open it; "
            "nothing was changed."
        )
    if n_tables > 0 or version > 0:
        # Before anything else: a check of pages runs what the schema says.
        check_schema(connection, path, migrations[:version])
        if check_all:
            check_pages(connection)
        check_rows(connection, path)
    if version == newest or (look_only and version > 0):
        return None
    if not may_write:
        raise InputError(
            f"{path.parent.name} is of an older photoreg and must be brought up to date "
            "first, but another photoreg has it open. Close it there."
        )
    copy = None
    if version > 0:
        copy = path.with_name(f"{path.stem}-version-{version}.db")
        number = 2
        while look(copy) is not None:
            copy = path.with_name(f"{path.stem}-version-{version}-{number}.db")
            number += 1
        try:
            connection.execute("VACUUM INTO ?", (str(copy),))
        except sqlite3.Error as error:
            raise OutputError(
                f"No copy of {path} could be kept, so it was left as it is: "
                f"{why(error)}"
            ) from error
    with transaction(connection):
        for number in range(version, newest):
            for statement in _statements(migrations[number]):
                connection.execute(statement)
        connection.execute(f"PRAGMA user_version = {newest}")
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    return copy


def why(error: sqlite3.Error) -> str:
    """Why a write failed, and what to do, in words for the user."""
    match getattr(error, "sqlite_errorcode", 0) & 0xFF:
        case sqlite3.SQLITE_FULL:
            advice = "Is the disk full? Free some space."
        case sqlite3.SQLITE_BUSY | sqlite3.SQLITE_LOCKED:
            advice = "Another program has the database open and locked; close it there."
        case sqlite3.SQLITE_READONLY | sqlite3.SQLITE_CANTOPEN | sqlite3.SQLITE_PERM:
            advice = "May files in that folder be written?"
        case sqlite3.SQLITE_IOERR:
            advice = "The disk refuses; is it full, or gone?"
        case _:
            advice = "Save it as another project."
    return f"{error}. {advice}"


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """All or nothing; part of the transaction around it, if there is one."""
    if connection.in_transaction:
        yield
        return
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
    except BaseException:
        if connection.in_transaction:  # Some failures have ended it already.
            connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


def _statements(script: str) -> list[str]:
    """The statements of a script; `executescript` would end the transaction."""
    statements, pending = [], ""
    for line in script.splitlines(keepends=True):
        pending += line
        if sqlite3.complete_statement(pending):
            statements.append(pending)
            pending = ""
    return statements
