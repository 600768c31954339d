"""What a run warns of: the border of its box, little overlap, a camera that sees nothing."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.model.camera_moves import orbited
from app.model.session import setting, with_entry
from photoreg.geometry.camera import Camera, same_camera
from tests.browser.driver import wait_until
from tests.browser.refine_runs import QUICK, drop, open_to_refine, to_its_end


@pytest.fixture(scope="module")
def app(open_app_once):
    return open_to_refine(open_app_once)


def test_an_answer_on_the_border_of_its_box_says_so_and_what_to_do(app):
    narrow = dataclasses.replace(QUICK, box=QUICK.box.widened(0.1))
    app.session.change(None, setting(config=narrow))
    app.driver.click("Refine")
    to_its_end(app)
    told = app.driver.page.get_by_text(
        "The answer lies on the border of the search box"
    )
    told.wait_for()
    assert "Refine again from here, or choose a wider box." in told.inner_text()
    app.session.change(None, setting(config=None))
    drop(app)


def with_second_camera(app, camera: Camera) -> None:
    """Puts the second photo's camera elsewhere, as a step of undo."""
    app.session.change("Align badly", with_entry(1, camera=camera))


def test_photos_that_hardly_overlap_are_told_before_and_after(app):
    window, camera = app.driver.page, app.state.document.photos[1].camera
    turn = Rotation.from_rotvec(np.radians(120.0) * camera.R_cam_world[1]).as_matrix()
    anchor = app.state.document.mesh.centroid
    with_second_camera(app, orbited(camera, anchor, turn))
    window.get_by_text("Align better, or take photos from nearer viewpoints").wait_for()
    app.session.change(None, setting(preset="fast", config=None))
    app.driver.click("Refine")
    to_its_end(app)
    wait_until(lambda: app.state.run.grade == "unconvincing", "it is not believed")
    window.get_by_text("align them more closely").first.wait_for()
    drop(app)
    app.driver.click("Undo: Align badly")
    wait_until(lambda: app.state.document.photos[1].camera is camera, "it is undone")


def test_a_camera_that_sees_nothing_is_named_and_stays_while_the_other_is_refined(app):
    window, entry = app.driver.page, app.state.document.photos[1]
    turned = np.diag([-1.0, 1.0, -1.0]) @ entry.camera.R_cam_world
    away = dataclasses.replace(
        entry.camera, R_cam_world=turned, t_cam_world=-turned @ entry.camera.center
    )
    with_second_camera(app, away)
    window.get_by_text(
        f"The camera of {entry.name} sees nothing of the surface: align it in tab 2."
    ).wait_for()
    wait_until(lambda: app.state.run.error_px is None, "it is no number")
    document = app.state.document
    wait_until(lambda: app.state.worker == "", "the worker is ready", 120)
    app.driver.click("Refine")
    to_its_end(app)
    window.get_by_text(
        f"The camera of {entry.name} does not see the surface and was left as it is"
    ).first.wait_for()
    assert same_camera(app.state.run.cameras[1], away)
    assert app.state.document is document
    drop(app)
    app.driver.click("Undo: Align badly")
    wait_until(lambda: app.state.document.photos[1] is entry, "it is undone")
