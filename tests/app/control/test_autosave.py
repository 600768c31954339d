"""Work that outlives the program: undo history, choices, runs, a process that is killed."""

import dataclasses
import logging
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import cv2
import pytest

from app.control.autosave import CHOICES, DOCUMENT_TYPES, fits
from app.control.project_reading import read_all
from app.control.projects import Projects, remove_untouched
from app.control.user_data import LOG_FILE
from app.engine.scene_opening import demo_folder
from app.model import photo_list
from app.model.masks import painted_mask
from app.model.run import KeptSearch, Run
from app.model.session import Session, select, setting, with_document, with_entry
from app.model.state import ModelChoice, PointPair, State
from app.page.main import open_project
from photoreg.errors import InputError, OutputError
from photoreg.formats.photos.read import load_photo
from photoreg.project.files import FileProblem
from photoreg.project.project import Project
from photoreg.registration.config import RegistrationConfig
from photoreg.report.cost_curve import CurvePoint

WRITER = """
import sys
from pathlib import Path
from app.page.main import open_project
from app.engine.scene_opening import demo_folder
from app.control.project_reading import read_all
from app.control.projects import Projects, remove_untouched
from app.model.session import Session, with_document
session = Session()
projects = Projects(session, read=read_all)
open_project(projects, (), None, Path(sys.argv[1]))
height = session.state.document.up[2]
while True:
    height += 1.0
    session.change("Turn", with_document(up=(0.0, 1.0, height)))
    projects._autosave.wait(60.0) or sys.exit(3)
    print("done", int(height), flush=True)
"""


@pytest.fixture(autouse=True)
def data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


def asked_of(session: Session) -> tuple[FileProblem, ...]:
    """The files that a project waits for."""
    waiting = session.state.waiting
    return () if waiting is None else waiting.problems


def _opened(folder: Path) -> tuple[Session, Projects]:
    session = Session()
    projects = Projects(session, read=read_all)
    open_project(projects, (), None, folder)
    return session, projects


def test_history_choices_and_runs_survive_a_restart(tmp_path: Path) -> None:
    session, projects = _opened(tmp_path / "work")
    state_before = session.state
    camera = state_before.document.photos[0].camera
    moved = dataclasses.replace(camera, t_cam_world=camera.t_cam_world + 0.25)
    session.change("Move camera 1", with_entry(0, camera=moved))
    session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    session.undo()
    names = tuple(entry.name for entry in session.state.document.photos)
    cameras = session.state.document.used_cameras
    config = RegistrationConfig.preset("fast")
    curve = (CurvePoint(0, 1.0, 2.0),)
    run = Run(
        status="review",
        number=1,
        began="",
        preset="fast",
        config=config,
        photo_names=names,
        start=cameras,
        cameras=cameras,
        curve=curve,
    )
    session.change(None, setting(run=run, runs=(run,), mesh_opacity=0.25))
    chosen: dict[str, Any] = {
        "config": dataclasses.replace(config, seed=7),
        "held": ((names[0], "pose"), (names[1], "focal")),
        "start_line": 0.5,
        "texture_config": dataclasses.replace(state_before.texture_config, mode="best"),
        "model_choice": ModelChoice("glb", "jpeg"),
        "overlay_style": "swipe",
    }
    session.change(None, setting(**chosen))
    session.change(None, select(1))
    projects.close()

    again, projects = _opened(tmp_path / "work")
    state = again.state
    assert (state.undo_name, state.redo_name) == ("Move camera 1", "Turn")
    assert (state.mesh_opacity, state.selected) == (0.25, 1)
    assert {name: getattr(state, name) for name in chosen} == chosen
    assert state.run.curve == curve
    assert state.run.config == config
    assert [r.number for r in state.runs] == [1]
    assert (state.document.photos[0].camera.t_cam_world == moved.t_cam_world).all()
    again.change(None, setting(run=Run()))
    assert again.undo() == "Move camera 1"
    assert (again.state.document.photos[0].camera.K == camera.K).all()
    projects.close()


def test_points_masks_names_order_and_use_survive_a_restart_with_their_undo(
    tmp_path: Path,
) -> None:
    session, projects = _opened(tmp_path / "work")
    first, second = session.state.document.photos
    pairs = (
        PointPair(1, (0.1, 0.2, 1 / 3), (12.5, 1e-3)),
        PointPair(2, None, (7.0, 8.0)),
        PointPair(4, (-0.0, 1e-300, 5.0)),
    )
    size = (first.photo.width, first.photo.height)
    mask = painted_mask(None, *size, [(90.0, 70.0), (120.0, 70.0)], 15.0, False)
    name = 'Left, "cleaned" é.jpg'
    session.change("Points", with_entry(0, pairs=pairs))
    session.change("Mask", with_entry(0, mask_png=mask))
    session.change("Crop", photo_list.cropped(first.name, True))
    session.change("Rename", photo_list.renamed(first.name, name))
    session.change("Move in the list", photo_list.shifted(name, 1))
    session.change("Leave out", photo_list.enabled(second.name, False))
    projects.close()

    again, projects = _opened(tmp_path / "work")
    other, ours = again.state.document.photos
    assert (other.name, ours.name) == (second.name, name)
    assert (other.enabled, ours.enabled) == (False, True)
    assert ours.pairs == pairs
    assert ours.mask_png == mask
    assert (ours.cropped, other.cropped) == (True, None)
    assert again.state.freedom.cropped == (0,)
    for step in ("Leave out", "Move in the list", "Rename", "Crop", "Mask", "Points"):
        assert again.undo() == step
    back = again.state.document.photos
    assert [entry.name for entry in back] == [first.name, second.name]
    assert [(entry.pairs, entry.mask_png) for entry in back] == [((), None)] * 2
    projects.close()


def test_a_run_that_is_cut_short_can_go_on_after_a_restart(tmp_path: Path) -> None:
    session, projects = _opened(tmp_path / "work")
    entry = session.state.document.photos[0]
    run = Run(
        status="running",
        number=3,
        config=RegistrationConfig(),
        photo_names=(entry.name,),
        start=(entry.camera,),
        cameras=(entry.camera,),
        curve=tuple(CurvePoint(i, 1.0 - 0.1 * i, 1.0) for i in range(6)),
    )
    kept = KeptSearch(3, 4, b"where it stands")
    session.change(None, setting(run=run, kept_search=kept))
    projects.wait()
    # As a kill leaves it: nobody has closed it.
    shutil.copytree(tmp_path / "work", tmp_path / "killed")

    again, killed = _opened(tmp_path / "killed")
    found = again.state.kept_search
    assert again.state.can_go_on
    assert found is not None
    assert (found.run, found.step, found.content) == (3, 4, b"where it stands")
    assert killed.current is not None
    assert len(killed.current.runs.generations(1)) == 6
    whole = dataclasses.replace(again.state.run, start_cost=2.0, cost=1.0)
    again.change(None, setting(run=whole, runs=(whole,), kept_search=None))
    killed.wait()
    assert killed.current.runs.unfinished_run() is None
    assert killed.current.runs.run(1).cost == 1.0
    killed.close()
    projects.close()


def test_a_second_program_may_only_look_and_says_so(tmp_path: Path) -> None:
    _, first = _opened(tmp_path / "work")
    session, second = _opened(tmp_path / "work")
    assert session.state.read_only
    assert "look at only" in session.state.saving
    with pytest.raises(OutputError, match="look at only"):
        session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    second.close()
    first.close()


def test_files_for_a_project_that_is_there_are_refused(tmp_path: Path) -> None:
    _opened(tmp_path / "work")[1].close()
    with pytest.raises(InputError, match="holds a project already"):
        open_project(
            Projects(Session()), (tmp_path / "a.obj",), None, tmp_path / "work"
        )


def test_every_choice_of_the_page_can_be_kept(tmp_path: Path) -> None:
    state = State()
    project = Project(tmp_path, DOCUMENT_TYPES)
    project.write_settings({name: getattr(state, name) for name in CHOICES})
    for name, hint in CHOICES.items():
        back = project.read_setting(name)
        assert back == getattr(state, name)
        assert fits(back, hint), f"{name} comes back as {back!r}"
    project.close()
    for name, wrong in (
        ("mesh_opacity", "much"),
        ("selected", 1.5),
        ("overlay_style", "woven"),
        ("held", (("a.jpg", "hair"),)),
        ("config", ModelChoice()),
        ("dark", 1),
    ):
        assert not fits(wrong, CHOICES[name]), f"{name} must not be {wrong!r}"


@pytest.fixture
def museum(tmp_path: Path) -> Path:
    """A folder with a mesh and photos of somebody's own."""
    return Path(shutil.copytree(demo_folder(), tmp_path / "museum"))


def _project_of(museum: Path, folder: Path) -> None:
    session = Session()
    projects = Projects(session, read=read_all)
    open_project(projects, [museum], None, folder)
    session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    projects.close()


def test_moved_files_are_asked_for_and_neighbours_are_found(
    tmp_path: Path, museum: Path
) -> None:
    _project_of(museum, tmp_path / "work")
    museum.rename(tmp_path / "moved")
    session, projects = _opened(tmp_path / "work")
    assert {p.kind for p in asked_of(session)} == {"missing"}
    assert len(asked_of(session)) == 3
    assert projects.current is None
    problem = asked_of(session)[0]
    with pytest.raises(InputError, match="cannot be read"):
        projects.locate(problem, tmp_path / "nowhere.ply", changed=False)
    with pytest.raises(InputError, match="whole path"):
        projects.locate(problem, "shell.ply", changed=False)
    assert len(asked_of(session)) == 3
    projects.locate(problem, tmp_path / "moved", changed=False)
    assert asked_of(session) == ()
    assert session.undo() == "Turn"
    sources = [entry.photo.source for entry in session.state.document.photos]
    assert all(s is not None and s.path.parent.name == "moved" for s in sources)
    projects.close()


def test_a_changed_file_is_used_only_if_that_is_said_and_only_if_it_fits(
    tmp_path: Path, museum: Path
) -> None:
    _project_of(museum, tmp_path / "work")
    path = museum / "shell-left.jpg"
    before = path.read_bytes()
    picture = cv2.imread(str(path))
    assert picture is not None
    cv2.imwrite(str(path), picture[:-2])
    session, projects = _opened(tmp_path / "work")
    (problem,) = asked_of(session)
    assert problem.kind == "changed"
    with pytest.raises(InputError, match="not the same file"):
        projects.locate(problem, path, changed=False)
    with pytest.raises(InputError, match="Use a file of that size"):
        projects.locate(problem, path, changed=True)
    assert asked_of(session) == (problem,), "nothing has changed"
    # Brought from somewhere else, the file that it was opens the project.
    kept = projects.locate_upload(problem, "shell-left.jpg", before)
    assert projects.is_same(problem, kept)
    projects.cancel()
    cv2.imwrite(str(path), 255 - picture)
    projects.open(tmp_path / "work")
    projects.locate(asked_of(session)[0], path, changed=True)
    assert session.state.document.photos[0].photo.pixels.mean() > 120
    projects.close()


def test_work_goes_on_in_the_copy_and_takes_its_files_along(
    tmp_path: Path, museum: Path
) -> None:
    _project_of(museum, tmp_path / "work")
    session, projects = _opened(tmp_path / "work")
    projects.save_as(tmp_path / "copy", gather=True)
    assert projects.current is not None
    assert projects.current.folder == tmp_path / "copy"
    session.change("Again", with_document(up=(1.0, 0.0, 0.0)))
    with pytest.raises(OutputError, match="not an empty folder"):
        projects.save_as(tmp_path / "work")
    projects.close()
    shutil.rmtree(museum)
    (tmp_path / "copy").rename(tmp_path / "far away")
    again, projects = _opened(tmp_path / "far away")
    assert (again.undo(), again.undo()) == ("Again", "Turn")
    projects.close()
    session, projects = _opened(tmp_path / "work")
    assert len(asked_of(session)) == 3, "the old project is as it was"
    projects.close()


def test_what_cannot_be_kept_keeps_the_project_open_and_a_copy_saves_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, projects = _opened(tmp_path / "work")
    assert projects.current is not None
    full = OutputError("The disk is full.")

    def refuse(*_: object) -> None:
        raise full

    monkeypatch.setattr(projects.current, "write_history", refuse)
    session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    assert projects.wait(), "nobody waits for what fails"
    assert session.state.saving == "The disk is full."
    with pytest.raises(OutputError, match="saving as another project helps"):
        projects.new()
    assert session.state.undo_name == "Turn"
    projects.save_as(tmp_path / "other disk")
    assert session.state.saving == ""
    projects.close()
    again, projects = _opened(tmp_path / "other disk")
    assert again.undo() == "Turn"
    projects.close()


def test_closing_waits_for_a_slow_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, projects = _opened(tmp_path / "work")
    project = projects.current
    assert project is not None
    write, go_on = project.write_history, threading.Event()

    def slowly(*arguments: Any) -> None:
        assert go_on.wait(20.0)
        write(*arguments)

    monkeypatch.setattr(project, "write_history", slowly)
    session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    assert not projects.wait(0.01), "the page says that it is still being kept"
    threading.Timer(0.1, go_on.set).start()
    projects.close()
    again, projects = _opened(tmp_path / "work")
    assert again.undo() == "Turn"
    projects.close()


def test_what_nobody_asked_for_and_worked_in_does_not_stay(data_folder: Path) -> None:
    folders = data_folder / "projects"
    session = Session()
    killed = Projects(session, read=read_all)
    open_project(killed, (), None, None)
    assert killed.current is not None
    folder = killed.current.folder
    remove_untouched()
    assert folder.exists(), "a program has it open"
    # As a kill would leave it.
    killed.current._lock.release()
    remove_untouched()
    assert not folder.exists()

    session = Session()
    touched = Projects(session, read=read_all)
    touched.new()
    session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    touched.close()
    remove_untouched()
    assert len(list(folders.iterdir())) == 1


def test_uploads_that_nothing_needs_any_more_go_when_the_project_is_opened(
    tmp_path: Path, museum: Path
) -> None:
    session, projects = _opened(tmp_path / "work")
    used = projects.keep_file("left.jpg", (museum / "shell-left.jpg").read_bytes())
    unused = projects.keep_file("broken.jpg", b"not a picture")
    assert used is not None
    assert unused is not None
    document = session.state.document
    entry = dataclasses.replace(document.photos[0], photo=load_photo(used))
    session.change("Add", with_document(photos=(entry, document.photos[1])))
    session.undo()
    projects.close()
    _, projects = _opened(tmp_path / "work")
    assert used.exists(), "redo still needs it"
    assert not unused.exists()
    projects.close()


def test_the_log_has_what_went_wrong_and_no_pixels(
    tmp_path: Path, museum: Path
) -> None:
    session, projects = _opened(tmp_path / "work")
    try:
        session.change("Fail", lambda state: 1 / 0)  # pyright: ignore[reportArgumentType]
    except ZeroDivisionError:
        logging.getLogger("app").exception("It failed")
    projects.close()
    text = (tmp_path / "work" / LOG_FILE).read_text("utf-8")
    assert "It failed" in text
    assert "ZeroDivisionError" in text
    assert len(text) < 2000


def test_nothing_reported_as_done_is_lost_by_a_kill(tmp_path: Path) -> None:
    folder, done = tmp_path / "work", 0
    for n_steps in (1, 4, 2, 7, 3):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert writer.stdout is not None
        seen = 0
        while seen < n_steps:
            line = writer.stdout.readline()
            assert line, "the writer ended by itself"
            if line.startswith("done"):
                done, seen = int(line.split()[1]), seen + 1
        writer.kill()
        rest = [line for line in writer.stdout if line.startswith("done")]
        writer.wait()
        writer.stdout.close()
        if rest and rest[-1].endswith("\n"):
            done = int(rest[-1].split()[1])
        project = Project(folder, DOCUMENT_TYPES)
        first, steps, now = project.read_history()
        project.close()
        # A step may be on disk before it is reported, never the other way round.
        assert steps[now - first].document.up[2] >= done
        assert len(steps) > done
