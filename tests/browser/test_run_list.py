"""Runs that have ended: looked at, compared, restored, and told in a report."""

import re

import pytest

from app.model.reducers import has_moved
from app.model.session import looking_at
from photoreg.words import in_words, number
from tests.browser.driver import wait_until
from tests.browser.refine_runs import QUICK, drop, open_to_refine, start, to_its_end


@pytest.fixture(scope="module")
def app(open_app_once):
    """One app with two runs in its list."""
    app = open_to_refine(open_app_once)
    for _ in range(2):
        start(app, QUICK, hold=False)
        to_its_end(app)
        drop(app)
    return app


def choose(app, dropdown: str, option: str) -> None:
    """Chooses of a dropdown what begins like this."""
    window = app.driver.page
    window.get_by_label(dropdown, exact=True).locator("visible=true").click()
    # The options of other dropdowns are in the page too, unseen.
    options = window.get_by_role("option", name=re.compile(f"^{option}"))
    options.locator("visible=true").click()


def test_a_run_of_the_list_is_looked_at_compared_and_restored(app):
    document, runs = app.state.document, app.state.runs
    first = next(run for run in runs if has_moved(run) and run.cost is not None)
    other = next(run for run in reversed(runs) if run is not first and has_moved(run))
    window = app.driver.page
    window.get_by_text("Runs", exact=True).click()
    app.driver.frames(2)
    row = window.get_by_role("row").filter(
        has=window.get_by_role("cell", name=str(first.number), exact=True).first
    )
    shown = row.first.inner_text().split("\t")
    assert first.config is not None
    assert shown[:3] == [str(first.number), first.settings_name, str(first.config.seed)]
    assert shown[3] == number(first.cost)
    assert shown[5] == in_words(first.elapsed_s)
    choose(app, "Run", f"{first.number}: ")
    app.driver.click("Look at it")
    wait_until(lambda: app.state.run.number == first.number, "it is on screen")
    choose(app, "Compare with", f"{other.number}: ")
    wait_until(lambda: app.state.compared_with == other.number, "it is compared")
    window.get_by_text(f"run {other.number}", exact=True).first.wait_for()
    app.driver.click("Accept")
    wait_until(lambda: app.state.undo_name == "Refine", "its cameras are taken")
    for entry, camera in zip(app.state.document.photos, first.cameras, strict=True):
        assert entry.camera is camera
    app.driver.click("Undo: Refine")
    wait_until(lambda: app.state.document is document, "undo takes it back")


def test_the_report_swipes_without_a_server_and_loads_nothing(app, chromium, tmp_path):
    last = next(run for run in reversed(app.state.runs) if has_moved(run))
    app.session.change(None, looking_at(last.number))
    wait_until(lambda: app.state.comparison is not None, "it is drawn")
    with app.driver.page.expect_download() as download:
        app.driver.click("Download report")
    path = tmp_path / "report.html"
    download.value.save_as(path)
    drop(app)
    context = chromium.new_context(offline=True)
    try:
        page, asked = context.new_page(), []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_load_state("load")
        line = page.locator(".pr-swipe input").first
        line.scroll_into_view_if_needed()
        box = line.bounding_box()
        assert box is not None
        shown = page.screenshot()
        page.mouse.click(box["x"] + 0.2 * box["width"], box["y"] + 0.5 * box["height"])
        place = line.evaluate("e => e.parentNode.style.getPropertyValue('--x')")
        assert 15.0 < float(place.removesuffix("%")) < 25.0, place
        assert page.screenshot() != shown, "the line moves"
        n_pictures = page.evaluate(
            "() => [...document.images].filter(i => i.naturalWidth > 50).length"
        )
        assert n_pictures == 8, "before and after, and two heat maps, of each photo"
        foreign = [url for url in asked if not url.startswith("data:")]
        assert foreign == [path.as_uri()]
    finally:
        context.close()
