"""Whatever is done with projects, files that others put there keep name and content.

Random files, links and pipes are put into all folders that projects use, at any time,
between random ways to make, open, work in, save, kill, convert, close and remove them.
"""

import contextlib
import hashlib
import os
import sqlite3
import stat
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.control import user_data
from app.control.project_reading import read_all
from app.control.projects import Projects, remove_untouched
from app.model.session import Session, with_document
from app.model.state import Document
from photoreg.errors import PhotoregError
from photoreg.project.folder import DATABASE, partial_name

PLACES = ("a", "a/files", "a/files/2", "a/files/mine", "b", "b/files", "c")
PLACES += ("data", "data/projects", "newest", "newest/files")
NAMES = ("thesis.txt", "a.jpg", "b.jpg", "2", "3", "files", "project-version-1.db")
NAMES += (f".photoreg-{'7' * 32}.part", "a.jpg.part", "photoreg-project", "Untitled")
KINDS = ("file", "file of the same content", "folder", "link", "link to a folder")
KINDS += ("link to nothing", "second name", "pipe")
FOLDERS = ("a", "b", "a/photoreg-project")
CONTENTS = (b"one photo", b"another photo")

Deed = tuple[str, ...]

PLANT = st.tuples(
    st.just("plant"),
    st.sampled_from(PLACES),
    st.sampled_from(NAMES),
    st.sampled_from(KINDS),
)
DEEDS = st.one_of(
    PLANT,
    PLANT,
    st.tuples(st.sampled_from(["make", "open", "save"]), st.sampled_from(FOLDERS)),
    st.tuples(st.just("upload"), st.sampled_from(["a.jpg", "b.jpg"])),
    st.tuples(
        st.sampled_from(
            ["make newest", "work", "kill", "convert", "move", "close", "tidy"]
        )
    ),
)


def imprint(path: Path) -> tuple[int, str]:
    """The kind of what is there, and its content."""
    kind = stat.S_IFMT(path.lstat().st_mode)
    content = b""
    if stat.S_ISLNK(kind):
        content = os.fsencode(path.readlink())
    elif stat.S_ISREG(kind):
        content = path.read_bytes()
    return kind, hashlib.sha256(content).hexdigest()


class World:
    """Folders with projects and with files of somebody's own."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.session = Session()
        self.projects = Projects(self.session, read=read_all)
        self.known: dict[Path, tuple[int, str]] = {}
        self.newest = root / "nowhere"
        self.height = 0.0
        outside = root / "outside" / "folder"
        outside.mkdir(parents=True)
        for path in (
            outside.parent / "file",
            outside / "a.jpg",
            outside / "thesis.txt",
        ):
            path.write_bytes(CONTENTS[0])
        self._remember(*outside.parent.rglob("*"))

    def _remember(self, *paths: Path) -> None:
        self.known.update({path: imprint(path) for path in paths})

    def do(self, deed: Deed) -> None:
        what, *rest = deed
        with contextlib.suppress(PhotoregError):
            match what:
                case "plant":
                    self.plant(*rest)
                case "make":
                    self.projects.new(Document(), self.root / rest[0])
                case "make newest":
                    self.projects.new(Document())
                    assert self.projects.current is not None
                    self.newest = self.projects.current.folder
                case "open":
                    self.projects.open(self.root / rest[0])
                case "save":
                    self.projects.save_as(self.root / rest[0])
                case "upload":
                    self.projects.keep_file(rest[0], CONTENTS[1])
                case "work":
                    self.height += 1.0
                    up = (0.0, 1.0, self.height)
                    self.session.change("Turn", with_document(up=up))
                    self.projects.wait()
                case "kill":
                    self.kill()
                case "convert":
                    self.convert()
                case "move":
                    self.move()
                case "tidy":
                    if self.projects.current is not None:
                        self.projects.current.collect_garbage()
                    remove_untouched()
                case "close":
                    self.projects.close()

    def plant(self, place: str, name: str, kind: str) -> None:
        """Puts something of somebody's own where nothing is."""
        folder = self.root / place
        if place.startswith("newest"):
            folder = self.newest / place[len("newest/") :]
        path = folder / name
        if place == "data/projects":
            path = user_data.projects_folder() / name
        with contextlib.suppress(FileExistsError, NotADirectoryError):
            if not folder.is_dir():
                folder.mkdir(parents=True)
            if folder.resolve() != folder or os.path.lexists(path):
                return
            outside = self.root / "outside"
            match kind:
                case "file":
                    path.write_bytes(CONTENTS[0])
                case "file of the same content":
                    path.write_bytes(CONTENTS[1])
                case "folder":
                    path.mkdir()
                    (path / "notes.txt").write_text("mine")
                    self._remember(path / "notes.txt")
                case "link":
                    path.symlink_to(outside / "file")
                case "link to a folder":
                    path.symlink_to(outside / "folder")
                case "link to nothing":
                    path.symlink_to(outside / "nothing")
                case "second name":
                    path.hardlink_to(outside / "file")
                case "pipe":
                    os.mkfifo(path)
            self._remember(path)

    def kill(self) -> None:
        """As a kill leaves an upload that was just being written."""
        project = self.projects.current
        if project is None or project.read_only:
            return
        kept = project.keep_file("a.jpg", CONTENTS[1])
        inside = kept.parent.relative_to(project.folder).as_posix()
        partial = f"{inside}/{partial_name()}"
        with contextlib.closing(sqlite3.connect(project.path)) as database, database:
            made = "SELECT 1 FROM own WHERE path = ? AND kind = 'folder'"
            if database.execute(made, (inside,)).fetchone() is None:
                return
            database.executemany(
                "INSERT OR REPLACE INTO own VALUES (?, ?, ?, ?)",
                [
                    (partial, "part", None, None),
                    (f"{inside}/never", "file", "0" * 64, 7),
                ],
            )
        (project.folder / partial).write_bytes(CONTENTS[1][:4])

    def convert(self) -> None:
        """As a project of the first version is, which knew of no files of its own."""
        self.projects.close()
        path = self.root / "a" / DATABASE
        if path.is_file() and path.stat().st_size:
            with contextlib.closing(sqlite3.connect(path)) as old:
                old.executescript("DROP TABLE IF EXISTS own; PRAGMA user_version = 1;")
        self.projects.open(self.root / "a")

    def move(self) -> None:
        """The open project's folder goes, another comes, and it is back."""
        project = self.projects.current
        if project is None or project.folder.name != "a":
            return
        away = self.root / "away"
        project.folder.rename(away)
        project.folder.mkdir()
        (project.folder / f"{DATABASE}-wal").write_text("another's")
        with contextlib.suppress(PhotoregError):
            project.keep_file("b.jpg", CONTENTS[1])
        with contextlib.suppress(PhotoregError):
            project.collect_garbage()
        assert [p.name for p in project.folder.iterdir()] == [f"{DATABASE}-wal"]
        (project.folder / f"{DATABASE}-wal").unlink()
        project.folder.rmdir()
        away.rename(project.folder)

    def look(self) -> None:
        for path, before in self.known.items():
            assert os.path.lexists(path), f"{path} is gone"
            assert imprint(path) == before, f"{path} has changed"


def check(deeds: list[Deed]) -> None:
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        root = Path(name).resolve()
        patch.setenv("PHOTOREG_DATA", str(root / "data"))
        world = World(root)
        try:
            for deed in deeds:
                world.do(deed)
                world.look()
        finally:
            world.projects.close()
        world.look()
        remove_untouched()
        world.look()


@given(st.lists(DEEDS, min_size=4, max_size=14))
@settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
def test_no_file_of_others_is_touched(deeds: list[Deed]) -> None:
    check(deeds)


@pytest.mark.slow
@given(st.lists(DEEDS, min_size=4, max_size=14))
@settings(
    max_examples=1000, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
def test_no_file_of_others_is_touched_in_a_thousand_ways(deeds: list[Deed]) -> None:
    check(deeds)
