"""Files that browsers bring: kept, told apart by suffix, and opened one after the other.

The worker reads one file at a time. What came together is one undo step.
"""

import dataclasses
import itertools
import tempfile
from collections.abc import Callable
from pathlib import Path

from app import outcomes
from app.messages import LoadMesh, LoadPhoto, MeshLoaded, PhotoLoaded
from app.opening import with_camera_file
from app.session import Change, Session, setting
from app.state import Document, Job, State
from app.worker import Worker
from photoreg.errors import InputError, PhotoregError
from photoreg.mesh import MESH_SUFFIXES
from photoreg.photo import PHOTO_SUFFIXES
from photoreg.project_files import keep_file, plain_name

KINDS = (MESH_SUFFIXES, PHOTO_SUFFIXES, (".json",))
"""In the order in which they are opened: cameras are matched to photos that are there."""

MAX_FILES = 200


class Intake:
    """Takes files in batches; opens each batch when it is complete."""

    def __init__(
        self,
        session: Session,
        worker: Worker,
        must_be_idle: Callable[[], None],
        on_problem: Callable[[str], None],
    ) -> None:
        self._session = session
        self._worker = worker
        self._must_be_idle = must_be_idle
        self._on_problem = on_problem
        self._folder = tempfile.TemporaryDirectory(prefix="photoreg-")
        self.keep_file: Callable[[str, bytes], Path] = self._keep_apart
        """Where the files go; with a project, into it."""
        self._count = itertools.count(1)
        self._expected: dict[int, int] = {}
        self._received: dict[int, list[Path]] = {}
        self._waiting: list[Path] = []
        self._n_files = 0
        self._step: tuple[str, object] = ("", None)
        self._begins_anew = False

    def close(self) -> None:
        """Removes the files."""
        self._folder.cleanup()

    def expect(self, browser: int, n_files: int) -> None:
        """So many files are about to come from a browser."""
        if not 1 <= n_files <= MAX_FILES:
            raise InputError(f"Up to {MAX_FILES} files can be opened at once.")
        self._expected[browser], self._received[browser] = n_files, []

    def receive(self, browser: int, name: str, content: bytes) -> None:
        """A file has come; with the last one of its batch, all are opened.

        Raises:
            InputError: if the file is not one that photoreg reads, or has no place.
        """
        left = self._expected.pop(browser, 1) - 1
        paths = self._received.setdefault(browser, [])
        if left > 0:
            self._expected[browser] = left
        else:
            del self._received[browser]
        try:
            paths.append(self._keep(name, content))
        finally:
            if left <= 0 and paths:
                self.open(paths)

    def open_one(self, name: str, content: bytes) -> None:
        """Opens a single file."""
        self.open([self._keep(name, content)])

    def open(self, paths: list[Path]) -> None:
        """Opens files, as one undo step.

        A mesh that comes with photos begins a new scene. A mesh alone takes the place
        of the one before; photos alone are added.

        Raises:
            InputError: if there are two meshes among them.
            RefinementError: if something else is still going on.
        """
        with self._session.lock:
            self._must_be_idle()
            meshes = [p for p in paths if _kind(p) == 0]
            if len(meshes) > 1:
                raise InputError(
                    f"{meshes[1].name} is a second mesh; photos are laid onto one. "
                    "Join the meshes first."
                )
            step = f"Open {len(paths)} files"
            if len(paths) == 1:
                step = f"{'Add' if _kind(paths[0]) == 1 else 'Load'} {paths[0].name}"
            self._step = (step, ("open", next(self._count)))
            self._begins_anew = bool(meshes) and any(_kind(p) == 1 for p in paths)
            self._n_files = len(paths)
            self._waiting = sorted(paths, key=_kind)
            self._next()

    def loaded(self, event: MeshLoaded | PhotoLoaded) -> None:
        """The worker has read a file: it joins the scene, and the next one is read."""
        begins_anew = self._begins_anew and isinstance(event, MeshLoaded)

        def change(state: State) -> State:
            if isinstance(event, PhotoLoaded):
                return outcomes.with_photo(state, event)
            if begins_anew:
                state = dataclasses.replace(state, document=Document(), selected=0)
            return outcomes.with_mesh(state, event)

        with self._session.lock:
            self._session.change(None, setting(job=None))
            self._change(change)
            self._next()

    def failed(self) -> None:
        """A file could not be read: the others still are."""
        with self._session.lock:
            self._next()

    def forget(self) -> None:
        """The worker is gone; what waits is not opened."""
        self._waiting = []

    def _next(self) -> None:
        while self._waiting:
            path = self._waiting.pop(0)
            kind = _kind(path)
            if kind < 2:
                number = self._n_files - len(self._waiting)
                of = f" ({number} of {self._n_files})" if self._n_files > 1 else ""
                job = Job(f"Reading {path.name}{of}")
                self._session.change(None, setting(job=job))
                self._worker.send(LoadPhoto(path) if kind else LoadMesh(path))
                return
            try:
                self._change(
                    lambda state, path=path: dataclasses.replace(
                        state, document=with_camera_file(state.document, path)
                    )
                )
            except PhotoregError as error:
                self._on_problem(str(error))

    def _change(self, change: Change) -> None:
        self._session.change(self._step[0], change, self._step[1])

    def _keep_apart(self, name: str, content: bytes) -> Path:
        # A folder for each: what comes again keeps its name.
        folder = Path(self._folder.name) / str(next(self._count))
        folder.mkdir()
        return keep_file(folder, name, content)

    def _keep(self, name: str, content: bytes) -> Path:
        # Only the last part of the name: a path must not leave the folder.
        plain = plain_name(name)
        if _kind(Path(plain)) == len(KINDS):
            suffixes = ", ".join(suffix for kind in KINDS for suffix in kind)
            raise InputError(
                f"{plain} is not a file photoreg opens: the suffix should be one of "
                f"{suffixes}."
            )
        return self.keep_file(plain, content)


def _kind(path: Path) -> int:
    """The place in ``KINDS``; their number if it is none of them."""
    suffix = path.suffix.lower()
    return next((i for i, kind in enumerate(KINDS) if suffix in kind), len(KINDS))
