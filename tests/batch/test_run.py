"""One object's run without a cluster, and what a person makes of it afterwards."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.control.projects import Projects
from app.model.session import Session
from app.page.main import open_project
from photoreg.batch import run as run_module
from photoreg.batch.batch import BatchFinished, run_batch
from photoreg.batch.collection import CollectionObject, read_collection
from photoreg.batch.mended import MENDED, mended_result
from photoreg.batch.record import load_record, still_holds
from photoreg.batch.run import ObjectTask, run_task, sweep
from photoreg.batch.settings import ObjectSettings
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.registration.config import RegistrationConfig
from photoreg.texture.config import TextureConfig
from tests.batch.collections import make_collection

FAST = RegistrationConfig.preset("fast", seed=1)
ASKED = ObjectSettings(
    config=dataclasses.replace(
        FAST,
        genetic=dataclasses.replace(FAST.genetic, population=20, generations=3),
        polish_after=False,
    ),
    model="ply",
    texture=TextureConfig(size=64),
)


def task_of(thing: CollectionObject, out: Path, **changes: Any) -> ObjectTask:
    task = ObjectTask(
        name=thing.name,
        base=thing.base,
        inputs=thing.inputs(),
        files=thing.files(),
        settings=thing.settings,
        out=out,
        scratch=".photoreg-0-1",
        threads=1,
    )
    return dataclasses.replace(task, **changes)


@pytest.fixture
def done(tmp_path) -> tuple[CollectionObject, Path]:
    """A done object and the folder of all results."""
    (thing,) = read_collection(make_collection(tmp_path / "things", 1), ASKED)
    out = tmp_path / "out"
    out.mkdir()
    assert run_task(task_of(thing, out)).status == "done"
    return thing, out


def batch(thing: CollectionObject, out: Path) -> BatchFinished:
    """A batch in which nothing is left to do, so that it needs no cluster."""
    *_, last = run_batch([thing], out)
    assert isinstance(last, BatchFinished)
    return last


def test_a_record_holds_as_long_as_content_and_settings_do(done):
    thing, out = done
    record = load_record(out / thing.name)
    assert record is not None
    assert still_holds(record, thing) is record
    photo = thing.inputs().photos[0]
    content = photo.read_bytes()
    photo.write_bytes(content)  # At another time.
    renewed = still_holds(record, thing)
    assert renewed is not None
    assert renewed is not record
    photo.write_bytes(content + b"\0")
    assert still_holds(record, thing) is None
    photo.write_bytes(content)
    extra = thing.base / "second.stl"
    extra.write_bytes(b"x")
    assert still_holds(record, thing) is None, "it is not clear any more"
    extra.unlink()
    other = dataclasses.replace(ASKED, report=False)
    assert still_holds(record, dataclasses.replace(thing, settings=other)) is None


def test_what_a_run_makes_without_being_asked_for_is_removed_again(done):
    thing, out = done
    folder = out / thing.name
    (folder / "mine.txt").write_text("mine")
    bare = dataclasses.replace(ASKED, report=False, model="none")
    assert run_task(task_of(dataclasses.replace(thing, settings=bare), out)).status == (
        "done"
    )
    names = {path.name for path in folder.iterdir()}
    assert {"mine.txt", "cameras.json", "object.json"} < names
    assert not {"report.html", "model.ply", "model.png"} & names


def test_a_record_that_is_damaged_is_none(done):
    thing, out = done
    path = out / thing.name / "object.json"
    for text in ("", "[]", '{"format": "photoreg-object"}', "{" * 100_000):
        path.write_text(text)
        assert load_record(out / thing.name) is None


def test_too_little_memory_is_not_the_object_s_failure(done, monkeypatch):
    thing, out = done

    def refuse(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(run_module, "make_results", refuse)
    assert run_task(task_of(thing, out)).status == "out of memory"


def test_a_photo_without_a_camera_is_refused_but_not_the_mesh_s_texture(done):
    thing, out = done
    (thing.base / "extra.png").write_bytes(thing.inputs().photos[0].read_bytes())
    outcome = run_task(task_of(thing, out))
    assert outcome.status == "failed"
    assert "no camera for extra.png" in outcome.sentence
    (thing.base / "extra.png").unlink()
    # A mesh with a texture of its own, which looks like a photo.
    thing.inputs().mesh.unlink()
    for name in ("model.ply", "model.png"):
        (out / thing.name / name).rename(thing.base / name)
    outcome = run_task(task_of(thing, out))
    assert (outcome.status, outcome.sentence) == ("done", "")
    record = load_record(out / thing.name)
    assert record is not None
    assert record.photos == ("clean-left.png", "clean-right.png")
    assert record.files["model.png"][2], "its content counts"


def test_contents_that_are_sent_give_the_same_results(done):
    thing, out = done
    contents = {name: (thing.base / name).read_bytes() for name in thing.files()}
    task = task_of(thing, out, contents=contents)
    outcome = run_task(task)
    assert outcome.status == "done", outcome.log
    assert outcome.results is not None
    alone = (out / thing.name / "cameras.json").read_bytes()
    assert outcome.results["cameras.json"] == alone


def opened(folder: Path) -> tuple[Session, Projects]:
    session = Session()
    projects = Projects(session)
    open_project(projects, [folder], None, None)
    return session, projects


def test_what_a_person_mends_counts_as_done_and_comes_into_the_summary(done):
    thing, out = done
    folder = out / thing.name
    before = load_cameras(folder / "cameras.json").cameras
    session, projects = opened(folder)
    document = session.state.document
    assert [entry.name for entry in document.photos] == list(before)
    for entry in document.photos:
        assert np.array_equal(entry.camera.P, before[entry.name].P)
    projects.close()
    assert mended_result(folder, load_record(folder)) is None, "only looked at"
    assert batch(thing, out).rows[0].status == "done"

    session, projects = opened(folder)
    first, *others = session.state.document.photos
    moved = dataclasses.replace(
        first.camera, t_cam_world=first.camera.t_cam_world + np.array([0.1, 0.0, 0.0])
    )
    mended = dataclasses.replace(first, camera=moved)
    session.change(
        "Move",
        lambda state: dataclasses.replace(
            state,
            document=dataclasses.replace(state.document, photos=(mended, *others)),
        ),
    )
    assert projects.wait(30.0)
    projects.close()
    # Whatever is asked for now, and even where its files are others by now.
    anew = dataclasses.replace(thing, settings=dataclasses.replace(ASKED, report=False))
    (row,) = batch(anew, out).rows
    assert (row.status, row.verdict) == ("mended", None)
    assert "by hand" in row.sentence
    kept = load_cameras(folder / MENDED).cameras
    assert np.array_equal(kept[first.name].P, moved.P)
    assert np.array_equal(
        load_cameras(folder / "cameras.json").cameras[first.name].P,
        before[first.name].P,
    )


def test_an_object_s_folder_says_where_its_files_have_gone(done):
    thing, out = done
    thing.inputs().mesh.rename(thing.base / "elsewhere")
    with pytest.raises(InputError, match="is no longer there"):
        opened(out / thing.name)


def test_only_what_attempts_left_is_swept(tmp_path):
    kept = tmp_path / "kept"
    for path in (kept, tmp_path / ".photoreg-notes", tmp_path / ".photoreg-3-1"):
        path.mkdir()
        (path / "thesis.txt").touch()
    (tmp_path / ".photoreg-5-1-host-9-aaaaaa").symlink_to(kept)
    for name in (".photoreg-3-1-host-77-0a1b2c", ".photoreg-4-2-a-b-78-ffffff"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.glb").touch()
    sweep(tmp_path, ".photoreg-3-1-")
    assert (tmp_path / ".photoreg-4-2-a-b-78-ffffff").is_dir()
    sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        ".photoreg-3-1",
        ".photoreg-5-1-host-9-aaaaaa",
        ".photoreg-notes",
        "kept",
    ]
    assert len(list(tmp_path.rglob("thesis.txt"))) == 3
