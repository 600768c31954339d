"""Files dropped onto the page, or chosen together, with their real bytes."""

import dataclasses
import io
import os
import signal
import zipfile

import cv2
import pytest

from app.engine.scene_opening import open_files
from app.model.session import with_document
from app.model.state import Document
from photoreg.formats.archives import unzipped
from photoreg.formats.cameras.cameras_json import CameraFile, dump_cameras
from photoreg.formats.cameras.download import cameras_download
from photoreg.geometry.camera import same_camera
from photoreg.project.folder import DATABASE
from tests.browser.driver import wait_until
from tests.browser.own_files import drop


@pytest.fixture(scope="module")
def files(toy_document) -> dict[str, bytes]:
    """A mesh, two photos and their cameras, as files."""
    mesh = toy_document.mesh
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in mesh.faces.tolist()]
    made = {"rock.obj": "\n".join(lines).encode()}
    cameras = {}
    for entry, name in zip(toy_document.photos, ("a.png", "b.png"), strict=True):
        bgr = cv2.cvtColor(entry.photo.pixels, cv2.COLOR_RGB2BGR)
        made[name] = cv2.imencode(".png", bgr)[1].tobytes()
        cameras[name] = entry.camera
    made["cameras.json"] = dump_cameras(CameraFile(cameras)).encode()
    return made


@pytest.fixture(scope="module")
def running(open_app_once):
    """One app for the tests of this file; it takes seconds to start."""
    return open_app_once(Document())


def names(app) -> list[str]:
    return [entry.name for entry in app.state.document.photos]


def test_a_mesh_photos_and_cameras_dropped_together_are_one_new_scene(
    running, toy_document, files
):
    app = running
    app.session.change("Open", with_document(photos=toy_document.photos))
    before = app.state.document
    # The worst order: what needs the others comes first.
    order = ("cameras.json", "b.png", "a.png", "rock.obj")
    shown = drop(app.driver, {name: files[name] for name in order})
    assert shown == ["flex", "none"], "the target shows while files hover"

    def opened() -> bool:
        return sorted(names(app)) == ["a.png", "b.png"] and all(
            same_camera(entry.camera, original(entry).camera)
            for entry in app.state.document.photos
        )

    def original(entry):
        return toy_document.photos["ab".index(entry.name[0])]

    wait_until(opened, "photos and cameras are there, and the old photos gone")
    assert app.state.undo_name == "Open 4 files"
    assert app.state.selected == 0, "the work begins with the first new photo"
    assert app.state.job is None
    mesh = app.state.document.mesh
    assert mesh is not None
    assert len(mesh.faces) == len(toy_document.mesh.faces)
    for entry in app.state.document.photos:
        assert (entry.photo.pixels == original(entry).photo.pixels).all()
    app.driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is before, "one step back undoes all", 20)


def test_a_bad_file_among_good_ones_is_told_and_the_others_are_opened(running, files):
    app = running
    app.session.change("Begin", with_document(mesh=None, display_mesh=None, photos=()))
    drop(
        app.driver,
        {
            "notes.doc": b"notes",
            "broken.jpg": b"not a picture",
            "b.png": files["b.png"],
            "rock.obj": files["rock.obj"],
        },
    )
    app.driver.page.get_by_text("notes.doc is not a file photoreg opens").wait_for()
    app.driver.page.get_by_text("broken.jpg could not be read").wait_for()
    wait_until(lambda: names(app) == ["b.png"] and app.state.job is None, "b is there")
    assert app.state.document.mesh is not None


def test_several_files_are_chosen_at_once_and_added(running, files, tmp_path):
    app = running
    app.session.change("Begin", with_document(photos=()))
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(files[name])
    app.driver.tab("1 Data")
    with app.driver.page.expect_file_chooser() as chooser:
        app.driver.click("Open files …")
    chooser.value.set_files([tmp_path / "a.png", tmp_path / "b.png"])
    wait_until(lambda: names(app) == ["a.png", "b.png"], "both are added")
    wait_until(lambda: app.state.undo_name == "Open 2 files", "as one step", 20)


def test_cancel_ends_the_reading_and_leaves_no_trace(running, files):
    app = running
    app.session.change("Begin", with_document(photos=()))
    before, reader = app.state.document, app.controller.intake._reader
    reader.prepare()
    # The hardest case: a reader that hangs within a file and hears nothing.
    process = reader._process
    os.kill(process.pid, signal.SIGSTOP)
    drop(app.driver, {name: files[name] for name in ("rock.obj", "a.png", "b.png")})
    app.driver.page.get_by_role("status").get_by_text("Opening").wait_for()
    # Meanwhile the server answers, and what would disturb is refused.
    app.driver.tab("2 Align")
    drop(app.driver, {"a.png": files["a.png"]})
    app.driver.page.get_by_text("is still going on").wait_for()
    app.driver.click("Cancel")
    wait_until(lambda: app.state.job is None, "it is cancelled", 20)
    wait_until(lambda: not process.is_alive(), "the process is gone", 20)
    assert app.state.document is before
    app.driver.page.get_by_text("Cancelled; nothing was opened.").wait_for()
    drop(app.driver, {"a.png": files["a.png"]})
    wait_until(lambda: names(app) == ["a.png"], "the next file is opened")


def test_a_reader_that_dies_is_told_and_changes_nothing(running, files):
    app = running
    before, reader = app.state.document, app.controller.intake._reader
    reader.prepare()
    os.kill(reader._process.pid, signal.SIGSTOP)
    drop(app.driver, {"b.png": files["b.png"]})
    app.driver.page.get_by_role("status").get_by_text("Opening").wait_for()
    os.kill(reader._process.pid, signal.SIGKILL)
    app.driver.page.get_by_text("Reading was cut short").wait_for()
    wait_until(lambda: app.state.job is None, "nothing is going on any more", 20)
    assert app.state.document is before


def with_photos_misplaced(app, toy_document, *photo_names) -> list:
    """Opens the toy's photos under these names, all with the first one's camera."""
    first = toy_document.photos[0].camera
    entries = [
        dataclasses.replace(
            entry, photo=dataclasses.replace(entry.photo, name=name), camera=first
        )
        for entry, name in zip(toy_document.photos, photo_names, strict=True)
    ]
    app.session.change("Begin", with_document(photos=tuple(entries)))
    return [entry.camera for entry in toy_document.photos]


def colmap_files(true, *photo_names) -> bytes:
    named = dict(zip(photo_names, true, strict=True))
    return cameras_download("colmap", named, [], with_photos=False).content


def test_a_colmap_model_goes_on_here_as_files_and_as_a_zip(
    running, toy_document, tmp_path
):
    app, page = running, running.driver.page
    app.driver.dismiss_toasts()
    app.driver.tab("1 Data")
    true = with_photos_misplaced(app, toy_document, "a.png", "b.png")
    archive = tmp_path / "model.zip"
    archive.write_bytes(colmap_files(true, "a.png", "b.png"))
    parts = unzipped(archive, tmp_path, lambda name: name.endswith(".bin"))
    assert sorted(p.name for p in parts) == [
        "cameras.bin",
        "images.bin",
        "points3D.bin",
    ]
    for chosen, step in ((parts, "Load cameras"), ([archive], "Load model.zip")):
        before = app.state.document
        with page.expect_file_chooser() as chooser:
            app.driver.click("Load cameras …")
        chooser.value.set_files(chosen)
        wait_until(
            lambda: all(
                same_camera(entry.camera, camera)
                for entry, camera in zip(app.state.document.photos, true, strict=True)
            ),
            "the cameras of COLMAP are in force",
        )
        wait_until(lambda: app.state.job is None, "the reading has ended")
        assert app.state.undo_name == step
        assert "COLMAP" in app.state.note
        page.keyboard.press("Control+z")
        wait_until(
            lambda before=before: app.state.document is before,
            "one step back undoes it",
        )


def test_cameras_of_other_photos_are_refused_by_name(running, toy_document):
    app = running
    true = with_photos_misplaced(app, toy_document, "a.png", "b.png")
    before = app.state.document
    drop(app.driver, {"other.zip": colmap_files(true, "c.png", "d.png")})
    app.driver.page.get_by_text(
        "has cameras for c.png, d.png, but the photos"
    ).wait_for()
    assert app.state.document is before
    drop(app.driver, {"images.bin": b"half of a model"})
    app.driver.page.get_by_text("COLMAP's are cameras and images together").wait_for()
    drop(app.driver, {"broken.zip": b"PK but no zip"})
    app.driver.page.get_by_text("it is damaged, or not a zip").wait_for()
    drop(app.driver, {"half.zip": colmap_files(true, "c.png", "b.png")})
    wait_until(
        lambda: same_camera(app.state.document.photos[1].camera, true[1]),
        "the camera that is there is taken",
    )
    assert "1 of 2 photos; a.png kept" in app.state.note
    kept, old = (document.photos[0].camera for document in (app.state.document, before))
    assert same_camera(kept, old)


def test_a_zip_of_cameras_photos_and_mesh_opens_whole(running, toy_document, files):
    app = running
    app.session.change("Begin", with_document(mesh=None, display_mesh=None, photos=()))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items():
            archive.writestr(f"work/../{name}", content)
    drop(app.driver, {"work.zip": buffer.getvalue()})
    wait_until(
        lambda: (
            sorted(names(app)) == ["a.png", "b.png"]
            and all(
                same_camera(
                    entry.camera, toy_document.photos["ab".index(entry.name[0])].camera
                )
                for entry in app.state.document.photos
            )
        ),
        "mesh, photos and cameras are there",
    )
    assert app.state.document.mesh is not None
    assert app.state.undo_name == "Load work.zip"


def test_projects_are_made_and_opened_and_a_moved_file_is_asked_for(
    running, files, tmp_path, monkeypatch
):
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    app, page, projects = running, running.driver.page, running.controller.projects
    for name in ("rock.obj", "a.png"):
        (tmp_path / name).write_bytes(files[name])
    app.driver.tab("1 Data")
    page.get_by_text("Project: not kept").click()
    app.driver.click("New project")
    page.get_by_role("dialog").get_by_role("textbox").fill(
        str(tmp_path / "Bronze head")
    )
    app.driver.click("Create")
    page.get_by_text("Project: Bronze head").wait_for()
    opened = open_files([tmp_path / "rock.obj", tmp_path / "a.png"])
    app.session.change("Open", with_document(**vars(opened)))
    app.driver.click("New project")
    page.get_by_role("dialog").get_by_role("textbox").fill("Marble")
    app.driver.click("Create")
    page.get_by_text("Project: Marble").wait_for()
    assert app.state.document.mesh is None
    assert projects.current.folder == tmp_path / "data" / "projects" / "Marble"

    (tmp_path / "rock.obj").rename(tmp_path / "away.obj")
    app.driver.click("Open a project")
    app.driver.click("Bronze head")
    page.get_by_text("Before Bronze head opens").wait_for()
    page.get_by_role("textbox").fill(str(tmp_path / "away.obj"))
    app.driver.click("Look there")
    page.get_by_text("Project: Bronze head").wait_for()
    app.driver.page.get_by_role("button", name="Undo: Open").wait_for()
    mesh = app.state.document.mesh
    assert mesh is not None
    assert mesh.source.path == tmp_path / "away.obj"
    assert names(app) == ["a.png"]
    projects.close()


def test_a_project_that_cannot_be_had_leaves_the_question_open(
    open_app, toy_document, tmp_path, monkeypatch
):
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    app = open_app(toy_document)
    app.driver.dismiss_toasts()
    page = app.driver.page
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("mine")
    app.driver.tab("1 Data")
    page.get_by_text("Project: not kept").click()
    dialog = page.get_by_role("dialog")

    app.driver.click("Open a project")
    dialog.get_by_role("textbox").fill("Nowhere")
    app.driver.click("Open")
    objection = dialog.get_by_role("alert")
    objection.get_by_text("Nowhere").wait_for()
    assert dialog.get_by_role("textbox").input_value() == "Nowhere"
    # The answer is mended, and asked again.
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / DATABASE).write_text("no database")
    dialog.get_by_role("textbox").fill(str(tmp_path / "broken"))
    app.driver.click("Open")
    objection.get_by_text("broken").wait_for()
    dialog.get_by_role("button", name="Cancel").click()
    dialog.wait_for(state="detached")

    app.driver.click("Save as")
    dialog.get_by_role("textbox").fill(str(tmp_path / "full"))
    app.driver.click("Save")
    objection.get_by_text("full").wait_for()
    dialog.get_by_role("textbox").fill(str(tmp_path / "copy"))
    app.driver.click("Save")
    page.get_by_text("Project: copy").wait_for()
    assert not dialog.count()

    # For a new project in a folder that holds other things, a free one in it is offered.
    app.driver.click("New project")
    dialog.get_by_role("textbox").fill(str(tmp_path / "full"))
    app.driver.click("Create")
    objection.get_by_text("holds other files already").wait_for()
    free = tmp_path / "full" / "photoreg-project"
    assert dialog.get_by_role("textbox").input_value() == str(free)
    app.driver.click("Create")
    page.get_by_text("Project: photoreg-project").wait_for()
    current = app.controller.projects.current
    assert current is not None
    assert current.folder == free
    assert (tmp_path / "full" / "letter.txt").read_text() == "mine"
    app.controller.projects.close()
