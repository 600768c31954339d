"""The cards of the Data tab: select, name, order, use and remove, by mouse."""

import dataclasses

import pytest

from app.model.session import select, with_document
from tests.browser.driver import wait_until


@pytest.fixture(scope="module")
def app(open_app_once, toy_document):
    """One app for the tests of this file; it takes seconds to start."""
    app = open_app_once(toy_document)
    app.driver.dismiss_toasts()
    app.driver.tab("1 Data")
    return app


@pytest.fixture(autouse=True)
def _as_it_was(app, toy_document):
    app.session.change("Open", with_document(photos=toy_document.photos))
    app.session.change(None, select(0))
    app.driver.frames(2)


def names(app) -> list[str]:
    return [entry.name for entry in app.state.document.photos]


def wait_for_step(app, name: str) -> None:
    wait_until(lambda: app.state.undo_name == name, f"a step called {name}", 30)


def undo(app, before) -> None:
    app.driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is before, "one step back undoes it", 30)


def test_a_click_on_a_card_selects_its_photo(app):
    app.driver.click("Photo toy-1.png")
    wait_until(lambda: app.state.selected == 1, "the second is selected", 30)
    pressed = app.driver.page.locator('[data-photo="toy-1.png"] [aria-pressed=true]')
    pressed.wait_for()


def test_a_photo_is_renamed_in_its_card(app):
    before, page = app.state.document, app.driver.page
    app.driver.click("Rename toy-0.png")
    box = page.get_by_label("New name")
    box.fill("from the left.png")
    box.press("Enter")
    wait_for_step(app, "Rename toy-0.png")
    assert names(app) == ["from the left.png", "toy-1.png"]
    page.get_by_text("1. from the left.png").wait_for()
    app.driver.click("Rename from the left.png")
    page.get_by_label("New name").fill("toy-1.png")
    page.get_by_label("New name").press("Enter")
    page.get_by_text("There is a photo toy-1.png already").wait_for()
    assert names(app) == ["from the left.png", "toy-1.png"]
    undo(app, before)


def test_photos_are_moved_left_out_and_removed_each_as_one_step(app):
    before = app.state.document
    app.driver.click("Move toy-0.png down")
    wait_for_step(app, "Move toy-0.png in the list")
    assert names(app) == ["toy-1.png", "toy-0.png"]
    undo(app, before)
    app.driver.click("Leave out toy-1.png")
    wait_for_step(app, "Leave out toy-1.png")
    assert [entry.enabled for entry in app.state.document.photos] == [True, False]
    app.driver.click("Use toy-1.png")
    wait_for_step(app, "Use toy-1.png")
    app.driver.click("Remove toy-1.png")
    wait_for_step(app, "Remove toy-1.png")
    assert names(app) == ["toy-0.png"]
    app.driver.page.keyboard.press("Control+z")
    wait_until(lambda: len(names(app)) == 2, "it comes back", 30)


def test_a_card_tells_where_the_focal_length_came_from(app, toy_document):
    """EXIF while it is as loaded; no longer once somebody has changed it."""
    entry = toy_document.photos[0]
    focal_px = entry.camera.focal_px
    photo = dataclasses.replace(entry.photo, exif_focal_px=focal_px)
    told = dataclasses.replace(entry, photo=photo)
    photos = (told, toy_document.photos[1])
    app.session.change("Open", with_document(photos=photos))
    card = app.driver.page.locator('[data-photo="toy-0.png"]')
    card.get_by_text(f"f {focal_px:.0f} px, by EXIF").wait_for()
    K = entry.camera.K.copy()
    K[[0, 1], [0, 1]] *= 1.1
    camera = dataclasses.replace(entry.camera, K=K)
    moved = dataclasses.replace(told, camera=camera)
    app.session.change("Open", with_document(photos=(moved, toy_document.photos[1])))
    card.get_by_text(f"f {1.1 * focal_px:.0f} px").wait_for()
    assert "EXIF" not in card.inner_text()
