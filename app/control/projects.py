"""Which project is open: new ones, other ones, saved under another name. No viser."""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from app.control import user_data
from app.control.autosave import DOCUMENT_TYPES, PATIENCE_S, RUNS_TYPE, Autosave
from app.control.project_reading import ProjectReader, check_document
from app.model.run import Run
from app.model.scene_files import first_names
from app.model.session import Session, setting
from app.model.state import Document, Job, WaitingProject
from photoreg.errors import InputError, OutputError, PhotoregError, RefinementError
from photoreg.project.check import CheckedProject
from photoreg.project.files import FileProblem
from photoreg.project.folder import KEPT, check_is_free, holds_project
from photoreg.project.project import Project
from photoreg.sources import SourceFile

log = logging.getLogger(__name__)

NOT_KEPT = "Your work is not being kept."
OLD_COPY = "Brought up to date; as it was before, it is kept as %s."
MAX_NAMED = 3
"""How many files are named that are not the project's."""


Read = Callable[[Path, Callable[[str], None], Mapping[str, SourceFile]], CheckedProject]
"""Reads a project, see `ProjectReader.read`."""


class Projects:
    """The open project and the ways to another one. Safe to use from any thread.

    Args:
        session: What is on screen.
        read: Reads an untrusted project before it is opened; None: in a separate process.
    """

    def __init__(
        self,
        session: Session,
        read: Read | None = None,
    ) -> None:
        self._session = session
        self._reader = ProjectReader()
        self._read = read or self._reader.read
        self.current: Project | None = None
        self._pending: Project | None = None
        """What ``State.waiting`` tells of."""
        self._autosave: Autosave | None = None
        self._log: logging.Handler | None = None
        self._access = threading.Lock()

    # Opening.

    def new(self, document: Document | None = None, folder: Path | None = None) -> None:
        """Opens a new project.

        Args:
            document: What it begins with; None: empty.
            folder: Where it goes; None: into the user's data folder.

        Raises:
            InputError: if the folder holds a project already.
            OutputError: if it cannot be made; `FolderInUseError` if other things are in
                the folder.
        """
        document = document if document is not None else Document()
        with self._changing("Making a project"):
            is_asked_for = folder is not None
            if folder is None:
                remove_untouched()
                folder = user_data.free_folder(document)
            if holds_project(folder):
                raise InputError(
                    f"{folder} holds a project already. Open it, or choose another "
                    "folder."
                )
            project = Project(folder, DOCUMENT_TYPES)
            if not is_asked_for:
                with (
                    contextlib.suppress(OSError),
                    (folder / user_data.MADE_HERE).open("x") as mark,
                ):
                    mark.write(user_data.MADE_HERE_TEXT)
            self._take(
                Autosave(self._session, project), lambda: self._session.begin(document)
            )

    def begin_unkept(self, document: Document) -> None:
        """Begins with a document that is not saved, and says so on the page."""
        self._session.begin(document)
        self._session.change(None, setting(saving=NOT_KEPT))

    def open(self, folder: Path | str) -> WaitingProject | None:
        """Opens an existing project, or asks first about files that are not as they were.

        Returns:
            What it asks about; None: it is open.

        Raises:
            InputError: if there is none or it cannot be read.
        """
        folder = Path(folder).expanduser().absolute()
        if self.current is not None and folder == self.current.folder:
            raise InputError(f"{folder.name} is open already.")
        title = f"Opening {folder.name}"
        with self._changing(title, can_stop=True) as show:
            self._drop_pending()
            checked = self._read(folder, lambda part: show(f"{title}: {part}"), {})
            show(title)
            project = Project(
                folder, DOCUMENT_TYPES, create=False, loaded=checked.loaded
            )
            try:
                if checked.problems:
                    self._pending = project
                    return self._ask(project, checked.problems)
                document = _read(project)
                self._take_up(project)
                del document
            finally:
                if project not in (self._pending, self.current):
                    project.close()
        return None

    def locate(self, problem: FileProblem, path: Path | str, changed: bool) -> None:
        """Says where a file of the pending project is now; opens it with the last.

        Other files that are missing are looked for in the same folder.

        Args:
            problem: One of those that ``State.waiting`` tells of.
            path: Where it is; a folder: in it, under its old name.
            changed: Take it although its content is another.

        Raises:
            InputError: if that cannot be used; nothing has changed.
        """
        path = self.found_at(problem, path)
        project = self._waiting()
        title = f"Opening {project.folder.name}"
        with self._changing(title, can_stop=True) as show:
            with project.writing():
                project.files.use(problem.key, path, changed)
                for other in project.file_problems():
                    beside = path.parent / other.path.name
                    with contextlib.suppress(InputError):
                        project.files.use(other.key, beside)
                problems = project.file_problems()
                document = None if problems else self._read_moved(project, show)
                show(title)
            if problems:
                self._ask(project, problems)
            else:
                self._take_up(project)
                self._pending = None
                self._session.change(None, setting(waiting=None))
            del document

    def _read_moved(
        self, project: Project, show: Callable[[str], None]
    ) -> Document | None:
        """The document of a project whose files were found, read like any other first."""
        files = {key: project.files.find(key) for key in project.files}
        title = f"Opening {project.folder.name}"
        checked = self._read(
            project.folder, lambda part: show(f"{title}: {part}"), files
        )
        project.take(checked.loaded)
        return _read(project)

    def locate_upload(self, problem: FileProblem, name: str, content: bytes) -> Path:
        """Keeps a file that somebody brings for one that is missing; returns its path."""
        if not name.lower().endswith(problem.path.suffix.lower()):
            raise InputError(
                f"{name} cannot be {problem.path.name}: its suffix is another."
            )
        return self._waiting().keep_file(name, content)

    def is_same(self, problem: FileProblem, path: Path | str) -> bool:
        """Whether a file has the content that the pending project knows.

        Raises:
            InputError: if it cannot be read.
        """
        return self._waiting().files.is_same(problem.key, self.found_at(problem, path))

    def found_at(self, problem: FileProblem, path: Path | str) -> Path:
        """The file that somebody means by a path: within a folder the one of that name."""
        path = Path(path).expanduser()
        if not path.is_absolute():
            raise InputError("Type the whole path, from the root of the disk.")
        return path / problem.path.name if path.is_dir() else path

    def stop_opening(self) -> bool:
        """Ends the reading of a project; returns whether one was being read."""
        return self._reader.cancel()

    def cancel(self) -> None:
        """Leaves the pending project as it is."""
        with self._changing("Closing"):
            self._drop_pending()

    def save_as(self, folder: Path | str, gather: bool = False) -> None:
        """Copies the project into a new folder and goes on there.

        Args:
            folder: Where it goes.
            gather: Copy the files into it, too, that lie outside of the project.

        Raises:
            OutputError: if the folder is not empty or cannot be written.
        """
        folder = Path(folder).expanduser().absolute()
        with self._changing(f"Saving as {folder.name}"):
            check_is_free(folder)
            # What could not be kept in the old place is written to the new one.
            self.wait()
            old, was_kept = self._autosave, self.current is not None
            missing: list[Path] = []

            def copy() -> Project:
                if self.current is not None:
                    missing.extend(self.current.save_as(folder))
                return Project(folder, DOCUMENT_TYPES)

            autosave = (
                Autosave(self._session, copy()) if old is None else old.copy(copy)
            )
            self._take(autosave, None)
            if gather or not was_kept:
                # Files that are kept nowhere would go when the program ends.
                autosave.project.gather()
            if missing:
                self._tell(
                    f"Saved, but for {_names(missing)}: not there to be copied any "
                    "more. When the copy is opened again, it asks for them."
                )

    def keep_file(self, name: str, content: bytes) -> Path | None:
        """Keeps an uploaded file in the open project; None: there is none."""
        return None if self.current is None else self.current.keep_file(name, content)

    def wait(self, timeout_s: float = PATIENCE_S) -> bool:
        """Waits until what has changed is on disk; returns whether it soon was.

        What is not kept at all, which the state says, is not waited for.
        """
        autosave = self._autosave
        return (
            autosave is None
            or autosave.wait(timeout_s)
            or bool(self._session.state.saving)
        )

    def close(self) -> None:
        """Keeps what is left and closes the project."""
        self._reader.close()
        self._drop_pending()
        self._let_go(None)

    @contextlib.contextmanager
    def _changing(
        self, title: str, can_stop: bool = False
    ) -> Iterator[Callable[[str], None]]:
        """One change of project at a time, while nothing else goes on, and shown.

        Yields:
            What shows another title, of a job that cannot be stopped any more if it is
            the first one again.
        """
        if not self._access.acquire(blocking=False):
            raise RefinementError("Another project is just being opened. Wait for it.")
        job = Job(title, can_stop=can_stop)

        def show(what: str) -> None:
            nonlocal job
            job = Job(what, can_stop=what != title)
            self._session.change(None, setting(job=job))

        try:
            with self._session.lock:
                state = self._session.state
                if state.run.is_active or state.job is not None:
                    raise RefinementError(
                        "Something is still going on in this project. Stop it or wait "
                        "for its end, then open another."
                    )
                self._session.change(None, setting(job=job))
            yield show
        finally:
            if self._session.state.job is job:
                self._session.change(None, setting(job=None))
            self._access.release()

    def _take_up(self, project: Project) -> None:
        autosave = Autosave(self._session, project)
        show = autosave.take_up()
        self._take(autosave, show or (lambda: self._session.begin(Document())))

    def _take(self, autosave: Autosave, show: Callable[[], None] | None) -> None:
        """Puts a project in place of the open one; None: and keeps what is on screen."""
        project = autosave.project

        def follow() -> None:
            if show is not None:
                show()
            note = "" if show is None else self._session.state.note
            if project.old_copy is not None:
                note = OLD_COPY % project.old_copy.name
            place = {"project": project.folder, "read_only": project.read_only}
            self._session.change(
                None, setting(**place, saving=project.read_only, note=note)
            )

        try:
            self._let_go(follow, by_copy=show is None)
            self.current = project
        finally:
            if project is not self.current:
                project.close()
        if not project.read_only:
            try:
                project.collect_garbage()
            except (PhotoregError, ValueError) as error:
                log.warning("%s was not tidied up: %s", project.folder, error)
            if project.foreign:
                self._tell(
                    f"In {project.folder.name}/{KEPT}: {_names(project.foreign)}. "
                    "photoreg does not know that it made that, so it stays."
                )
            self._autosave = autosave
            autosave.start()
            autosave.wait()
            self._log = user_data.log_into(project.folder)
        user_data.remember(project.folder)

    def _tell(self, sentence: str) -> None:
        log.warning("%s", sentence)
        note = " ".join(filter(None, (self._session.state.note, sentence)))
        self._session.change(None, setting(note=note))

    def _let_go(self, then: Callable[[], None] | None, by_copy: bool = False) -> None:
        if self._autosave is not None:
            # What goes on in a copy is written there, even if it cannot be here.
            self._autosave.close(None if by_copy else then)
            self._autosave = None
            if by_copy and then is not None:
                then()
        elif then is not None:
            then()
        if self._log is not None:
            logging.getLogger().removeHandler(self._log)
            self._log.close()
            self._log = None
        project, self.current = self.current, None
        if project is not None:
            _leave(project)

    def _ask(self, project: Project, problems: Sequence[FileProblem]) -> WaitingProject:
        waiting = WaitingProject(project.folder.name, tuple(problems))
        self._session.change(None, setting(waiting=waiting))
        return waiting

    def _drop_pending(self) -> None:
        if self._pending is not None:
            self._pending.close()
            self._pending = None
            self._session.change(None, setting(waiting=None))

    def _waiting(self) -> Project:
        if self._pending is None:
            raise InputError("There is no project that waits for this.")
        if self._pending.read_only:
            raise OutputError(self._pending.read_only)
        return self._pending


def remove_untouched() -> None:
    """Removes projects that nobody asked for or worked in, left by a program killed."""
    for mark in sorted(user_data.projects_folder().glob(f"*/{user_data.MADE_HERE}")):
        try:
            project = Project(mark.parent, DOCUMENT_TYPES, create=False)
        except PhotoregError as error:
            log.warning("%s", error)
        else:
            _leave(project)


def _leave(project: Project) -> None:
    """Closes a project; removes one that nobody asked for and nobody worked in."""
    mark = project.folder / user_data.MADE_HERE
    is_ours = mark.exists() and not project.read_only
    try:
        untouched = is_ours and _is_untouched(project)
    except PhotoregError:
        untouched = False
    if untouched:
        if not project.remove((user_data.MADE_HERE, *user_data.LOG_FILES)):
            log.warning("%s holds other files, so it stays.", project.folder)
        return
    project.close()
    if is_ours:
        with contextlib.suppress(OSError):
            mark.unlink()


def _names(paths: Sequence[Path]) -> str:
    return first_names((path.name for path in paths), MAX_NAMED)


def _is_untouched(project: Project) -> bool:
    runs = project.read_setting("runs", (), RUNS_TYPE)
    run = project.read_setting("run", Run(), Run)
    return project.is_untouched and not runs and run.status == "idle"


def _read(project: Project) -> Document | None:
    """The document in force; while somebody holds it, it is not read again.

    Raises:
        InputError: if a photo is not of the size of its camera any more.
    """
    first, steps, now = project.read_history(n_back=0, kind=Document)
    if not steps:
        return None
    document = steps[now - first].document
    check_document(document)
    return document
