"""Projects are read in a separate process before the app opens them.

A database, and the photos and meshes it names, are untrusted input. They can crash, fill
or stall only that process, which Cancel ends.
"""

import contextlib
import dataclasses
import logging
import multiprocessing
import os
import threading
import traceback
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from app.control.autosave import DOCUMENT_TYPES, RUNS_TYPE, TEXTURE_TYPE
from app.engine.spawn import PATIENCE_S, spawned
from app.model.masks import check_mask
from app.model.messages import Failed
from app.model.run import Run
from app.model.state import Document
from photoreg.errors import InputError, PhotoregError
from photoreg.project.check import CheckedProject, check_project
from photoreg.sources import SourceFile

log = logging.getLogger(__name__)

PATIENCE_PART_S = 300.0
"""How long one part of a project may take: its database, its files, its history."""

UNUSED_BYTES = 4 << 30
"""Address space that libraries take and do not use."""

Event = str | Failed | CheckedProject


class ProjectReader:
    """Reads one project at a time; safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: BaseProcess | None = None
        self._ended = False

    def read(
        self,
        folder: Path,
        on_part: Callable[[str], None] = lambda _: None,
        files: Mapping[str, SourceFile] | None = None,
    ) -> CheckedProject:
        """Reads a project; returns what of it needs not be read again.

        Args:
            folder: The project's folder.
            on_part: Told what is read next.
            files: Files of the project, by key, that are elsewhere than it knows.

        Raises:
            InputError: if it cannot be opened, takes too long or was cancelled.
        """
        try:
            with self._lock:
                if self._ended:
                    raise _cancelled(folder)
                process, connection = spawned(_serve, folder, files)
                self._process = process
        except OSError as error:
            raise InputError(
                f"{folder.name} could not be opened: no process could be started to read "
                f"it ({error.strerror or error}). Close other programs and try again."
            ) from error
        try:
            return self._follow(folder, connection, on_part)
        finally:
            self.cancel()
            connection.close()

    def cancel(self) -> bool:
        """Ends the reading, whatever it is about; returns whether there was one."""
        with self._lock:
            process, self._process = self._process, None
        if process is None:
            return False
        process.kill()
        process.join(timeout=PATIENCE_S)
        return True

    def close(self) -> None:
        """Ends the reading; none begins any more."""
        with self._lock:
            self._ended = True
        self.cancel()

    def _follow(
        self, folder: Path, connection: Connection, on_part: Callable[[str], None]
    ) -> CheckedProject:
        part = "its database"
        while True:
            try:
                if not connection.poll(PATIENCE_PART_S):
                    raise InputError(
                        f"{folder.name} was not opened: reading {part} took more than "
                        f"{PATIENCE_PART_S:.0f} s."
                    )
                event: Event = connection.recv()
            except (EOFError, OSError) as error:
                if self._process is None:
                    raise _cancelled(folder) from error
                raise InputError(
                    f"{folder.name} was not opened: reading {part} was cut short; a "
                    "decoder failed, or there is too little memory."
                ) from error
            match event:
                case str():
                    part = event
                    on_part(part)
                case Failed():
                    if event.details:
                        log.error("%s\n%s", event.message, event.details)
                    raise InputError(event.message)
                case _:
                    return event


def check_document(document: Document) -> None:
    """Checks what belongs together in a document.

    Raises:
        InputError: if a photo is not of the size of its camera any more, or a mask not
            of that of its photo.
    """
    for entry in document.photos:
        camera, photo = entry.camera, entry.photo
        if (camera.width, camera.height) != (photo.width, photo.height):
            raise InputError(
                f"{entry.name} is {photo.width}x{photo.height} px now, but was "
                f"{camera.width}x{camera.height} px when its camera was placed. "
                "Use a file of that size."
            )
        if entry.mask_png is not None:
            check_mask(entry.mask_png, photo.width, photo.height)


def read_all(
    folder: Path,
    on_part: Callable[[str], None],
    files: Mapping[str, SourceFile] | None = None,
) -> CheckedProject:
    """Reads all that the app reads when it opens a project, in this process.

    Raises:
        InputError: if it cannot be opened.
    """
    checked = check_project(
        folder,
        DOCUMENT_TYPES,
        Document,
        {"run": Run, "runs": RUNS_TYPE, "texture": TEXTURE_TYPE},
        files=files,
        on_part=on_part,
    )
    for step in checked.steps:
        check_document(step.document)
    return checked


def _serve(
    connection: Connection, folder: Path, files: Mapping[str, SourceFile] | None
) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _limit_memory()
    event: Event
    try:
        # What it consists of is decoded again there; photos and meshes are not.
        event = dataclasses.replace(read_all(folder, connection.send, files), steps=())
    except PhotoregError as error:
        event = Failed("read", " ".join(str(error).split()))
    except MemoryError:
        event = Failed("read", f"{folder.name} takes more memory than there is.")
    except Exception as error:  # noqa: BLE001 - the border of the process: report.
        event = Failed(
            "read",
            f"{folder.name} cannot be opened: reading it failed "
            f"({type(error).__name__}).",
            traceback.format_exc(),
        )
    with contextlib.suppress(OSError):  # The app is gone.
        connection.send(event)


def _end_with_parent() -> None:
    """However the app ends: killed, it cannot end this process."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _limit_memory() -> None:
    """No more than the machine has: rather an error here than a machine that swaps."""
    try:
        import resource  # noqa: PLC0415 - Windows has no such limits.

        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        most = memory + UNUSED_BYTES
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        if hard != resource.RLIM_INFINITY:
            most = min(most, hard)
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    except (ImportError, OSError, ValueError):
        return  # Only Linux tells.


def _cancelled(folder: Path) -> InputError:
    return InputError(f"Opening {folder.name} was cancelled.")
