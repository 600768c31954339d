"""A project among somebody's own files: none of them is removed, changed or followed."""

import contextlib
import dataclasses
import hashlib
import os
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from app.control import user_data
from app.control.autosave import DOCUMENT_TYPES
from app.control.project_reading import read_all
from app.control.projects import Projects, remove_untouched
from app.engine.scene_opening import demo_folder
from app.model.session import Session, with_document
from app.page.main import open_project
from photoreg.cli import commands
from photoreg.errors import InputError, OutputError
from photoreg.formats.photos.read import load_photo
from photoreg.project.folder import DATABASE, LOCK, FolderInUseError
from photoreg.project.project import Project
from photoreg.project.schema import APPLICATION_ID, MIGRATIONS
from tests.browser.driver import wait_until


@pytest.fixture(autouse=True)
def data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder whose `files/` holds a scan, photos and a thesis."""
    shutil.copytree(demo_folder(), tmp_path / "my" / "files")
    (tmp_path / "my" / "files" / "thesis.txt").write_text("five years of work")
    return tmp_path / "my"


def hashes(folder: Path) -> dict[str, str]:
    """What is in a folder, links as links."""
    return {
        str(path.relative_to(folder)): str(path.readlink())
        if path.is_symlink()
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


def opened(folder: Path) -> tuple[Session, Projects]:
    session = Session()
    projects = Projects(session, read=read_all)
    open_project(projects, (), None, folder)
    return session, projects


def turned(session: Session, height: float) -> None:
    session.change("Turn", with_document(up=(0.0, 1.0, height)))


# Making.


def test_the_command_line_refuses_a_folder_in_use_and_names_a_command_for_a_free_one(
    mine: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(mine)
    before = hashes(mine)
    names = ["shell.ply", "shell-left.jpg", "shell-right.jpg"]
    files = [f"files/{name}" for name in names]
    words = ["app", "--no-browser", *files, "--project", "."]
    assert commands.run(words) == 2
    told = " ".join(capfd.readouterr().err.split())
    assert f"Use: photoreg app {' '.join(files)} --project photoreg-project" in told
    assert hashes(mine) == before
    projects = Projects(Session(), read=read_all)
    open_project(projects, [Path(f) for f in files], None, Path("photoreg-project"))
    projects.close()
    assert before.items() <= hashes(mine).items()
    opened(mine / "photoreg-project")[1].close()
    assert before.items() <= hashes(mine).items()


def test_a_new_project_in_a_folder_in_use_is_refused_with_a_free_one_to_offer(
    mine: Path,
) -> None:
    before = hashes(mine)
    with pytest.raises(FolderInUseError, match="not an empty folder") as refused:
        Projects(Session()).new(folder=mine)
    assert refused.value.suggestion == mine / "photoreg-project"
    (mine / "photoreg-project").write_text("mine, too")
    with pytest.raises(FolderInUseError) as refused:
        Project(mine)
    assert refused.value.suggestion == mine / "photoreg-project-2"
    assert before.items() <= hashes(mine).items()


def test_files_that_is_a_link_is_never_followed(mine: Path, tmp_path: Path) -> None:
    session, projects = opened(tmp_path / "work")
    turned(session, 1.0)
    projects.close()
    (tmp_path / "work" / "files").symlink_to(mine / "files")
    before = hashes(mine)
    session, projects = opened(tmp_path / "work")
    with pytest.raises(OutputError, match="a link"):
        projects.keep_file("thesis.txt", b"another")
    assert "so it stays" in session.state.note
    projects.close()
    assert hashes(mine) == before


def test_the_making_of_a_project_that_was_cut_short_is_gone_on_with(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / LOCK).write_text("process 1 on here since then\n")
    (folder / DATABASE).touch()
    opened(folder)[1].close()
    with sqlite3.connect(folder / DATABASE) as made:
        assert made.execute("PRAGMA application_id").fetchone()[0] == APPLICATION_ID
    made.close()
    # Beside somebody's files, an empty file of that name is one of them.
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / DATABASE).touch()
    (tmp_path / "other" / "a.txt").write_text("a")
    with pytest.raises(FolderInUseError):
        Project(tmp_path / "other")
    assert (tmp_path / "other" / DATABASE).stat().st_size == 0


# Deleting.


def test_what_others_put_into_a_project_stays_and_is_told(
    mine: Path, tmp_path: Path
) -> None:
    session, projects = opened(tmp_path / "work")
    turned(session, 1.0)
    unused = projects.keep_file("broken.jpg", b"not a picture")
    assert unused is not None
    projects.close()
    files = tmp_path / "work" / "files"
    shutil.copytree(mine / "files", files / "thesis")
    (files / "link").symlink_to(mine / "files" / "thesis.txt")
    (files / "notes.txt").write_text("notes")
    before = {k: v for k, v in hashes(files).items() if k != "broken.jpg"}
    session, projects = opened(tmp_path / "work")
    assert not unused.exists()
    assert "so it stays" in session.state.note
    projects.close()
    assert hashes(files) == before


def test_an_upload_that_somebody_changed_since_is_theirs(tmp_path: Path) -> None:
    _, projects = opened(tmp_path / "work")
    kept = projects.keep_file("broken.jpg", b"not a picture")
    assert kept is not None
    projects.close()
    kept.write_bytes(b"a drawing of it")
    session, projects = opened(tmp_path / "work")
    assert kept.read_bytes() == b"a drawing of it"
    assert "broken.jpg" in session.state.note
    assert projects.keep_file("broken.jpg", b"not a picture") != kept
    projects.close()


WRITER = """
import os, sys
from pathlib import Path
from photoreg.project.project import Project
project = Project(sys.argv[1])
if sys.argv[2] == "named":
    link, os.fsync = os.link, lambda _: None
    os.link = lambda *paths: (link(*paths), os._exit(9))
else:
    os.fsync = lambda _: os._exit(9)
project.keep_file("a.jpg", b"content" * 1000)
"""


@pytest.mark.parametrize("moment", ["growing", "named"])
def test_what_a_kill_leaves_of_an_upload_goes_and_only_that(
    tmp_path: Path, moment: str
) -> None:
    folder = tmp_path / "work"
    project = Project(folder)
    project.keep_file("before.jpg", b"before")
    project.close()
    done = subprocess.run([sys.executable, "-c", WRITER, folder, moment], check=False)
    assert done.returncode == 9
    (partial,) = folder.glob("files/.photoreg-*.part")
    theirs = partial.with_name(f".photoreg-{'0' * 32}.part")
    theirs.write_bytes(partial.read_bytes())
    project = Project(folder, create=False)
    project.collect_garbage()
    assert [path.name for path in (folder / "files").iterdir()] == [theirs.name]
    assert project.foreign == (theirs,)
    project.close()


def test_a_database_from_elsewhere_cannot_have_other_files_removed(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "work"
    project = Project(folder)
    project.keep_file("a.jpg", b"a")
    victims = [tmp_path / "victim", folder / "notes", folder / "files" / "2" / "b"]
    victims += [folder / "files" / "x" / "c"]
    for victim in victims:
        victim.parent.mkdir(exist_ok=True)
        victim.write_bytes(b"mine")
    project.close()
    own = hashlib.sha256(b"mine").hexdigest()
    claims = [
        *(
            (path, kind, own, 4)
            for path in ("../victim", str(tmp_path / "victim"), "notes", "files/x/c")
            for kind in ("file", "part")
        ),
        ("files/2/b", "file", own, 4),
        ("files/../notes", "file", own, 4),
        ("files/..", "folder", None, None),
    ]
    with contextlib.closing(sqlite3.connect(folder / DATABASE)) as database, database:
        database.executemany("INSERT OR REPLACE INTO own VALUES (?, ?, ?, ?)", claims)
    project = Project(folder, create=False)
    project.collect_garbage()
    assert all(victim.read_bytes() == b"mine" for victim in victims)
    assert not (folder / "files" / "a.jpg").exists()
    project.close()


@pytest.mark.parametrize("touched", [False, True])
def test_a_folder_is_never_removed_with_what_somebody_put_into_it(
    data_folder: Path, mine: Path, touched: bool
) -> None:
    session = Session()
    projects = Projects(session, read=read_all)
    projects.new()
    assert projects.current is not None
    folder = projects.current.folder
    shutil.copytree(mine, folder / "my")
    (folder / "empty").mkdir()
    if touched:
        turned(session, 1.0)
    before = hashes(mine)
    projects.close()
    remove_untouched()
    assert hashes(folder / "my") == before
    assert (folder / "empty").is_dir()
    assert (folder / DATABASE).exists() == touched
    # A mark beside a project that somebody made is no permission either.
    given = data_folder / "projects" / "given"
    given.mkdir()
    opened(given)[1].close()
    (given / user_data.MADE_HERE).write_text(user_data.MADE_HERE_TEXT)
    remove_untouched()
    assert (given / DATABASE).exists()


def test_an_untouched_project_of_its_own_goes_whole(data_folder: Path) -> None:
    projects = Projects(Session(), read=read_all)
    projects.new()
    projects.close()
    assert list((data_folder / "projects").iterdir()) == []


def test_a_project_of_the_first_version_keeps_all_that_is_in_it(
    mine: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    shutil.copytree(mine / "files", folder / "files")
    with sqlite3.connect(folder / DATABASE) as old:
        old.executescript(MIGRATIONS[0])
        old.execute("PRAGMA user_version = 1")
        old.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        content = (folder / "files" / "thesis.txt").read_bytes()
        key = hashlib.sha256(content).hexdigest()
        old.execute(
            "INSERT INTO files VALUES (?, 'files/thesis.txt', ?, ?)",
            (key, key, len(content)),
        )
    old.close()
    (folder / "project-version-1.db").symlink_to(tmp_path / "nowhere")
    before = hashes(folder / "files")
    session, projects = opened(folder)
    assert "so it stays" in session.state.note
    kept = projects.keep_file("new.jpg", b"new")
    assert kept == folder / "files" / "2" / "new.jpg"
    projects.close()
    assert not (tmp_path / "nowhere").exists(), "the copy goes through no link"
    assert (folder / "project-version-1-2.db").exists()
    _, projects = opened(folder)
    projects.close()
    assert hashes(folder / "files") == before, "what it wrote itself may go"


def test_saving_as_copies_what_is_the_projects_and_nothing_else(
    mine: Path, tmp_path: Path
) -> None:
    _, projects = opened(tmp_path / "work")
    projects.keep_file("a.jpg", b"a")
    for name in ("files/thesis.txt", "notes.txt"):
        shutil.copy(mine / "files" / "thesis.txt", tmp_path / "work" / name)
    before = hashes(mine)
    with pytest.raises(FolderInUseError):
        projects.save_as(mine)
    assert hashes(mine) == before
    assert projects.current is not None
    assert projects.current.save_as(tmp_path / "copy") == []
    projects.close()
    assert sorted(hashes(tmp_path / "copy")) == ["files/a.jpg", DATABASE]
    opened(tmp_path / "copy")[1].close()
    assert sorted(hashes(tmp_path / "copy")) == [DATABASE, LOCK], "they are its own"


def test_a_database_from_elsewhere_cannot_have_other_files_copied(
    tmp_path: Path,
) -> None:
    folder, copy = tmp_path / "work", tmp_path / "away" / "copy"
    copy.parent.mkdir()
    project = Project(folder)
    project.keep_file("a.jpg", b"a")
    project.close()
    (tmp_path / "secret").write_bytes(b"mine")
    own = hashlib.sha256(b"mine").hexdigest()
    paths = ("../secret", str(tmp_path / "secret"), "\0files/a.jpg", "files/a\0.jpg")
    with contextlib.closing(sqlite3.connect(folder / DATABASE)) as database, database:
        database.executemany(
            "INSERT INTO own VALUES (?, 'file', ?, 4)", [(path, own) for path in paths]
        )
    project = Project(folder, create=False)
    project.save_as(copy)
    project.close()
    assert sorted(hashes(copy.parent)) == ["copy/files/a.jpg", f"copy/{DATABASE}"]


# Links and what is no file under the project's own names.


@pytest.mark.parametrize("kind", ["link", "second name", "text", "pipe"])
def test_a_lock_that_is_something_else_is_not_written(
    tmp_path: Path, kind: str
) -> None:
    folder = tmp_path / "work"
    Project(folder).close()
    theirs, lock = tmp_path / "theirs", folder / LOCK
    theirs.write_text("mine")
    lock.unlink()
    match kind:
        case "link":
            lock.symlink_to(theirs)
        case "second name":
            lock.hardlink_to(theirs)
        case "text":
            lock.write_text("mine")
        case "pipe":
            os.mkfifo(lock)
    with pytest.raises(InputError, match="is not photoreg's"):
        Project(folder)
    assert theirs.read_text() == "mine"
    assert kind != "text" or lock.read_text() == "mine"


@pytest.mark.parametrize("name", [DATABASE, f"{DATABASE}-wal", f"{DATABASE}-journal"])
@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_a_database_that_is_no_file_is_refused(
    tmp_path: Path, name: str, kind: str
) -> None:
    folder = tmp_path / "work"
    Project(folder).close()
    path = folder / name
    if path.exists():
        path.rename(tmp_path / "theirs")
    else:
        (tmp_path / "theirs").write_text("mine")
    before = (tmp_path / "theirs").read_bytes()
    match kind:
        case "link":
            path.symlink_to(tmp_path / "theirs")
        case "pipe":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
    with pytest.raises(InputError, match="not a regular file"):
        Project(folder)
    assert (tmp_path / "theirs").read_bytes() == before


def test_the_log_is_written_through_no_link(tmp_path: Path) -> None:
    session, projects = opened(tmp_path / "work")
    turned(session, 1.0)
    projects.close()
    (tmp_path / "theirs").write_text("mine")
    (tmp_path / "work" / "files").mkdir()
    (tmp_path / "work" / "files" / "notes").write_text("they are told of, in the log")
    (tmp_path / "work" / user_data.LOG_FILE).symlink_to(tmp_path / "theirs")
    opened(tmp_path / "work")[1].close()
    assert (tmp_path / "theirs").read_text() == "mine"


# The folder goes, the lock goes.


def failing(session: Session) -> str:
    """What the page says of the keeping, as soon as it fails."""
    wait_until(lambda: session.state.saving, "it is told", 20.0)
    return session.state.saving


def kept_again(session: Session) -> None:
    wait_until(lambda: not session.state.saving, "it is kept again", 20.0)


@pytest.mark.parametrize("replaced", [False, True])
def test_a_folder_that_was_renamed_is_told_and_kept_again_when_it_is_back(
    tmp_path: Path, replaced: bool
) -> None:
    folder, away = tmp_path / "work", tmp_path / "away"
    session, projects = opened(folder)
    turned(session, 1.0)
    assert projects.wait()
    folder.rename(away)
    if replaced:
        Project(folder).close()
    before = hashes(folder) if replaced else {}
    assert f"{folder} was removed, renamed" in failing(session), "unasked"
    turned(session, 2.0)
    with pytest.raises(OutputError, match="not being kept"):
        projects.keep_file("a.jpg", b"a")
    with pytest.raises(OutputError, match="saving as another project helps"):
        projects.new()
    assert (hashes(folder) if replaced else {}) == before
    assert replaced or not folder.exists(), "no ghost"
    if replaced:
        shutil.rmtree(folder)
    away.rename(folder)
    kept_again(session)
    assert projects.wait()
    assert session.state.saving == ""
    projects.close()
    session, projects = opened(folder)
    assert session.state.document.up == (0.0, 1.0, 2.0)
    projects.close()


def test_a_project_whose_folder_is_away_can_be_saved_elsewhere_with_its_uploads(
    tmp_path: Path,
) -> None:
    folder, away = tmp_path / "work", tmp_path / "away"
    session, projects = opened(folder)
    upload = projects.keep_file(
        "a.jpg", (demo_folder() / "shell-left.jpg").read_bytes()
    )
    assert upload is not None
    entry = session.state.document.photos[0]
    entry = dataclasses.replace(entry, photo=load_photo(upload))
    session.change("Add", with_document(photos=(entry,)))
    assert projects.wait()
    folder.rename(away)
    Project(folder).close()
    with sqlite3.connect(folder / DATABASE) as other:
        other.execute("PRAGMA journal_mode = WAL")
        other.execute("CREATE TABLE theirs (a)")
        other.commit()
        before = hashes(folder)
        failing(session)
        turned(session, 3.0)
        projects.save_as(tmp_path / "copy")
        assert session.state.saving == ""
        projects.close()
        assert hashes(folder) == before, "another project is there now"
    other.close()
    session, projects = opened(tmp_path / "copy")
    assert session.state.waiting is None
    assert session.state.document.up == (0.0, 1.0, 3.0)
    projects.close()


def test_without_the_lock_there_is_one_writer_still(tmp_path: Path) -> None:
    first = Project(tmp_path / "work", DOCUMENT_TYPES)
    (tmp_path / "work" / LOCK).unlink()
    second = Project(tmp_path / "work", DOCUMENT_TYPES)
    assert "look at only" in second.read_only
    second.close()
    first.write_settings({"a": 1})
    assert (tmp_path / "work" / LOCK).exists(), "made again"
    (tmp_path / "work" / LOCK).unlink()
    (tmp_path / "work" / LOCK).write_text("somebody's")
    with pytest.raises(OutputError, match="was replaced"):
        first.write_settings({"a": 2})
    (tmp_path / "work" / LOCK).unlink()
    first.write_settings({"a": 3})
    first.close()


def test_whatever_becomes_of_the_locks_nobody_writes_over_the_work_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As on a file system that locks nothing.
    monkeypatch.setattr("photoreg.project.lock._lock", lambda _: True)
    first = Project(tmp_path / "work", DOCUMENT_TYPES)
    first.write_settings({"a": 1})
    second = Project(tmp_path / "work", DOCUMENT_TYPES)
    assert second.read_setting("a") == 1
    second.write_settings({"a": 2})
    with pytest.raises(OutputError, match="another program has written"):
        first.write_settings({"a": 3})
    second.write_settings({"b": 4})
    assert second.read_setting("a") == 2
    second.close()
    first.close()


def test_a_locked_database_is_not_called_a_full_disk(tmp_path: Path) -> None:
    project = Project(tmp_path / "work")
    project._connection.execute("PRAGMA busy_timeout = 10")
    other = sqlite3.connect(project.path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(OutputError, match="open and locked") as refused:
        project.write_settings({"a": 1})
    assert "full" not in str(refused.value)
    other.execute("ROLLBACK")
    other.close()
    project.write_settings({"a": 1})
    project.close()
