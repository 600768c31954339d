"""Work that outlives the program: undo history, choices, runs, a process that is killed."""

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from app.autosave import DOCUMENT_TYPES
from app.main import open_project
from app.projects import Projects
from app.run import CurvePoint, KeptSearch, Run
from app.session import Session, select, setting, with_document, with_entry
from photoreg.errors import InputError, OutputError
from photoreg.presets import RegistrationConfig
from photoreg.project import Project

WRITER = """
import sys
from pathlib import Path
from app.main import open_project
from app.projects import Projects
from app.session import Session, with_document
session = Session()
projects = Projects(session)
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


def _opened(folder: Path) -> tuple[Session, Projects]:
    session = Session()
    projects = Projects(session)
    open_project(projects, (), None, folder)
    return session, projects


def test_history_choices_and_runs_survive_a_restart(tmp_path: Path) -> None:
    session, projects = _opened(tmp_path / "work")
    camera = session.state.document.photos[0].camera
    moved = dataclasses.replace(camera, t_cam_world=camera.t_cam_world + 0.25)
    session.change("Move camera 1", with_entry(0, camera=moved))
    session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    session.undo()
    names = tuple(entry.name for entry in session.state.document.photos)
    cameras = session.state.document.used_cameras
    config = RegistrationConfig.preset("fast")
    curve = (CurvePoint(0, 1.0, 2.0),)
    run = Run("review", 1, "", "fast", config, names, cameras, cameras, curve=curve)
    session.change(None, setting(run=run, runs=(run,), mesh_opacity=0.25))
    session.change(None, select(1))
    projects.close()

    again, projects = _opened(tmp_path / "work")
    state = again.state
    assert (state.undo_name, state.redo_name) == ("Move camera 1", "Turn")
    assert (state.mesh_opacity, state.selected) == (0.25, 1)
    assert state.run.curve == curve
    assert state.run.config == config
    assert [r.number for r in state.runs] == [1]
    assert (state.document.photos[0].camera.t_cam_world == moved.t_cam_world).all()
    again.change(None, setting(run=Run()))
    assert again.undo() == "Move camera 1"
    assert (again.state.document.photos[0].camera.K == camera.K).all()
    projects.close()


def test_a_run_that_is_cut_short_can_go_on_after_a_restart(tmp_path: Path) -> None:
    session, projects = _opened(tmp_path / "work")
    entry = session.state.document.photos[0]
    run = Run(
        "running",
        3,
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
    assert second.is_read_only
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
