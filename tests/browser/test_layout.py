"""How the page keeps its shape, with real mouse and keyboard: what stays, folds and closes."""

import dataclasses

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from scipy.spatial.transform import Rotation

from app.model.camera_moves import orbited
from app.model.messages import CamerasFound
from app.model.reducers import found
from app.model.session import with_document
from app.model.state import Document, FoundCamera
from photoreg import __version__
from photoreg.synthetic.rock import rock_mesh
from tests.browser.app import App
from tests.browser.conftest import OpenApp
from tests.browser.driver import COARSE, Driver, wait_until

WIDE, MIDDLE, NARROW = (1280, 760), (1040, 760), (820, 1000)


@pytest.fixture(scope="module")
def running(open_app_once: OpenApp, toy_document: Document) -> App:
    photos = toy_document.photos
    truth = tuple((entry.name, entry.camera) for entry in photos)
    return open_app_once(dataclasses.replace(toy_document, truth=truth))


@pytest.fixture
def app(running: App, toy_document: Document) -> App:
    running.session.begin(dataclasses.replace(toy_document))
    resize(running.driver, WIDE)
    running.driver.tab("1 Data")
    running.driver.dismiss_toasts()
    return running


def resize(driver: Driver, size: tuple[int, int]) -> None:
    driver.page.set_viewport_size({"width": size[0], "height": size[1]})
    driver.frames(3)


def cameras_are_shown(driver: Driver) -> bool:
    driver.frames(2)
    return driver.page.evaluate(
        "() => __viserMutable.nodeRefFromName['/cameras'].visible"
    )


def test_all_is_framed_by_key_by_button_and_when_undo_brings_another_mesh(app):
    driver = app.driver
    wait_until(lambda: cameras_are_shown(driver), "the scene is there", 20)
    driver.rest()
    driver.page.keyboard.press("h")
    driver.rest()
    home = driver.viewport_camera()[0]

    def is_home() -> bool:
        driver.frames(2)
        return bool(np.abs(driver.viewport_camera()[0] - home).max() < 0.02)

    canvas = driver.canvas()
    middle = (canvas["x"] + 60, canvas["y"] + canvas["height"] - 60)
    for ask in (
        lambda: driver.page.keyboard.press("h"),
        lambda: driver.click("Frame all (H)"),
    ):
        driver.drag(middle, (90.0, -40.0))
        driver.rest()
        assert not is_home(), "the scene was turned"
        ask()
        wait_until(is_home, "all is framed again", 20)
    other = rock_mesh(5, subdivisions=2)
    app.session.change("Other", with_document(mesh=other, display_mesh=other))
    driver.drag(middle, (90.0, -40.0))
    driver.rest()
    driver.click("Undo: Other")
    wait_until(is_home, "the mesh of before is framed", 20)


def test_cameras_that_were_found_are_framed_where_nobody_has_turned_the_view(app):
    driver, document = app.driver, app.state.document
    mesh = document.mesh
    assert mesh is not None
    driver.rest()
    driver.page.keyboard.press("h")
    driver.rest()
    before = driver.viewport_camera()[0]

    def find(angle_deg: float) -> None:
        entry, turn = document.photos[0], Rotation.from_euler("y", angle_deg, True)
        turned = orbited(entry.camera, mesh.centroid, turn.as_matrix())
        one = FoundCamera(entry.name, "found", "", (turned,), ())
        event = CamerasFound((one,))
        app.session.change("Find the cameras", lambda state: found(state, event))

    find(150.0)

    def is_framed_anew() -> bool:
        driver.frames(2)
        return bool(np.abs(driver.viewport_camera()[0] - before).max() > 0.2)

    wait_until(is_framed_anew, "the view goes to where the cameras are", 20)
    driver.rest()
    canvas = driver.canvas()
    driver.drag((canvas["x"] + 60, canvas["y"] + canvas["height"] - 60), (90.0, -40.0))
    driver.rest()
    turned = driver.viewport_camera()[0]
    find(-60.0)
    driver.frames(10)
    driver.rest()
    assert np.abs(driver.viewport_camera()[0] - turned).max() < 0.02
    app.session.undo()
    app.session.undo()
    driver.page.keyboard.press("h")
    driver.rest()


def test_the_button_of_settings_shows_the_page_s_own_and_viser_s_lie_behind_them(app):
    driver, page = app.driver, app.driver.page
    driver.tab("2 Align")
    own = page.get_by_text("Dark page", exact=True)
    expect(own).to_be_hidden()
    driver.click("Settings of the page")
    expect(own).to_be_visible()
    expect(own).to_be_in_viewport()
    viser_s = page.get_by_text("Dev Settings")
    expect(viser_s).to_be_hidden()
    driver.click("Diagnostics")
    expect(viser_s).to_be_visible()
    driver.click("Back to the panels")
    expect(viser_s).to_be_hidden()
    expect(page.get_by_role("status")).to_be_in_viewport()
    page.get_by_role("button", name="Demo and page", exact=True).click()
    expect(own).to_be_hidden()


def test_cameras_are_hidden_by_a_key_and_by_themselves_where_the_model_is_exported(app):
    driver = app.driver
    wait_until(lambda: cameras_are_shown(driver), "they are there", 20)
    driver.page.keyboard.press("c")
    wait_until(lambda: not cameras_are_shown(driver), "the key hides them", 20)
    driver.page.keyboard.press("c")
    wait_until(lambda: cameras_are_shown(driver), "the key shows them", 20)
    driver.tab("4 Export")
    wait_until(lambda: not cameras_are_shown(driver), "Export hides them", 20)
    driver.click("Show or hide the cameras (C)")
    wait_until(lambda: cameras_are_shown(driver), "who wants them has them", 20)
    driver.tab("2 Align")
    driver.tab("4 Export")
    wait_until(lambda: not cameras_are_shown(driver), "hidden by itself again", 20)
    driver.tab("1 Data")
    wait_until(lambda: cameras_are_shown(driver), "elsewhere they are there", 20)


def test_status_undo_and_tabs_stay_while_the_panel_scrolls(app):
    page = app.driver.page
    stay = [
        page.get_by_role("status"),
        page.get_by_text("Photos agree"),
        page.get_by_role("button", name="Undo", exact=True),
        page.get_by_role("tab", name="2 Align"),
    ]

    def boxes() -> list[dict[str, float]]:
        found = [thing.bounding_box() for thing in stay]
        while None in found:  # It is just being painted anew.
            found = [thing.bounding_box() for thing in stay]
        return [dict(box) for box in found if box is not None]

    before = boxes()
    below = page.get_by_text("Project:", exact=False).first
    unscrolled = below.bounding_box()
    assert unscrolled is not None
    assert unscrolled["y"] >= before[3]["y"] + before[3]["height"], "nothing is covered"
    demo = page.get_by_text("Demo and page", exact=True)
    resize(app.driver, (WIDE[0], 420))
    demo.scroll_into_view_if_needed()
    assert [box["y"] for box in boxes()] == [box["y"] for box in before]
    # None of them lies over another, nor over what begins below them.
    edges = [box["y"] + box["height"] for box in before]
    tops = [box["y"] for box in before[1:]]
    assert all(edge <= top for edge, top in zip(edges, tops, strict=False)), before
    expect(demo).to_be_in_viewport()
    scrolled = page.evaluate(
        """() => Math.max(...[...document.querySelectorAll(
          '.mantine-ScrollArea-viewport')].map(v => v.scrollTop))"""
    )
    assert scrolled > 100, "the panel was scrolled"
    # What stays is not covered by what scrolls.
    box = before[3]
    on_top = page.evaluate(
        "([x, y]) => document.elementFromPoint(x, y).closest('[role=tab]')?.textContent",
        [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2],
    )
    assert on_top == "2 Align"


def test_on_narrow_screens_the_left_panel_folds_and_then_panels_lie_over_the_scene(app):
    driver, page = app.driver, app.driver.page
    style = page.get_by_role("radiogroup", name="Style", exact=True).first
    expect(style).to_be_visible()
    beside = driver.canvas()
    resize(driver, MIDDLE)
    expect(style).to_be_hidden()
    wait_until(lambda: driver.canvas()["width"] > 640, "the scene has its room", 20)
    assert driver.canvas()["width"] < MIDDLE[0] - 300, "beside the panel at the right"
    resize(driver, NARROW)
    wait_until(
        lambda: driver.canvas()["width"] == NARROW[0], "the scene is as wide as all", 20
    )
    expect(page.get_by_role("tab", name="3 Refine")).to_be_in_viewport()
    expect(style).to_be_hidden()
    resize(driver, WIDE)
    expect(style).to_be_visible()
    wait_until(
        lambda: driver.canvas() == beside, "both panels stand beside it as before", 20
    )


def test_a_small_window_that_opens_is_arranged_at_once(app, chromium: Browser):
    window = chromium.new_page(viewport={"width": NARROW[0], "height": NARROW[1]})
    driver = Driver(window, f"http://127.0.0.1:{app.page.port}", COARSE)
    wait_until(lambda: driver.canvas()["width"] == NARROW[0], "panels lie over it", 20)
    window.close()


def test_questions_are_left_by_escape_or_a_click_beside_and_answered_by_enter(app):
    page = app.driver.page
    page.get_by_text("Project:", exact=False).first.click()
    dialog = page.get_by_role("dialog")
    leave = (
        lambda: page.keyboard.press("Escape"),
        lambda: page.mouse.click(WIDE[0] / 2, WIDE[1] - 20),
    )
    for how in leave:
        app.driver.click("New project")
        name = dialog.get_by_label("Name")
        expect(name).to_be_focused()
        # Tab goes round in it, and never out.
        for _ in range(5):
            page.keyboard.press("Tab")
            assert page.evaluate(
                "() => document.activeElement.closest('[role=dialog]') !== null"
            )
        how()
        expect(dialog).to_have_count(0)
    assert app.state.project is None
    app.driver.click("New project")
    dialog.get_by_label("Name").fill("By Enter")
    page.keyboard.press("Enter")
    expect(dialog).to_have_count(0)
    wait_until(
        lambda: app.state.project is not None and app.state.project.name == "By Enter",
        "the project is made",
        20,
    )


def hint(page: Page, title: str):
    return page.get_by_role("dialog", name=title)


def test_the_tour_leads_through_the_tabs_once_and_again_from_the_help(
    running, app, toy_document, chromium: Browser
):
    truth = tuple((entry.name, entry.camera) for entry in toy_document.photos)
    app.session.begin(dataclasses.replace(toy_document, truth=truth))
    context = chromium.new_context(viewport={"width": 1100, "height": 700})
    window = context.new_page()
    address = f"http://127.0.0.1:{app.page.port}"
    Driver(window, address, COARSE, tour=True)
    for number, tab in enumerate(("1 Data", "2 Align", "4 Export", "3 Refine"), 1):
        card = hint(window, f"Hint {number} of 4")
        expect(card).to_be_in_viewport(ratio=1)
        expect(window.get_by_role("tab", name=tab, selected=True)).to_be_visible()
        next_one = card.get_by_role("button", name="Next" if number < 4 else "Got it")
        expect(next_one).to_be_focused()
        window.keyboard.press("Enter")
    expect(hint(window, "Hint")).to_have_count(0)
    window.close()
    # Who has seen it is not shown it again, but for asking.
    window = context.new_page()
    driver = Driver(window, address, COARSE, tour=True)
    window.wait_for_timeout(600)
    expect(hint(window, "Hint")).to_have_count(0)
    driver.frames(3)
    window.keyboard.press("?")
    expect(window.get_by_text(f"photoreg {__version__}", exact=False)).to_be_visible()
    window.get_by_role("button", name="Tour of the page", exact=True).click()
    expect(hint(window, "Hint 1 of 4")).to_be_visible()
    window.keyboard.press("Escape")
    expect(hint(window, "Hint")).to_have_count(0)
    context.close()
