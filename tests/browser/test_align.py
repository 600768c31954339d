"""Every way to place a camera, with real mouse and keyboard; two browsers on one app."""

import dataclasses

import numpy as np
import pytest
from playwright.sync_api import expect

from app.model.camera_numbers import film_mm
from app.model.session import select, setting, with_document
from app.panels.view import MODES
from app.web.styles import THROUGH_STYLES
from photoreg.geometry.camera import same_camera
from tests.browser.driver import Driver, wait_until


@pytest.fixture(scope="module")
def running(open_app_once, toy_document):
    """One app for the tests of this file; it takes seconds to start."""
    return open_app_once(toy_document)


@pytest.fixture
def app(running, toy_document):
    """The app as it was opened: the document, the free view, the Align tab."""
    session = running.session
    session.change("Open", with_document(photos=toy_document.photos))
    session.change(None, setting(gizmo="move", through_style="surface"))
    session.change(None, select(0))
    running.driver.dismiss_toasts()
    running.driver.tab("2 Align")
    running.driver.rest()
    yield running
    running.driver.choose("View", "3-D scene")
    running.driver.frames(2)


@pytest.fixture
def second(running, chromium):
    """Another browser on the same app."""
    window = chromium.new_page(viewport={"width": 900, "height": 620})
    driver = Driver(window, f"http://127.0.0.1:{running.page.port}")
    driver.dismiss_toasts()
    driver.tab("2 Align")
    yield driver
    window.close()


def camera_of(app, index=0):
    return app.state.document.photos[index].camera


def on_screen(driver: Driver, point: np.ndarray) -> np.ndarray:
    """Window pixels of a point in the page's axes."""
    position, rotation, view_rad = driver.viewport_camera()
    canvas = driver.canvas()
    focal = 0.5 * canvas["height"] / np.tan(0.5 * view_rad)
    x, y, depth = rotation.T @ (point - position)
    middle = (canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2)
    return focal * np.array([x, y]) / depth + middle


def wait_for_view(app, driver: Driver, index: int = 0) -> None:
    def off() -> float:
        driver.frames(1)
        centre = app.page.scene.frame.to_page(camera_of(app, index).center)
        return float(np.abs(driver.viewport_camera()[0] - centre).max())

    wait_until(lambda: off() < 3e-3, "the view is the camera's", 60)


def wait_for_step(app, name: str) -> None:
    wait_until(lambda: app.state.undo_name == name, f"a step called {name}", 30)


def undo(app, before) -> None:
    app.driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is before, "one step back undoes all", 30)


def test_an_arc_of_the_orbit_gizmo_carries_the_camera_around_the_object(app):
    driver, before = app.driver, app.state.document
    driver.choose("Handles", "Around the object")
    wait_until(
        lambda: app.page.scene.gizmos.orbit.visible, "the orbit gizmo is shown", 20
    )
    driver.frames(6)
    # The arc about upwards lies in the plane of the first and third axis.
    axes = app.page.scene.gizmos.orbit_rest
    position, _, view_rad = driver.viewport_camera()
    unit = np.linalg.norm(position) * np.tan(0.5 * view_rad) * 2
    unit /= driver.canvas()["height"]  # Page units of a pixel, at the object.
    radius = 0.65 * app.page.scene.gizmos.orbit.scale * unit
    places = [
        radius * (np.cos(a) * axes[:, 0] + np.sin(a) * axes[:, 2])
        for a in np.radians((45.0, 65.0))
    ]
    start, end = (on_screen(driver, place) for place in places)
    driver.drag(tuple(start), tuple(end - start))
    wait_for_step(app, "Orbit camera 1")
    driver.frames(5)
    centre = app.state.document.mesh.bounds.mean(axis=0)
    old, new = before.photos[0].camera, camera_of(app)
    distances = [np.linalg.norm(c.center - centre) for c in (old, new)]
    assert distances[1] == pytest.approx(distances[0], rel=1e-6), "an exact circle"
    assert new.project(centre[None]) == pytest.approx(
        old.project(centre[None]), abs=1e-3
    ), "the object keeps its place in the photo"
    cosine = (old.center - centre) @ (new.center - centre) / np.prod(distances)
    assert 3.0 < np.degrees(np.arccos(cosine)) < 60.0
    undo(app, before)


def test_an_arc_of_the_move_gizmo_turns_the_camera_in_its_place(app):
    driver, before = app.driver, app.state.document
    driver.frames(6)
    axes, centre = app.page.scene.frame.pose(camera_of(app))
    position, rotation, view_rad = driver.viewport_camera()
    unit = (rotation.T @ (centre - position))[2] * np.tan(0.5 * view_rad) * 2
    unit /= driver.canvas()["height"]  # Page units of a pixel, at the camera.
    radius = 0.65 * app.page.scene.gizmos.move.scale * unit
    # The arc that is seen most from the front is the easiest to take.
    toward = (position - centre) / np.linalg.norm(position - centre)
    i = int(np.argmax(np.abs(axes.T @ toward)))
    first, second = axes[:, (i + 1) % 3], axes[:, (i + 2) % 3]
    places = [
        centre + radius * (np.cos(a) * first + np.sin(a) * second)
        for a in np.radians((45.0, 70.0))
    ]
    start, end = (on_screen(driver, place) for place in places)
    driver.drag(tuple(start), tuple(end - start))
    wait_for_step(app, "Move camera 1")
    driver.frames(5)
    old, new = before.photos[0].camera, camera_of(app)
    moved = np.abs(new.center - old.center).max() * app.page.scene.frame.scale
    assert moved < 1e-6, f"an arc turns only, and does not move by {moved}"
    turn = new.R_cam_world @ old.R_cam_world.T
    angle = np.degrees(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
    assert 3.0 < angle < 60.0, f"turned by {angle:.1f} degrees"
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], 0.0])
    axis[2] = turn[1, 0] - turn[0, 1]
    assert np.abs(axis[i]) / np.linalg.norm(axis) > 0.999, "about one axis of its own"
    undo(app, before)


def test_the_wheel_in_move_brings_the_camera_nearer_on_its_own_axis(app):
    driver, before = app.driver, app.state.document
    driver.choose("View", "Move the camera")
    wait_for_view(app, driver)
    canvas = driver.canvas()
    driver.page.mouse.move(
        canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2
    )
    driver.page.mouse.wheel(0, -100)
    wait_for_step(app, "Move camera 1")
    wait_for_view(app, driver)
    old, new = before.photos[0].camera, camera_of(app)
    way = old.R_cam_world @ (new.center - old.center)
    assert way[2] > 0.0, "nearer"
    assert np.abs(way[:2]).max() < 1e-3 * way[2], f"straight ahead, not {way}"
    assert np.abs(new.R_cam_world - old.R_cam_world).max() < 1e-6
    undo(app, before)


def test_the_view_that_is_active_is_marked(app):
    driver, (viewport,) = app.driver, app.page._viewports.values()
    row = driver.page.get_by_role("radiogroup", name="View", exact=True)
    for label in ("Look through", "3-D scene", "Move the camera", "3-D scene"):
        driver.choose("View", label)
        assert MODES[viewport.mode].label == label
        driver.frames(10)  # Until nothing else has the page painted anew.
        expect(row.get_by_role("radio", checked=True)).to_have_text([label])


def test_a_report_from_before_the_view_was_there_moves_no_camera(app):
    (viewport,), before = app.page._viewports.values(), app.state.document
    with viewport._lock:  # Nothing is painted meanwhile.
        viewport.choose("move")
        viewport._on_camera(viewport.client.camera)
    assert app.state.document is before
    wait_for_view(app, app.driver)
    assert app.state.document is before


def test_what_lies_over_the_photo_is_chosen_in_the_page(app):
    driver, scene = app.driver, app.page.scene
    driver.choose("View", "Look through")
    wait_for_view(app, driver)
    wait_until(lambda: "/through/photo" in nodes(driver), "the photo stands there", 30)
    seen = {}
    for style, option in THROUGH_STYLES.items():
        driver.choose("Show", option.label)
        wait_until(lambda style=style: app.state.through_style == style, style, 20)
        if style == "wireframe":
            wait_until(lambda: scene._clear.wireframe, "drawn as wires", 20)
        if style == "lines":
            wait_until(lambda: "/clear/lines" in nodes(driver), "lines come", 60)
        if style in ("normals", "photo"):
            wait_until(lambda: pixels_of(app) not in seen.values(), "a picture", 60)
        seen[style] = pixels_of(app)
    assert seen["surface"] == seen["wireframe"] == seen["lines"], "the photo itself"
    assert len({seen["surface"], seen["normals"], seen["photo"]}) == 3


def pixels_of(app) -> bytes:
    """The picture that stands in the scene in *Look through*, as it was sent."""
    (viewport, *_) = app.page._viewports.values()
    return viewport._photo._plane.image._data


def test_inspect_zooms_at_the_cursor_and_pans_and_never_moves_the_camera(app):
    driver, before = app.driver, app.state.document
    driver.choose("View", "Look through")
    wait_for_view(app, driver)
    wait_until(lambda: "/through/photo" in nodes(driver), "the photo stands there", 30)
    driver.frames(6)
    camera, frame = camera_of(app), app.page.scene.frame
    mesh = app.state.document.mesh
    near = mesh.vertices[int(np.argmin(camera.to_camera(mesh.vertices)[:, 2]))]
    at = on_screen(driver, frame.to_page(near))
    view_before = driver.viewport_camera()[2]
    driver.page.mouse.move(*at)
    driver.page.mouse.wheel(0, -300)
    wait_until(
        lambda: driver.frames(1) is None and driver.viewport_camera()[2] < view_before,
        "the wheel zooms",
        30,
    )
    driver.frames(6)
    view = driver.viewport_camera()[2]
    zoom = np.tan(0.5 * view_before) / np.tan(0.5 * view)
    assert zoom == pytest.approx(2.0, rel=1e-6)
    moved = np.linalg.norm(on_screen(driver, frame.to_page(near)) - at)
    assert moved < 2.0, f"what was under the cursor went {moved:.2f} px"
    at = on_screen(driver, frame.to_page(near))
    canvas = driver.canvas()
    middle = (canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2)
    driver.drag(middle, (60.0, 25.0))
    driver.frames(6)
    panned = on_screen(driver, frame.to_page(near)) - at
    assert panned == pytest.approx([60.0, 25.0], abs=4.0), "the picture goes along"
    # Walking keys do not leave the camera; 0 shows the whole photo again.
    driver.page.keyboard.down("w")
    driver.frames(4)
    driver.page.keyboard.up("w")
    driver.page.keyboard.press("0")
    wait_until(
        lambda: (
            driver.frames(1) is None
            and abs(driver.viewport_camera()[2] - view_before) < 1e-6
        ),
        "the whole photo is shown again",
        30,
    )
    wait_for_view(app, driver)
    assert app.state.document is before, "inspecting must not move anything"


def nodes(driver: Driver) -> list[str]:
    return driver.page.evaluate("() => Object.keys(__viserMutable.nodeRefFromName)")


def test_tool_buttons_roll_and_nudge_and_go_on_while_held(app):
    driver, before = app.driver, app.state.document
    button = driver.page.get_by_role("button", name="Roll right (O)")
    box = button.bounding_box()
    assert box is not None
    driver.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    driver.page.mouse.down()

    def turned() -> float:
        R = camera_of(app).R_cam_world @ before.photos[0].camera.R_cam_world.T
        return float(np.degrees(np.arctan2(R[1, 0], R[0, 0])))

    wait_until(lambda: turned() > 1.4, "a held button goes on", 30)
    driver.page.mouse.up()
    driver.frames(4)
    steps = turned() / 0.25
    assert steps == pytest.approx(round(steps), abs=1e-6)
    assert app.state.undo_name == "Roll camera 1"
    undo(app, before)


def test_keys_nudge_finely_and_coarsely(app):
    driver, before = app.driver, app.state.document
    centre = before.mesh.bounds.mean(axis=0)[None]

    def way() -> float:
        now, then = (d.photos[0].camera for d in (app.state.document, before))
        return float(now.project(centre)[0, 0] - then.project(centre)[0, 0])

    step_px = 160 / 640
    for keys, steps in (("Shift+L", 10.0), ("Alt+l", 10.1), ("l", 11.1)):
        driver.page.keyboard.press(keys)
        wait_until(
            lambda steps=steps: abs(way() - steps * step_px) < 1e-6, f"{keys}", 20
        )
    undo(app, before)


def test_the_dolly_zoom_changes_the_lens_and_keeps_the_object_s_size(app):
    driver, before = app.driver, app.state.document
    centre = before.mesh.centroid

    def size(camera) -> float:
        return camera.focal_px / camera.to_camera(centre[None])[0, 2]

    for _ in range(3):
        driver.page.keyboard.press("f")
    old = before.photos[0].camera
    wait_until(
        lambda: abs(camera_of(app).focal_px / old.focal_px - 1.01**3) < 1e-9,
        "three steps longer",
        20,
    )
    assert size(camera_of(app)) == pytest.approx(size(old), rel=1e-9)
    assert app.state.undo_name == "Zoom camera 1, same size"
    undo(app, before)
    slider = driver.page.get_by_role("slider").first
    slider.focus()
    driver.page.keyboard.press("ArrowRight")
    wait_for_step(app, "Zoom camera 1, same size")
    assert size(camera_of(app)) == pytest.approx(size(old), rel=1e-9)
    assert film_mm(camera_of(app)) > film_mm(old)
    undo(app, before)


def test_numbers_typed_key_by_key_are_taken_or_refused_in_one_sentence(app):
    driver = app.driver
    if not driver.page.get_by_label("View angle, °").is_visible():
        driver.page.get_by_text("Numbers", exact=True).click()
    box = driver.page.get_by_label("View angle, °")
    box.click()
    driver.page.keyboard.press("Control+a")
    driver.page.keyboard.type("32.5", delay=60)
    wait_until(
        lambda: (
            abs(2 * np.arctan(80 / camera_of(app).focal_px) - np.radians(32.5)) < 1e-9
        ),
        "the angle is taken",
        20,
    )
    angled = camera_of(app)
    box = driver.page.get_by_label("Turn, tilt, roll").first
    box.click()
    driver.page.keyboard.press("Control+a")
    driver.page.keyboard.type("12", delay=60)
    # Key by key: the camera is turned by 1 degree before it is turned by 12.
    wait_until(
        lambda: abs(camera_of(app).R_cam_world[0, 2] + np.sin(np.radians(12))) < 1e-9,
        "the turn is taken",
        20,
    )
    assert app.state.undo_name == "Direction 1"
    assert camera_of(app).center == pytest.approx(angled.center), "on the spot"
    now = camera_of(app)
    box = driver.page.get_by_label("Principal point").first
    box.click()
    driver.page.keyboard.press("Control+a")
    driver.page.keyboard.type("99999", delay=30)
    driver.page.get_by_text("The principal point's x should be").wait_for()
    driver.page.get_by_label("Focal, px").click()
    app.driver.dismiss_toasts()
    assert abs(camera_of(app).K[0, 2]) <= 320
    assert np.array_equal(camera_of(app).R_cam_world, now.R_cam_world)


def test_photo_two_steps_aside_from_photo_one(app):
    driver = app.driver
    driver.choose("Photo", "2 · toy-1")
    if not driver.page.get_by_role("button", name="Reset this camera").is_visible():
        driver.page.get_by_text("Start over", exact=True).click()
    driver.click("Copy photo 1, step aside")
    wait_for_step(app, "Copy to camera 2")
    centre = app.state.document.mesh.bounds.mean(axis=0)
    a, b = (camera_of(app, i).center - centre for i in (0, 1))
    assert np.linalg.norm(a) == pytest.approx(np.linalg.norm(b))


def test_the_number_on_screen_follows_the_camera(app):
    driver = app.driver
    wait_until(lambda: app.state.agreement is not None, "it is measured", 60)
    first = app.state.agreement
    driver.page.get_by_text("of points seen by both").wait_for()
    for _ in range(2):
        driver.page.keyboard.press("Shift+L")
    wait_until(lambda: app.state.agreement != first, "it is measured anew", 30)


def test_the_help_opens_and_closes_by_the_question_mark(app):
    page = app.driver.page
    page.keyboard.press("Shift+?")
    page.get_by_text("zoom in, out; the object keeps its size").wait_for()
    page.get_by_role("button", name="Close", exact=True).click()
    page.get_by_text("zoom in, out; the object keeps its size").wait_for(
        state="detached"
    )


@pytest.mark.slow
def test_a_second_browser_sees_the_move_and_nothing_fights(app, second):
    first, before = app.driver, app.state.document
    first.choose("View", "Move the camera")
    wait_for_view(app, first)
    second.choose("View", "Move the camera")
    wait_for_view(app, second)
    # One hand orbits; the other browser's view follows to the very pose.
    canvas = first.canvas()
    middle = (canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2)
    first.drag(middle, (30.0, 10.0))
    wait_for_step(app, "Move camera 1")
    wait_for_view(app, second)
    settled = camera_of(app)
    for driver in (first, second):
        driver.frames(10)
    assert same_camera(camera_of(app), settled), "the follower must not move it back"
    # While one browser has the camera in its hand, the other cannot pull at it.
    owner = next(
        number for number, v in app.page._viewports.items() if v.mode == "move"
    )
    assert app.page._claims.take(owner, 0, 60.0)
    canvas = second.canvas()
    middle = (canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2)
    second.drag(middle, (40.0, 0.0))
    second.page.get_by_text("is being moved in another browser").wait_for()
    assert same_camera(camera_of(app), settled)
    app.page._claims.drop(owner)
    second.choose("View", "3-D scene")
    undo(app, before)


def test_all_commands_find_the_buttons_of_every_tab(app):
    driver = app.driver
    driver.tab("1 Data")
    commands = {
        button.label: command for button, command in app.page._button_commands._commands
    }
    assert commands["Accept"].disabled, "there is nothing to accept"
    driver.command("Reset this camera")
    wait_until(lambda: app.state.undo_name == "Reset camera 1", "it is pressed", 30)
    driver.tab("2 Align")


def test_units_are_chosen_and_survey_coordinates_are_read_whole(app, toy_document):
    driver, page = app.driver, app.driver.page
    mesh = toy_document.mesh
    # A find of some centimetres in a national grid, in metres.
    scale = 0.05 / mesh.diagonal
    offset = np.array([431250.123, 5411800.456, 87.25])
    far = dataclasses.replace(mesh, vertices=mesh.vertices * scale + offset)
    photos = []
    for entry in toy_document.photos:
        camera = entry.camera
        center = camera.center * scale + offset
        moved = dataclasses.replace(camera, t_cam_world=-camera.R_cam_world @ center)
        photos.append(dataclasses.replace(entry, camera=moved))
    app.session.change(
        "Open", with_document(mesh=far, display_mesh=far, photos=tuple(photos))
    )
    try:
        driver.tab("1 Data")
        driver.choose("Unit", "m")
        wait_until(lambda: app.state.undo_name == "Unit", "it is a step of undo")
        sides = " × ".join(f"{side:.3g}" for side in np.ptp(far.vertices, axis=0))
        expect(page.get_by_text(f"{sides} m", exact=False)).to_be_visible()
        driver.tab("2 Align")
        fields = page.locator(
            "div:has(> div > p > label:text-is('Position, m')) input:not([type=hidden])"
        )
        if not fields.first.is_visible():
            page.get_by_text("Numbers", exact=True).click()
        expect(fields).to_have_count(3)
        center = app.state.document.photos[0].camera.center
        for i, value in enumerate(center):
            expect(fields.nth(i)).to_have_value(f"{round(float(value), 3)}")
            is_whole = "e => e.scrollWidth <= e.clientWidth"
            assert fields.nth(i).evaluate(is_whole), fields.nth(i).input_value()
    finally:
        app.session.change(
            "Open",
            with_document(**{**vars(toy_document), "photos": toy_document.photos}),
        )
