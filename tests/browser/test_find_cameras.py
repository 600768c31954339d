"""Find the cameras: from a mesh and photos to refined cameras without touching one."""

import dataclasses
import re

import numpy as np
from playwright.sync_api import expect

from app.model.messages import MeshLoaded, PhotoLoaded
from app.model.reducers import with_mesh, with_photo
from app.model.run import Run
from app.model.session import setting
from app.model.state import Document, State, same_camera
from app.panels.refine import FIND, FIND_AGAIN
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo
from photoreg.registration.config import RegistrationConfig
from photoreg.synthetic.rock import icosphere
from tests.browser.driver import wait_until
from tests.browser.own_files import in_picker
from tests.browser.refine_runs import start, to_its_end
from tests.scenes import small_scene


def dropped(mesh: Mesh, photos: tuple[Photo, ...]) -> Document:
    """The document that dropping these files makes: nobody has touched a camera."""
    state = with_mesh(State(), MeshLoaded(mesh, mesh.decimated(5_000)))
    for photo in photos:
        state = with_photo(state, PhotoLoaded(photo))
    return state.document


def test_two_photos_are_placed_and_refined_without_a_camera_being_touched(open_app):
    scene = small_scene(seed=5)
    app = open_app(dropped(scene.mesh, scene.photos))
    first = app.state.document.used_cameras
    app.driver.dismiss_toasts()
    app.driver.tab("2 Align")
    app.driver.click("Find the cameras")
    expect(app.driver.page.get_by_role("progressbar").first).to_be_visible()
    wait_until(lambda: app.state.job is None, "the cameras are found", 300.0)
    assert [one.grade for one in app.state.found] == ["found", "found"]
    rough = app.state.document.used_cameras
    assert projection_error(scene.mesh, scene.cameras, rough).mean < 5.0
    assert app.state.undo_name == "Find the cameras"
    app.driver.tab("3 Refine")
    start(app, RegistrationConfig.preset("fast"), hold=False)
    to_its_end(app)
    end = projection_error(scene.mesh, scene.cameras, app.state.run.cameras).mean
    assert end < 0.5, end
    app.controller.refinement.revert()
    app.session.undo()
    now = app.state.document.used_cameras
    assert all(map(same_camera, first, now))


def test_cancel_leaves_every_camera_as_it_was(open_app):
    scene = small_scene(seed=5)
    app = open_app(dropped(scene.mesh, scene.photos))
    before = app.state.document
    app.driver.dismiss_toasts()
    app.driver.tab("2 Align")
    app.driver.click("Find the cameras")
    app.driver.click("Cancel")
    wait_until(lambda: app.state.job is None, "the search is over", 120.0)
    assert app.state.note.startswith("Stopped")
    assert app.state.document is before
    assert app.state.undo_name is None


def test_a_round_object_offers_poses_to_pick_from_and_moved_cameras_stay(open_app):
    ball = Mesh(*icosphere(3))
    grey = np.full((120, 160, 3), 20, np.uint8)
    y, x = np.mgrid[:120, :160]
    grey[(x - 80) ** 2 + (y - 60) ** 2 < 40**2] = 180
    app = open_app(dropped(ball, (Photo("a.png", grey), Photo("b.png", grey))))
    app.driver.dismiss_toasts()
    app.driver.tab("2 Align")
    window = app.driver.page
    window.get_by_role("button", name="Nearer", exact=False).first.wait_for()
    app.driver.click("Bring the object nearer (N)")
    wait_until(lambda: app.state.undo_name is not None, "a camera is moved")
    moved = app.state.selected_photo.camera
    app.driver.click("Find the cameras")
    wait_until(lambda: bool(app.state.found), "the cameras are found", 300.0)
    assert same_camera(app.state.selected_photo.camera, moved)
    (one,) = app.state.found
    assert one.grade == "unsure"
    assert one.photo != app.state.selected_photo.name
    app.driver.click("Find this camera")

    def is_found() -> bool:
        found = app.state.found
        return bool(found) and found[0] is not one

    wait_until(is_found, "the camera is found", 300.0)
    (one,) = app.state.found
    expect(window.get_by_role("img", name="Pose 2")).to_be_visible()
    poses = window.get_by_role("radiogroup", name="Pose", exact=True)
    expect(poses.get_by_role("radio", checked=True)).to_have_text("Pose 1")
    app.driver.choose("Pose", "Pose 2")
    wait_until(
        lambda: same_camera(app.state.selected_photo.camera, one.candidates[1]),
        "the second pose is taken",
    )


def test_a_box_drawn_around_the_object_tells_it_from_others(open_app):
    scene = small_scene(seed=5)
    photo, other = scene.photos
    # The object stands between two that look like it, and only a person knows which.
    three = dataclasses.replace(
        photo, pixels=np.hstack([other.pixels, photo.pixels, other.pixels])
    )
    K = scene.cameras[0].K.copy()
    K[0, 2] += photo.width
    true = dataclasses.replace(scene.cameras[0], K=K, width=three.width)
    app = open_app(dropped(scene.mesh, (three,)))
    before, driver = app.state.document, app.driver

    def find() -> str:
        earlier = app.state.found
        driver.click("Find this camera")
        wait_until(lambda: app.state.found is not earlier, "it was looked for", 120.0)
        wait_until(lambda: bool(app.state.found), "it was looked for", 120.0)
        return app.state.found[0].grade

    driver.dismiss_toasts()
    driver.tab("2 Align")
    assert find() == "not found"

    driver.click("Draw a box around it")
    expect(driver.page.get_by_text("Drag a box around the object;")).to_be_visible()
    driver.page.wait_for_function("() => photoreg.picker.ready()")
    rows, columns = np.nonzero(render_geometry(scene.mesh, true).covered)
    first = np.array([columns.min() - 8.0, rows.min() - 8.0])
    last = np.array([columns.max() + 8.0, rows.max() + 8.0])
    start, end = in_picker(driver, first), in_picker(driver, last)
    driver.drag((start[0], start[1]), (end[0] - start[0], end[1] - start[1]))
    wait_until(lambda: app.state.undo_name == "Draw a box in photo 1", "it is drawn")
    (entry,) = app.state.document.photos
    expected = (*(first + 0.5), *(last - first))
    scale = driver.page.evaluate("() => photoreg.picker.scale()")
    assert np.abs(np.subtract(entry.box, expected)).max() < 1.5 / scale

    assert find() == "found"
    now = app.state.document.used_cameras
    error = projection_error(scene.mesh, [true], now).mean
    assert error < 10.0, f"{error:.1f} px off"
    app.session.undo()
    driver.click("Remove the box")
    wait_until(lambda: app.state.document.photos[0].box is None, "it is removed")
    app.session.undo()
    assert app.state.document.photos[0].box == entry.box
    app.session.undo()
    assert app.state.document == before
    expect(driver.page.get_by_role("button", name="Remove the box")).to_be_hidden()


def test_found_cameras_are_offered_where_the_start_sees_nothing_or_an_answer_fails(
    open_app,
):
    scene = small_scene(seed=5)
    document = dropped(scene.mesh, scene.photos)
    # Somebody has placed a camera, and looks away from the object with it.
    first, second = document.photos
    R = np.diag([-1.0, 1.0, -1.0]) @ first.camera.R_cam_world
    away = dataclasses.replace(
        first.camera, R_cam_world=R, t_cam_world=-R @ first.camera.center
    )
    photos = (dataclasses.replace(first, camera=away), second)
    app = open_app(dataclasses.replace(document, photos=photos))
    before, page = app.state.document, app.driver.page
    config = RegistrationConfig.preset("fast")
    app.session.change(None, setting(config=config))
    app.driver.dismiss_toasts()
    app.driver.tab("3 Refine")
    offered = page.get_by_role("button", name=FIND, exact=True)
    expect(offered).to_be_visible(timeout=60_000)
    assert app.state.document is before, "no camera moves by itself"

    cameras = before.used_cameras
    failed = Run(
        status="review",
        number=1,
        photo_names=tuple(photo.name for photo in scene.photos),
        start=cameras,
        cameras=cameras,
        grade="unconvincing",
        verdict="Unconvincing: the photos do not agree.",
        start_cost=0.5,
        cost=0.4,
        expected_errors_px=(6.96, 6.96),
        standard_errors=("left.png: expected error 6.96 px; rotation ±0.4°.",),
    )
    app.session.change(None, setting(run=failed, runs=(failed,)))
    # An answer that is not believed is left first, and nothing is expected of it.
    buttons = page.get_by_role("button", name=re.compile("^(Revert|Keep anyway)$"))
    expect(buttons).to_have_text(["Revert", "Keep anyway"])
    expect(page.get_by_text("The photos do not agree.")).to_be_visible()
    assert "6.96" not in page.locator("body").inner_text()
    app.driver.click(FIND_AGAIN)
    wait_until(lambda: app.state.run.is_active, "it refines from there", 300.0)
    assert app.state.undo_name == "Find the cameras"
    to_its_end(app)
    end = projection_error(scene.mesh, scene.cameras, app.state.run.cameras).mean
    assert end < 0.5, end
    expect(page.get_by_role("button", name=FIND_AGAIN, exact=True)).to_be_hidden()
    app.controller.refinement.revert()
    app.session.undo()
    assert app.state.document == before
