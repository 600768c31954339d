"""Cameras by points and masks by brush, with real mouse and keyboard in the picker."""

import dataclasses

import cv2
import numpy as np
import pytest
import trimesh
from playwright.sync_api import expect

from app.model.masks import decode_mask
from app.model.session import select, setting, with_document, with_entry
from app.model.state import PointPair
from app.scene.markers import WRONG
from photoreg.geometry.projection_error import projection_error
from tests.browser.driver import wait_until
from tests.browser.own_files import (
    click_pairs,
    in_picker,
    open_points,
    places_to_click,
)


@pytest.fixture(scope="module")
def running(open_app_once, toy_document):
    """One app for the tests of this file; it takes seconds to start."""
    app = open_app_once(toy_document)
    app.driver.dismiss_toasts()
    open_points(app)
    return app


@pytest.fixture
def app(running, toy_document):
    """The photos without points and masks; the first camera stands where the other is."""
    entry, other = toy_document.photos
    entry = dataclasses.replace(entry, camera=other.camera)
    running.session.change("Open", with_document(photos=(entry, other)))
    running.session.change(None, setting(live_solve=False, chosen_pair=None))
    running.session.change(None, select(0))
    running.driver.page.wait_for_function("() => photoreg.picker.ready()")
    running.driver.frames(3)
    return running


def entry_of(app):
    return app.state.document.photos[0]


def test_six_pairs_clicked_in_photo_and_model_place_the_camera(app, toy_document):
    driver, true = app.driver, toy_document.photos[0].camera

    def error_px() -> float:
        mesh = toy_document.mesh
        return projection_error(mesh, [true], [entry_of(app).camera]).mean

    before = error_px()
    places = places_to_click(app, true, 6)
    click_pairs(app, places)
    clicked = np.array([pair.pixel for pair in entry_of(app).pairs])
    off = np.abs(clicked - [pixel for _, pixel in places]).max()
    assert off < 0.5, f"a click lands {off:.2f} px off"
    solve = driver.page.get_by_role("button", name="Solve", exact=True)
    assert "points fit best" in (solve.get_attribute("title") or ""), "its line of help"
    solve.click()
    wait_until(lambda: app.state.undo_name == "Solve camera 1", "it is solved", 30)
    assert error_px() < 1.0 < 5.0 < before, f"{before:.1f} to {error_px():.2f} px"

    # Live: a marker dragged off its place tells, and undo brings it back.
    app.session.change(None, setting(live_solve=True))
    solved, (u, v) = app.state.document, clicked[2]
    scale = driver.page.evaluate("() => photoreg.picker.scale()")
    start = in_picker(driver, (u, v))
    driver.drag((start[0], start[1]), (-12.0 * scale, 0.0))
    wait_until(
        lambda: app.state.undo_name == "Move point 3 of photo 1", "it is moved", 30
    )
    dragged = entry_of(app).pairs[2].pixel
    assert np.abs(np.subtract(dragged, (u - 12.0, v))).max() < 1.0
    driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is solved, "one step back undoes it", 30)

    # So it is with a marker on the model, which keeps to the surface all the way.
    world = solved.photos[0].pairs[2].world
    drag_marker(app, 3, (9.0, 5.0))
    wait_until(
        lambda: app.state.undo_name == "Move point 3 of photo 1", "it is moved", 30
    )
    wait_until(lambda: entry_of(app).camera is not solved.photos[0].camera, "solved")
    dragged = np.array(entry_of(app).pairs[2].world)
    moved = np.linalg.norm(dragged - world) * app.page.scene.frame.scale
    assert 0.005 < moved < 0.2, f"moved by {moved:.3f} of the page's units"
    assert distance_to_surface(toy_document.mesh, dragged) < 1e-5 * np.abs(world).max()
    driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is solved, "one step back undoes it", 30)

    # A marker in focus goes by the Delete key, another by its cross in the table.
    app.session.change(None, setting(live_solve=False))
    driver.page.locator(".pr-mark[data-number='2']").focus()
    driver.page.keyboard.press("Delete")
    wait_until(
        lambda: [p.number for p in entry_of(app).pairs] == [1, 3, 4, 5, 6],
        "point 2 is deleted",
        30,
    )
    driver.click("Delete point 5")
    wait_until(
        lambda: [p.number for p in entry_of(app).pairs] == [1, 3, 4, 6],
        "point 5 is deleted",
        30,
    )


def drag_marker(app, number: int, way: tuple[float, float]) -> None:
    """Drags a marker on the model by some window pixels."""
    driver = app.driver
    world = entry_of(app).pairs[number - 1].world
    position, R_page_cam, view_rad = driver.viewport_camera()
    canvas = driver.canvas()
    focal = 0.5 * canvas["height"] / np.tan(0.5 * view_rad)
    x, y, depth = R_page_cam.T @ (app.page.scene.frame.to_page(world) - position)
    start = (
        canvas["x"] + canvas["width"] / 2 + focal * x / depth,
        canvas["y"] + canvas["height"] / 2 + focal * y / depth,
    )
    driver.drag(start, way)


def distance_to_surface(mesh, point: np.ndarray) -> float:
    triangles = mesh.vertices[mesh.faces]
    points = np.repeat(point[None], len(triangles), axis=0)
    nearest = trimesh.triangles.closest_point(triangles, points)
    return float(np.linalg.norm(nearest - point, axis=1).min())


def test_two_wrong_pairs_of_eight_are_named_and_the_camera_holds(app, toy_document):
    driver, mesh = app.driver, toy_document.mesh
    true = toy_document.photos[0].camera
    places = places_to_click(app, true, 8)
    # Two points that somebody mistook: a tenth of the photo aside, clear of the others.
    for i in (2, 6):
        others = np.array([at for j, (_, at) in enumerate(places) if j != i])
        wrong = places[i][1] + [(16, 5), (16, -5), (-16, 5), (-16, -5)]
        clear = np.linalg.norm(wrong[:, None] - others[None], axis=2).min(axis=1)
        places[i] = (places[i][0], wrong[int(np.argmax(clear))])
    click_pairs(app, places)
    driver.click("Solve")
    wait_until(lambda: app.state.undo_name == "Solve camera 1", "it is solved", 30)
    error = projection_error(mesh, [true], [entry_of(app).camera]).mean
    assert error < 1.5, f"{error:.2f} px off"
    driver.page.get_by_text("Pairs 3 and 7 do not fit").wait_for()
    expect(driver.page.get_by_text("does not fit", exact=True)).to_have_count(2)

    def marked_wrong() -> list[int]:
        balls = dict(app.page.scene.markers._balls)
        return [n for n, ball in sorted(balls.items()) if ball.color == WRONG]

    wait_until(lambda: marked_wrong() == [3, 7], "their markers tell it too", 30)


def test_a_mask_is_painted_with_the_mouse_and_undone(app):
    driver, before = app.driver, app.state.document
    driver.page.get_by_role("button", name="Mask", exact=True).click()
    start, end = in_picker(driver, (40, 60)), in_picker(driver, (100, 60))
    driver.drag((start[0], start[1]), (end[0] - start[0], 0.0))
    wait_until(
        lambda: app.state.undo_name == "Paint the mask of photo 1", "it is painted", 30
    )
    png = entry_of(app).mask_png
    assert png is not None
    mask = decode_mask(png)
    assert not mask[60, 42:98].any(), "left out along the stroke"
    assert mask[:20].all()
    assert mask[100:].all(), "and nowhere else"
    driver.page.get_by_role("button", name="Bring back", exact=True).click()
    driver.drag((start[0], start[1]), (end[0] - start[0], 0.0))
    wait_until(lambda: entry_of(app).mask_png is None, "all counts again", 30)
    driver.page.keyboard.press("Control+z")
    wait_until(lambda: entry_of(app).mask_png == png, "undo brings the mask back", 30)
    driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is before, "and then takes it away", 30)
    driver.page.get_by_role("button", name="Points", exact=True).click()


def test_a_mask_is_loaded_from_a_picture_of_the_photo_s_shape(app, tmp_path):
    picture = np.zeros((120, 160), np.uint8)
    picture[:, 80:] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), picture)
    cv2.imwrite(str(tmp_path / "square.png"), picture[:, :120])
    before = app.state.document

    def load(name: str) -> None:
        with app.driver.page.expect_file_chooser() as chooser:
            app.driver.click("Load a mask")
        chooser.value.set_files(tmp_path / name)

    load("square.png")
    app.driver.page.get_by_text("the shapes should be the same").wait_for()
    assert app.state.document is before
    load("mask.png")
    wait_until(lambda: app.state.undo_name == "Load the mask mask.png", "loaded", 30)
    assert (decode_mask(entry_of(app).mask_png) == (picture > 0)).all()


def test_points_of_the_other_photo_are_shown_as_crops_until_they_are_clicked(app):
    driver, page = app.driver, app.driver.page
    pairs = (
        PointPair(1, (0.1, 0.2, 0.3), (40.0, 30.0)),
        PointPair(2, (0.3, 0.1, 0.2), (100.0, 80.0)),
    )
    app.session.change("Points", with_entry(0, pairs=pairs))
    app.session.change(None, select(1))
    name = app.state.document.photos[0].name
    page.get_by_role("button", name="Take the other photo's points").click()
    first, second = (
        page.get_by_role("img", name=f"Point {n} in {name}") for n in (1, 2)
    )
    expect(first).to_be_visible()
    expect(second).to_be_visible()
    # Within the circle, the crop shows the pixel that was clicked.
    pixel = "c => [...c.getContext('2d').getImageData(c.width / 2, c.height / 2, 1, 1).data]"
    shown = np.array(first.evaluate(pixel)[:3], float)
    true = app.state.document.photos[0].photo.pixels[30, 40]
    assert np.abs(shown - true).max() < 40, (shown, true)
    driver.page.wait_for_function("() => photoreg.picker.ready()")
    page.mouse.click(*in_picker(driver, (70, 50)))
    expect(first).to_be_hidden()
    expect(second).to_be_visible()
