"""Where projects are found: the user's own folder, those opened lately, the log."""

import contextlib
import datetime
import json
import logging
import logging.handlers
import os
import tempfile
from pathlib import Path
from typing import IO

from platformdirs import user_data_path

from app.model.state import Document
from photoreg.errors import InputError
from photoreg.project.files import plain_name
from photoreg.project.folder import DATABASE, identity, look
from photoreg.sources import open_regular, read_regular

MAX_RECENT = 12
LOG_FILE = "photoreg.log"
LOG_BYTES, LOG_COPIES = 1 << 20, 3

LOG_FILES = (LOG_FILE, *(f"{LOG_FILE}.{i + 1}" for i in range(LOG_COPIES)))

MADE_HERE = "made-by-photoreg.txt"
"""In a project that nobody asked for, until it is known that something was done in it."""
MADE_HERE_TEXT = (
    "photoreg made this folder by itself, and removes it if nothing is done in it.\n"
)


def data_folder() -> Path:
    """Where projects go that were given no folder: the user's own, by platform.

    The environment variable PHOTOREG_DATA names another.
    """
    given = os.environ.get("PHOTOREG_DATA")
    return Path(given) if given else user_data_path("photoreg", appauthor=False)


def projects_folder() -> Path:
    """Where projects go that were given a name only."""
    return data_folder() / "projects"


def folder_named(text: str) -> Path:
    """The folder that somebody typed: a path, or a name within the projects' folder.

    Raises:
        InputError: if nothing was typed.
    """
    text = text.strip()
    if not text:
        raise InputError("Type a name, or the path of a folder.")
    path = Path(text).expanduser()
    if path.is_absolute():
        return path
    if "/" in text or "\\" in text:
        raise InputError(
            f"{text} is part of a path. Type the whole path, or a name without slashes."
        )
    return projects_folder() / plain_name(text, "Project")


def free_folder(document: Document) -> Path:
    """A folder that is not there yet, named after the day and the mesh."""
    stem = Path(document.mesh.name).stem if document.mesh is not None else "Project"
    name = plain_name(f"{datetime.date.today().isoformat()} {stem}", "Project")
    folder, number = projects_folder() / name, 2
    while look(folder) is not None:
        folder = projects_folder() / f"{name} {number}"
        number += 1
    return folder


def recent() -> list[Path]:
    """Projects opened lately that are still there, the newest first."""
    return [folder for folder in _listed() if (folder / DATABASE).exists()]


def remember(folder: Path) -> None:
    """Puts a project first in the list of those opened lately."""
    paths = [folder, *(path for path in _listed() if path != folder)]
    target = data_folder() / "recent.json"
    with contextlib.suppress(OSError):
        target.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps([str(path) for path in paths[:MAX_RECENT]], indent=1)
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=target.parent, suffix=".part", delete=False
        ) as partial:
            partial.write(text)
        Path(partial.name).replace(target)


def _listed() -> list[Path]:
    try:
        listed = json.loads(read_regular(data_folder() / "recent.json"))
        return [Path(path) for path in listed if isinstance(path, str)]
    except (OSError, ValueError, TypeError):
        return []


class ProjectLog(logging.handlers.RotatingFileHandler):
    """A log that is written into a file of its own, never through a link.

    Where it cannot be written, the terminal is what has the details.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._known = folder, look(folder)
        super().__init__(
            folder / LOG_FILE,
            maxBytes=LOG_BYTES,
            backupCount=LOG_COPIES,
            encoding="utf-8",
            delay=True,
        )

    def emit(self, record: logging.LogRecord) -> None:
        """Writes it, unless another folder has come to the place of the project's."""
        now, known = look(self._folder), self._known
        if now is not None and known is not None and identity(now) == identity(known):
            super().emit(record)

    def _open(self) -> IO[str]:  # pyright: ignore[reportIncompatibleMethodOverride]
        found = look(self.baseFilename)
        if found is not None and found.st_nlink > 1:
            raise OSError(f"{self.baseFilename} has another name elsewhere")
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        return os.fdopen(
            open_regular(self.baseFilename, flags, follow_link=False),
            "a",
            encoding=self.encoding,
        )

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Does nothing: a failure to log cannot be logged."""


def log_into(folder: Path) -> logging.Handler:
    """Warnings and errors into files beside the project; old ones give way.

    Sentences and tracebacks go there, never pixels.
    """
    handler = ProjectLog(folder)
    handler.setLevel(logging.WARNING)
    handler.setFormatter(
        logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
    )
    logging.getLogger().addHandler(handler)
    return handler
