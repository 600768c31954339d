"""Files that browsers bring: kept, told apart by suffix, read, and opened together.

What came together is one undo step, or none where it is cancelled.
"""

import dataclasses
import itertools
import logging
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from app.engine.file_kinds import (
    CAMERAS,
    KINDS,
    MATERIAL,
    MESH,
    PHOTO,
    UNREAD,
    is_zip,
    kind_of,
)
from app.engine.read_job import Reader, ReadRequest, UnpackRequest
from app.model import reducers
from app.model.messages import (
    CamerasLoaded,
    Failed,
    Loaded,
    MeshLoaded,
    PhotoLoaded,
    ReadAll,
    Reading,
    ReadingEvent,
    Unpacked,
)
from app.model.scene_files import mesh_file, photo_files
from app.model.session import Session, setting
from app.model.state import Document, Job, State
from photoreg.errors import InputError, PhotoregError
from photoreg.formats.foreign import what_to_do
from photoreg.project.files import keep_file, plain_name
from photoreg.sources import read_regular
from photoreg.words import listed

MAX_FILES = 200

log = logging.getLogger(__name__)


@dataclasses.dataclass(eq=False)
class Batch:
    """Files that are read together and become one undo step."""

    step: str
    first: str
    """Name of the first file."""
    begins_anew: bool = False
    """Whether they take the place of what is open."""
    came: frozenset[Path] = frozenset()
    """What came as it is; all else came out of zips or is packed together."""
    unpacked: list[Path] = dataclasses.field(default_factory=list)
    """What is to be read after that."""
    loaded: list[Loaded] = dataclasses.field(default_factory=list)
    problems: list[str] = dataclasses.field(default_factory=list)
    left_out: tuple[str, ...] = ()
    """A sentence for each file in a zip that is of a kind that is not read."""

    def culprit(self, problem: str) -> str:
        """The file that ``problem`` is about, by name."""
        named = (path.name for path in (*self.came, *self.unpacked))
        return next((name for name in named if name in problem), self.first)

    def put_into(self, state: State) -> State:
        """The state with what was read; what does not fit is a problem."""
        if self.begins_anew and any(isinstance(e, MeshLoaded) for e in self.loaded):
            state = dataclasses.replace(state, document=Document(), selected=0)
        n_before = len(state.document.photos)
        for event in self.loaded:
            try:
                match event:
                    case MeshLoaded():
                        state = reducers.with_mesh(state, event)
                    case PhotoLoaded():
                        state = reducers.with_photo(state, event)
                    case CamerasLoaded():
                        state = reducers.with_loaded_cameras(state, event)
            except PhotoregError as error:
                self.problems.append(str(error))
        n_new = len(state.document.photos) - n_before
        if n_new > 0:
            # Where the work begins: the first of the new photos.
            state = dataclasses.replace(state, selected=n_before)
        if len(self.loaded) > 1:
            notes = [self._in_words(n_new, state.document.mesh is not None)]
            for event in self.loaded:
                match event:
                    case MeshLoaded():
                        notes += event.mesh.notes
                    case CamerasLoaded():
                        notes += event.file.notes
            note = " ".join(notes)
            state = dataclasses.replace(state, note=note)
        return state

    def _in_words(self, n_new_photos: int, has_mesh: bool) -> str:
        """What has been opened, and the step that comes next."""
        opened = [e.mesh.name for e in self.loaded if isinstance(e, MeshLoaded)]
        if n_new_photos > 0:
            opened.append("1 photo" if n_new_photos == 1 else f"{n_new_photos} photos")
        cameras = [e.name for e in self.loaded if isinstance(e, CamerasLoaded)]
        opened += [f"the cameras of {name}" for name in cameras]
        said = [f"Opened {listed(opened)}."] if opened else []
        if not has_mesh:
            said.append("Next: drop the scan.")
        elif n_new_photos > 0 and not cameras:
            said.append("Next: find the cameras, in tab 2.")
        return " ".join(said)


class FileIntake:
    """Takes files in batches; opens each batch when it is complete.

    Until then nothing changes, so that what is cancelled leaves no trace.
    """

    def __init__(
        self,
        session: Session,
        must_be_idle: Callable[[], None],
        on_problem: Callable[[str, str], None],
        keep_in_project: Callable[[str, bytes], Path | None] = lambda *_: None,
    ) -> None:
        self._session = session
        self._must_be_idle = must_be_idle
        self._on_problem = on_problem
        self._reader = Reader()
        self._keep_in_project = keep_in_project
        self._folder = tempfile.TemporaryDirectory(prefix="photoreg-")
        self._count = itertools.count(1)
        self._sender: int | None = None
        self._n_expected = 0
        self._received: list[Path] = []
        self._cameras = Path(self._folder.name)
        """Where files of cameras go: those of some formats are several."""
        self._batch: Batch | None = None

    @property
    def is_busy(self) -> bool:
        """Whether files are coming or are being read.

        Once it is false, what came is in the state.
        """
        with self._session.lock:
            return self._sender is not None or self._batch is not None

    def close(self) -> None:
        """Ends the reading and removes the files."""
        self._batch = None
        self._reader.cancel()
        self._folder.cleanup()

    def expect(self, browser: int, n_files: int) -> None:
        """So many files are about to come from a browser.

        Raises:
            InputError: if that is too many.
            RefinementError: if something else is still going on.
        """
        if not 1 <= n_files <= MAX_FILES:
            raise InputError(f"Up to {MAX_FILES} files can be opened at once.")
        with self._session.lock:
            self._must_be_idle()
            self._sender, self._n_expected, self._received = browser, n_files, []
            self._cameras = self._new_folder()
            files = "a file" if n_files == 1 else f"{n_files} files"
            self._show(f"Receiving {files}", 0.0)
        try:
            self._reader.prepare()
        except OSError as error:
            self._give_up()
            raise not_begun(error) from error

    def receive(self, browser: int, name: str, content: bytes) -> None:
        """A file has come; with the last one of its batch, all are opened.

        Raises:
            InputError: if the file is not one that photoreg reads, or has no place.
        """
        with self._session.lock:
            if browser != self._sender:
                return  # Of a batch that was cancelled.
            try:
                self._received.append(self._keep(name, content))
            finally:
                self._one_less()

    def refuse(self, browser: int, sentence: str) -> None:
        """A file of a batch does not come; the others are opened all the same.

        Raises:
            InputError: always, with the sentence.
        """
        with self._session.lock:
            if browser == self._sender:
                self._one_less()
        raise InputError(sentence)

    def _one_less(self) -> None:
        self._n_expected -= 1
        if self._n_expected == 0:
            self._sender = None
            self._session.change(None, setting(job=None))
            if self._received:
                self.open(self._received)

    def left(self, browser: int) -> None:
        """A browser has gone: what it was sending will not come."""
        if browser == self._sender:
            self.cancel()

    def open_one(self, name: str, content: bytes) -> None:
        """Opens a single file."""
        self._cameras = self._new_folder()
        self.open([self._keep(name, content)])

    def open(self, paths: Sequence[Path]) -> None:
        """Opens files, as one undo step.

        A mesh that comes with photos begins a new scene. A mesh alone takes the place
        of the one before; photos alone are added. Out of a zip, the cameras are taken,
        and the mesh and the photos that are not there yet.

        Raises:
            InputError: if there are two meshes among them, or nothing is.
            RefinementError: if something else is still going on.
        """
        with self._session.lock:
            self._must_be_idle()
            step = f"Open {len(paths)} files"
            if len(paths) == 1:
                step = (
                    f"{'Add' if kind_of(paths[0]) == PHOTO else 'Load'} {paths[0].name}"
                )
            elif all(kind_of(path) == CAMERAS for path in paths):
                step = "Load cameras"
            batch = Batch(step, paths[0].name)
            archives = [path for path in paths if is_zip(path)]
            found = [path for path in paths if not is_zip(path)]
            has_mesh = any(kind_of(path) == MESH for path in found)
            if archives or (has_mesh and len(found) > 1):
                self._unpack(batch, archives, found)
            else:
                self._read(batch, found)

    def _unpack(
        self, batch: Batch, archives: Sequence[Path], found: list[Path]
    ) -> None:
        """Takes what is wanted out of zips, and reads it together with ``found``."""
        document = self._session.state.document
        packed = UnpackRequest(
            tuple(found),
            tuple(archives),
            self._cameras,
            frozenset(entry.name for entry in document.photos)
            | {path.name for path in found},
            document.mesh is not None or any(kind_of(p) == MESH for p in found),
        )
        batch.came = frozenset(found)
        self._begin(batch, packed, lambda paths: self._read(batch, paths))

    def _read(self, batch: Batch, found: Sequence[Path]) -> None:
        """Reads files, and opens them together.

        Raises:
            InputError: if there are two meshes among them, or nothing is.
        """
        materials = [path for path in found if kind_of(path) == MATERIAL]
        if materials:
            batch.problems.append(
                f"{materials[0].name} describes the materials of a mesh that does not "
                "name it, or is not there. Drop it together with its OBJ and pictures."
            )
            found = [path for path in found if path not in materials]
            if not found:
                raise InputError(batch.problems.pop())
        meshes = [path for path in found if kind_of(path) == MESH]
        if len(meshes) > 1:
            raise InputError(
                f"{meshes[1].name} is a second mesh; photos are laid onto one. "
                "Join the meshes first."
            )
        if not found:
            raise InputError(
                f"{batch.first} holds nothing that photoreg opens and that is not "
                "there already."
            )
        photos = {path.name: path for path in found if kind_of(path) == PHOTO}
        batch.begins_anew = bool(meshes) and bool(photos)
        if not batch.begins_anew:
            photos |= photo_files(self._session.state.document)
        has_cameras = any(kind_of(path) == CAMERAS for path in found)
        wanted = ReadRequest(
            tuple(sorted((p for p in found if kind_of(p) < CAMERAS), key=kind_of)),
            self._cameras if has_cameras else None,
            photos,
            mesh_file(self._session.state.document),
        )
        self._begin(batch, wanted, None)

    def _begin(
        self,
        batch: Batch,
        wanted: ReadRequest | UnpackRequest,
        then: Callable[[Sequence[Path]], None] | None,
    ) -> None:
        self._batch = batch
        self._show("Opening", 0.0)
        try:
            self._reader.read(wanted, lambda event: self._on_event(batch, event, then))
        except OSError as error:
            self._give_up()
            raise not_begun(error) from error

    def _give_up(self) -> None:
        self._sender = self._batch = None
        self._session.change(None, setting(job=None))

    def cancel(self) -> bool:
        """Leaves the files that are coming or being read; whether there were any."""
        with self._session.lock:
            if not self.is_busy:
                return False
            self._sender = self._batch = None
            note = "Cancelled; nothing was opened."
            self._session.change(None, setting(job=None, note=note))
        self._reader.cancel()
        return True

    def _on_event(
        self,
        batch: Batch,
        event: ReadingEvent,
        then: Callable[[Sequence[Path]], None] | None,
    ) -> None:
        with self._session.lock:
            if batch is not self._batch:
                return  # It was cancelled.
            match event:
                case Reading():
                    self._show(event.title, event.fraction)
                case MeshLoaded() | PhotoLoaded() | CamerasLoaded():
                    batch.loaded.append(event)
                case Unpacked():
                    batch.left_out = event.left_out
                    try:
                        batch.unpacked += [
                            path if path in batch.came else self._kept(path)
                            for path in event.paths
                        ]
                    except PhotoregError as error:
                        batch.problems.append(str(error))
                case Failed():
                    batch.problems.append(event.message)
                    if event.details:
                        log.error("%s\n%s", event.message, event.details)
                case ReadAll():
                    is_whole = event.complete and not (then and batch.problems)
                    if then is None or not is_whole:
                        self._end(batch, is_whole)
                        return
                    try:
                        then(batch.unpacked)
                    except PhotoregError as error:
                        batch.problems.append(str(error))
                        self._end(batch, complete=False)

    def _end(self, batch: Batch, complete: bool) -> None:
        self._batch = None
        self._session.change(None, setting(job=None))
        if complete:
            try:
                self._session.change(batch.step, batch.put_into)
            except PhotoregError as error:
                batch.problems.append(str(error))
        for problem in batch.problems:
            self._on_problem(f"Could not open {batch.culprit(problem)}", problem)
        for sentence in batch.left_out:
            self._on_problem(f"Left out of {batch.first}", sentence)

    def _show(self, title: str, fraction: float) -> None:
        job = self._session.state.job or Job(title, can_stop=True)
        job = dataclasses.replace(job, title=title, fraction=fraction)
        self._session.change(None, setting(job=job))

    def _kept(self, path: Path) -> Path:
        """A file out of a zip, where it stays."""
        if kind_of(path) in (CAMERAS, MATERIAL):
            return path  # Only read.
        return self._keep_file(plain_name(path.name), read_regular(path))

    def _new_folder(self) -> Path:
        folder = Path(self._folder.name) / str(next(self._count))
        folder.mkdir()
        return folder

    def _keep_file(self, name: str, content: bytes) -> Path:
        kept = self._keep_in_project(name, content)
        # A folder for each: what comes again keeps its name.
        return keep_file(self._new_folder(), name, content) if kept is None else kept

    def _keep(self, name: str, content: bytes) -> Path:
        # Only the last part of the name: a path must not leave the folder.
        plain = plain_name(name)
        kind = kind_of(Path(plain))
        if kind == UNREAD:
            suffixes = ", ".join(suffix for kind in KINDS for suffix in kind)
            why = what_to_do(Path(plain))
            raise InputError(
                f"{plain} is not a file photoreg opens"
                f"{f': {why}' if why else ''}. What is opened ends in {suffixes}."
            )
        if kind < CAMERAS:
            return self._keep_file(plain, content)
        if kind == MATERIAL:
            return keep_file(self._new_folder(), plain, content)
        if (self._cameras / plain).exists():
            raise InputError(f"{plain} came twice. Give one, or a zip with folders.")
        return keep_file(self._cameras, plain, content)


def not_begun(error: OSError) -> InputError:
    """That the process that reads files could not be started."""
    return InputError(
        "The files could not be opened: no process could be started to read them "
        f"({error.strerror or error}). Close other programs and try again."
    )
