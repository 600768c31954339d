"""A project of photoreg 0.1.0 opens with all that it held.

`project_of_0_1_0` was kept by the app of that version: a rock with two photos, points, a
mask, a name, undone work, a run that ended and one that a kill cut short. What is stored
in it is named by class and field, so a renamed class must go on to read the old name.
"""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from app.control.project_reading import read_all
from app.control.projects import Projects
from app.model.masks import decode_mask
from app.model.run import Run
from app.model.session import Session, setting
from app.model.state import ModelChoice, PointPair
from app.page.main import open_project
from photoreg.registration.checkpoint import Checkpoint, problem_digest
from photoreg.registration.config import RegistrationConfig

KEPT = Path(__file__).with_name("project_of_0_1_0")


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    shutil.copytree(KEPT, tmp_path / "work")
    session = Session()
    projects = Projects(session, read=read_all)
    open_project(projects, (), None, tmp_path / "work")
    assert session.state.waiting is None
    yield session
    projects.close()


def test_the_document_is_as_it_was_left(session):
    document = session.state.document
    first, second = document.photos
    assert document.mesh.name == "rock.ply"
    assert document.mesh.faces.shape == (320, 3)
    assert document.up == (0.0, 1.0, 0.0)
    assert (first.name, second.name) == ("toy-0.png", "right é.png")
    assert first.pairs == (
        PointPair(1, (0.1, 0.2, 1 / 3), (12.5, 1e-3)),
        PointPair(2, None, (7.0, 8.0)),
        PointPair(4, (-0.0, 1e-300, 5.0)),
    )
    mask = decode_mask(second.mask_png)
    assert mask.shape == (120, 160)
    assert not mask[20, 20:41].any()
    assert mask[60:].all()
    assert first.camera.K[0, 0] == 180.0
    t_cam_world = (-0.32995459, -0.14078115, 4.13135447)
    assert np.allclose(first.camera.t_cam_world, t_cam_world, rtol=0.0, atol=1e-8)


def test_the_work_can_be_undone_to_its_beginning(session):
    assert session.state.redo_name == "Turn"
    session.change(None, setting(run=Run()))
    names = ["Rename", "Mask", "Points", "Move camera 2", "Move camera 1"]
    assert [session.undo() for _ in names] == names
    assert session.undo() == "Open 3 files"
    assert session.state.document.photos == ()


def test_the_choices_are_as_they_were_made(session):
    state = session.state
    fast = RegistrationConfig.preset("fast")
    genetic = dataclasses.replace(fast.genetic, population=40, generations=4000)
    assert state.config == dataclasses.replace(fast, seed=3, genetic=genetic)
    assert state.model_choice == ModelChoice("glb", "jpeg")
    assert state.texture_config.mode == "best"
    assert state.overlay_style == "swipe"
    assert state.mesh_opacity == 0.25
    assert state.held == (("toy-0.png", "pose"),)
    assert state.selected == 1


def test_the_run_that_ended_is_listed_and_the_one_cut_short_can_go_on(session):
    state = session.state
    ended, _ = state.runs
    assert [run.number for run in state.runs] == [1, 2]
    assert ended.photo_names == ("toy-0.png", "right é.png")
    assert ended.outcome.startswith("All generations of the search are done.")
    assert ended.curve[0].step == 0
    assert state.run.number == 2
    assert state.run.curve
    assert state.kept_search.run == 2
    assert state.can_go_on


def test_the_kept_search_is_still_the_one_that_the_run_would_begin(session):
    state = session.state
    document, run = state.document, state.run
    photos = [entry.masked_photo for entry in document.photos]
    problem = problem_digest(document.mesh, photos, run.start, run.config, run.freedom)
    kept = Checkpoint.from_bytes(state.kept_search.content)
    assert kept.problem == problem
