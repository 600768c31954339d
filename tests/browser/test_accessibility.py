"""axe-core over every tab, dark and light: nothing serious but in viser's own elements."""

from collections.abc import Callable
from importlib import resources

import pytest
from playwright.sync_api import Page, expect

from app.model.session import setting
from app.model.state import Document
from tests.browser.app import App
from tests.browser.conftest import OpenApp
from tests.browser.driver import Driver, wait_until

OF_VISER: dict[str, str] = {}
"""Rule and selector of what viser itself has wrong and the page does not mend."""


@pytest.fixture(scope="module")
def app(open_app_once: OpenApp, toy_document: Document) -> App:
    app = open_app_once(toy_document)
    # Tall, so that all of a tab is on screen.
    app.driver.page.set_viewport_size({"width": 1280, "height": 1500})
    app.driver.dismiss_toasts()
    axe = resources.files("axe_playwright_python") / "axe.min.js"
    app.driver.page.evaluate(axe.read_text())
    return app


def serious(page: Page, theme: str) -> list[str]:
    # What is there is the same in both themes; only its colours differ.
    rules = {} if theme == "dark" else {"runOnly": ["color-contrast"]}
    options = {"resultTypes": ["violations"], **rules}
    found = page.evaluate(
        "async options => (await axe.run(document, options)).violations", options
    )
    return [
        f"{rule['id']}: {node['target']} {node['html'][:200]} {node['failureSummary']}"
        for rule in found
        if rule["impact"] in ("serious", "critical")
        for node in rule["nodes"]
        if OF_VISER.get(rule["id"], "\0") not in str(node["target"])
    ]


def look_through(driver: Driver) -> None:
    driver.tab("2 Align")
    driver.choose("View", "Look through")


PLACES: dict[str, Callable[[Driver], object]] = {
    "1 Data": lambda driver: driver.tab("1 Data"),
    "2 Align": lambda driver: driver.tab("2 Align"),
    "2 Align, looking through": look_through,
    "3 Refine": lambda driver: driver.tab("3 Refine"),
    "4 Export": lambda driver: driver.tab("4 Export"),
    "Points": lambda driver: driver.tab("Points"),
    "Overlay": lambda driver: driver.tab("Overlay"),
    "Help": lambda driver: driver.page.keyboard.press("?"),
}


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_axe_finds_nothing_serious_in_any_tab(app: App, theme: str):
    page, found = app.driver.page, []
    app.session.change(None, setting(dark=theme == "dark"))
    page.wait_for_function(
        "theme => document.documentElement.dataset.mantineColorScheme === theme",
        arg=theme,
    )
    for place, go in PLACES.items():
        go(app.driver)
        app.driver.frames(2)
        # Names come a moment after what they name.
        wait_until(
            lambda: not page.query_selector("img:not([alt])"), "all is named", 20
        )
        page.wait_for_timeout(300)
        found += [f"{place}, {theme}: {what}" for what in serious(page, theme)]
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    app.driver.tab("2 Align")
    app.driver.choose("View", "3-D scene")
    assert not found, "\n".join(found)


def test_folds_are_reached_by_tab_and_opened_by_enter(app: App):
    page = app.driver.page
    app.driver.tab("2 Align")
    fold = page.get_by_role("button", name="Numbers", exact=True)
    expect(fold).to_have_attribute("aria-expanded", "false")
    page.get_by_role("slider", name="Zoom, same size").focus()
    for _ in range(3):
        page.keyboard.press("Tab")
        if page.evaluate("() => document.activeElement.ariaExpanded === 'false'"):
            break
    expect(fold).to_be_focused()
    page.keyboard.press("Enter")
    expect(fold).to_have_attribute("aria-expanded", "true")
    expect(page.get_by_label("Focal, px")).to_be_visible()
    page.keyboard.press(" ")
    expect(fold).to_have_attribute("aria-expanded", "false")
