"""Projects are read in a process of their own: what it cannot do, and how it ends."""

import contextlib
import multiprocessing
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from app.control import project_reading
from app.control.project_reading import ProjectReader, read_all
from app.control.projects import Projects
from app.engine.scene_opening import demo_folder, open_folder
from app.model.session import Session
from photoreg.errors import InputError
from photoreg.imaging.photo import Photo
from photoreg.project.folder import DATABASE

GIGABYTE = 900_000_000


@pytest.fixture(autouse=True)
def data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A closed project of the demo."""
    projects = Projects(Session(), read=read_all)
    projects.new(open_folder(demo_folder()), tmp_path / "work")
    projects.close()
    return tmp_path / "work"


@pytest.fixture
def slow(folder: Path) -> Path:
    """The same with so many large files that reading them takes minutes."""
    with (folder.parent / "large.ply").open("wb") as file:
        file.truncate(GIGABYTE)
    connection = sqlite3.connect(folder / DATABASE, isolation_level=None)
    keys = [f"{i:064x}" for i in range(300)]
    connection.executemany(
        "INSERT INTO files VALUES (?, '../large.ply', ?, ?)",
        [(key, key, GIGABYTE) for key in keys],
    )
    files = ",".join(f'{{"file": "{key}"}}' for key in keys)
    connection.execute("UPDATE steps SET document = ?", (f"[{files}]",))
    connection.close()
    return folder


def descendants_of(pid: int) -> set[int]:
    """Process numbers, by Linux."""
    found = set()
    with contextlib.suppress(FileNotFoundError):  # It has ended meanwhile.
        for task in Path(f"/proc/{pid}/task").iterdir():
            found |= {int(word) for word in (task / "children").read_text().split()}
    return found.union(*map(descendants_of, found))


def is_there(pid: int) -> bool:
    """Whether a process runs; one that has ended and waits to be buried does not."""
    try:
        return (
            Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        )
    except OSError:
        return False


def running() -> list[BaseProcess]:
    """The processes of this one."""
    return list(multiprocessing.active_children())


def wait_until(test: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not test():
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.05)


def test_what_a_process_read_is_not_read_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked = ProjectReader().read(folder)
    assert {kind.__name__ for kind, _, _ in checked.loaded} == {"Mesh", "Photo"}
    session = Session()
    projects = Projects(session, read=lambda *_: checked)
    for name in ("load_mesh", "load_photo"):
        monkeypatch.setattr(
            f"photoreg.project.project.{name}", lambda path: pytest.fail(str(path))
        )
    projects.open(folder)
    read = {id(v.pixels) for v in checked.loaded.values() if isinstance(v, Photo)}
    photos = [entry.photo for entry in session.state.document.photos]
    assert {id(photo.pixels) for photo in photos} == read
    projects.close()


def test_files_that_have_moved_are_not_decoded_in_the_server_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    museum = Path(shutil.copytree(demo_folder(), tmp_path / "museum"))
    projects = Projects(Session(), read=read_all)
    projects.new(open_folder(museum), tmp_path / "work")
    projects.close()
    museum.rename(tmp_path / "moved")
    session = Session()
    projects = Projects(session)
    projects.open(tmp_path / "work")
    waiting = session.state.waiting
    assert waiting is not None
    assert len(waiting.problems) == 3
    for name in ("load_mesh", "load_photo"):
        monkeypatch.setattr(
            f"photoreg.project.project.{name}", lambda path: pytest.fail(str(path))
        )
    projects.locate(waiting.problems[0], tmp_path / "moved", changed=False)
    assert session.state.waiting is None
    assert len(session.state.document.photos) == 2
    projects.close()


def test_cancel_and_the_end_of_the_program_end_the_reading(slow: Path) -> None:
    for end in (Projects.stop_opening, Projects.close):
        projects, said = Projects(Session()), []

        def try_to_open(projects=projects, said=said) -> None:
            try:
                projects.open(slow)
            except InputError as error:
                said.append(str(error))

        thread = threading.Thread(target=try_to_open)
        thread.start()
        wait_until(lambda: bool(running()))
        process = running()[0]
        time.sleep(1.0)
        end(projects)
        thread.join(timeout=20)
        assert not thread.is_alive()
        assert said == ["Opening work was cancelled."]
        assert not process.is_alive()
        assert projects.current is None


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_signal_ends_the_program_while_it_opens_a_project(
    slow: Path, number: signal.Signals
) -> None:
    command = [sys.executable, "-m", "photoreg", "app", "--no-browser", "--port", "0"]
    with subprocess.Popen(
        [*command, "--project", str(slow)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        wait_until(lambda: bool(descendants_of(process.pid)))
        time.sleep(2.0)  # It is at the files.
        children = descendants_of(process.pid)
        assert children
        process.send_signal(number)
        said, complaint = process.communicate(timeout=20)
    assert process.returncode != 0
    assert "Traceback" not in said + complaint
    wait_until(lambda: not any(map(is_there, children)), 20)


def test_a_reader_that_dies_or_hangs_is_a_sentence(
    slow: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def then(number: signal.Signals) -> Callable[[str], None]:
        """Sends the reader a signal as soon as it is at the files."""

        def told(part: str) -> None:
            if part == "its files":
                (process,) = running()
                assert process.pid is not None
                os.kill(process.pid, number)

        return told

    with pytest.raises(InputError, match="reading its files was cut short"):
        ProjectReader().read(slow, then(signal.SIGKILL))
    monkeypatch.setattr(project_reading, "PATIENCE_PART_S", 5.0)
    with pytest.raises(InputError, match="took more than 5 s"):
        ProjectReader().read(slow, then(signal.SIGSTOP))
    assert not running()


@pytest.mark.parametrize("kind", ["pipe", "view"])
def test_the_server_never_touches_what_is_hostile(
    folder: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / DATABASE
    match kind:
        case "pipe":
            path.unlink()
            os.mkfifo(path)
        case "view":
            connection = sqlite3.connect(path)
            connection.execute("CREATE VIEW v AS SELECT 1")
            connection.close()
    monkeypatch.setattr(
        "app.control.projects.Project", lambda *_, **__: pytest.fail("touched")
    )
    session = Session()
    projects = Projects(session)
    with pytest.raises(InputError) as refused:
        projects.open(folder)
    assert "\n" not in str(refused.value)
    assert session.state.job is None
    projects.close()
