"""Which project is open: new ones, recent ones, saved under another name. No viser."""

import contextlib
import datetime
import json
import logging
import logging.handlers
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from app.autosave import DOCUMENT_TYPES, Autosave
from app.session import Session, setting
from app.state import Document
from photoreg.errors import InputError, OutputError, RefinementError
from photoreg.project import DATABASE, Project
from photoreg.project_files import FileProblem, plain_name

log = logging.getLogger(__name__)

MAX_RECENT = 12
LOG_FILE = "photoreg.log"
LOG_BYTES, LOG_COPIES = 1 << 20, 3


def data_folder() -> Path:
    """Where projects go that were given no folder: the user's own, by platform.

    The environment variable PHOTOREG_DATA names another.
    """
    given = os.environ.get("PHOTOREG_DATA")
    if given:
        return Path(given)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    else:
        base = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(base) / "photoreg"


class Projects:
    """The open project and the ways to another one."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.current: Project | None = None
        self.pending: Project | None = None
        """A project that waits until its files are found; see ``problems``."""
        self.problems: list[FileProblem] = []
        self.on_change: Callable[[], None] = lambda: None
        self._autosave: Autosave | None = None
        self._log: logging.Handler | None = None
        self._made_here: Path | None = None

    # Opening.

    def new(self, document: Document | None = None, folder: Path | None = None) -> None:
        """Opens a new project.

        Args:
            document: What it begins with; None: empty.
            folder: Where it goes; None: into the user's data folder.

        Raises:
            InputError: if the folder holds a project already.
            OutputError: if it cannot be made.
        """
        self._must_be_idle()
        document = document if document is not None else Document()
        made_here = folder is None
        folder = free_folder(document) if folder is None else Path(folder)
        if (folder / DATABASE).exists():
            raise InputError(
                f"{folder} holds a project already. Open it, or choose another folder."
            )
        project = Project(folder, DOCUMENT_TYPES)
        self._let_go()
        self._session.begin(document)
        self._made_here = project.folder if made_here else None
        self._hold(project, Autosave(self._session, project))

    def begin_unkept(self, document: Document) -> None:
        """Begins with a document that is kept nowhere, and says so on the page."""
        self._let_go()
        self._session.begin(document)
        self._session.change(None, setting(saving="Your work is not being kept."))

    def open(self, folder: Path | str) -> None:
        """Opens an existing project, or asks first about files that are not as they were.

        Raises:
            InputError: if there is none or it cannot be read.
        """
        self._must_be_idle()
        folder = Path(folder).expanduser().absolute()
        if self.current is not None and folder == self.current.folder:
            raise InputError(f"{folder.name} is open already.")
        self._drop_pending()
        project = Project(folder, DOCUMENT_TYPES, create=False)
        try:
            problems = project.file_problems()
            if problems:
                self.pending, self.problems = project, problems
                self.on_change()
                return
            self._take(project)
        except BaseException:
            if self.pending is None:
                project.close()
            raise

    def locate(self, problem: FileProblem, path: Path | str, changed: bool) -> None:
        """Says where a file of the pending project is now; opens it with the last.

        Args:
            problem: Which of ``problems``.
            path: Where it is.
            changed: Take it although its content is another.

        Raises:
            InputError: if that cannot be used.
        """
        project = self.pending
        if project is None:
            raise InputError("There is no project that waits for this.")
        if project.read_only:
            raise OutputError(project.read_only)
        with project.writing():
            project.files.use(problem.key, Path(path).expanduser(), changed)
        self.problems = project.file_problems()
        if not self.problems:
            self.pending = None
            try:
                self._take(project)
            except BaseException:
                self.pending = project
                self.on_change()
                raise
        self.on_change()

    def cancel(self) -> None:
        """Leaves the pending project as it is."""
        self._drop_pending()
        self.on_change()

    def save_as(self, folder: Path | str) -> None:
        """Copies the project into a new folder and goes on there."""
        self._must_be_idle()
        if self.current is None:
            raise InputError("There is no project to save.")
        if not str(folder).strip():
            raise InputError("Name the folder that the project is to be saved in.")
        folder = Path(folder).expanduser().absolute()
        if self._autosave is not None and not self.current.read_only:
            self._autosave.wait()
        self.current.save_as(folder)
        self.open(folder)

    def wait(self) -> None:
        """Waits until what has changed is on disk."""
        if self._autosave is not None:
            self._autosave.wait()

    def close(self) -> None:
        """Keeps what is left and closes the project."""
        self._drop_pending()
        self._let_go()

    def recent(self) -> list[Path]:
        """Projects opened lately that are still there, the newest first."""
        return [folder for folder in _recent() if (folder / DATABASE).exists()]

    @property
    def is_read_only(self) -> bool:
        """Whether the open project may only be looked at."""
        return self.current is not None and bool(self.current.read_only)

    def _take(self, project: Project) -> None:
        autosave = Autosave(self._session, project)
        project.read_history()  # What cannot be read must not cost what is open.
        self._check_sizes(project)
        self._let_go()
        if not autosave.take_up():
            self._session.begin(Document())
        self._hold(project, autosave)

    def _check_sizes(self, project: Project) -> None:
        first, steps, now = project.read_history(n_back=0)
        if not steps:
            return
        for entry in steps[now - first].document.photos:
            camera, photo = entry.camera, entry.photo
            if (camera.width, camera.height) != (photo.width, photo.height):
                raise InputError(
                    f"{entry.name} is {photo.width}x{photo.height} px now, but was "
                    f"{camera.width}x{camera.height} px when its camera was placed. "
                    "Use a file of that size."
                )

    def _hold(self, project: Project, autosave: Autosave) -> None:
        self.current = project
        self._session.read_only = project.read_only
        if project.read_only:
            self._session.change(None, setting(saving=project.read_only))
        if not project.read_only:
            self._autosave = autosave
            autosave.start()
            autosave.wait()
            self._log = _log_into(project.folder / LOG_FILE)
        _remember(project.folder)
        self.on_change()

    def _let_go(self) -> None:
        if self._autosave is not None:
            self._autosave.close()
            self._autosave = None
        if self._log is not None:
            logging.getLogger().removeHandler(self._log)
            self._log.close()
            self._log = None
        project, self.current = self.current, None
        if project is not None:
            untouched = project.folder == self._made_here and project.is_untouched
            project.close()
            if untouched:
                # Nobody misses a project in which nothing was done.
                shutil.rmtree(project.folder, ignore_errors=True)
        self._made_here = None

    def _drop_pending(self) -> None:
        if self.pending is not None:
            self.pending.close()
        self.pending, self.problems = None, []

    def _must_be_idle(self) -> None:
        state = self._session.state
        if state.run.is_active or state.job is not None:
            raise RefinementError(
                "Something is still going on in this project. Stop it or wait for its "
                "end, then open another."
            )


def free_folder(document: Document) -> Path:
    """A folder that is not there yet, named after the day and the mesh."""
    stem = Path(document.mesh.name).stem if document.mesh is not None else "Project"
    name = plain_name(f"{datetime.date.today().isoformat()} {stem}", "Project")
    parent = data_folder() / "projects"
    folder, number = parent / name, 2
    while folder.exists():
        folder = parent / f"{name} {number}"
        number += 1
    return folder


def _log_into(path: Path) -> logging.Handler | None:
    """Warnings and errors into a file beside the project. No photo content gets there."""
    try:
        handler = logging.handlers.RotatingFileHandler(
            path, maxBytes=LOG_BYTES, backupCount=LOG_COPIES, encoding="utf-8"
        )
    except OSError:
        return None
    handler.setLevel(logging.WARNING)
    handler.setFormatter(
        logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
    )
    logging.getLogger().addHandler(handler)
    return handler


def _recent() -> list[Path]:
    try:
        listed = json.loads((data_folder() / "recent.json").read_text("utf-8"))
        return [Path(path) for path in listed if isinstance(path, str)]
    except (OSError, ValueError, TypeError):
        return []


def _remember(folder: Path) -> None:
    paths = [folder, *(path for path in _recent() if path != folder)]
    target = data_folder() / "recent.json"
    with contextlib.suppress(OSError):
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_suffix(".part")
        partial.write_text(
            json.dumps([str(path) for path in paths[:MAX_RECENT]], indent=1), "utf-8"
        )
        partial.replace(target)
