"""In Chromium: whatever words a project brings, they are read and never run."""

import dataclasses

import pytest

from app.control.controller import Controller
from app.model.session import Session
from app.model.state import State
from app.page.server import Page
from tests.app.model.hostile_words import hostile_states
from tests.browser.driver import Driver, wait_until


@pytest.fixture(scope="module")
def shown(chromium):
    """The app with hostile words everywhere, a browser on it, and what that complained of."""
    states = hostile_states()
    session = Session(State(document=states[0].document))
    controller = Controller(session, warm_up=False)
    page = Page(session, controller, port=0, shadows=False, surroundings=False)
    window = chromium.new_page(viewport={"width": 1100, "height": 700})
    said: list[str] = []
    window.on("console", lambda message: said.append(message.text))
    window.on("pageerror", lambda error: said.append(str(error)))
    driver = Driver(window, f"http://127.0.0.1:{page.port}")
    yield session, driver, said, states
    window.close()
    page.close()
    controller.close()


def is_unharmed(driver: Driver) -> bool:
    return driver.page.evaluate(
        """() => window.hacked === undefined
          && !document.querySelector('img[src=x], iframe, [onclick], [onerror]')
          && ![...document.scripts].some((s) => s.text.startsWith('window.hacked'))"""
    )


def test_hostile_words_are_shown_and_never_run(shown):
    session, driver, said, states = shown
    driver.page.wait_for_function("() => window.photoreg?.files")
    for state in states:
        session.change(None, lambda _, state=state: state)
        driver.frames(1)
        for tab in ("2 Align", "3 Refine", "4 Export", "Points", "Overlay", "1 Data"):
            driver.tab(tab)
            assert is_unharmed(driver)
    names = driver.page.locator(".pr-name")
    assert "<img src=x" in names.first.inner_text(), "the words are there, as words"
    broken = [text for text in said if "Content Security Policy" in text]
    assert broken == [], "our own page keeps its policy"


def test_clicks_tell_the_server_what_was_clicked_however_it_is_called(shown):
    session, driver, _, states = shown
    changeable = dataclasses.replace(states[0], read_only="")
    session.change(None, lambda _: changeable)
    driver.tab("1 Data")
    second = driver.page.locator("[data-photo]").nth(1)
    second.get_by_text("In use", exact=True).wait_for()
    driver.frames(3)  # What is drawn anew under a click loses it.
    second.click()
    wait_until(lambda: session.state.selected == 1, "the second photo is selected")
    second.get_by_text("In use", exact=True).click()
    wait_until(lambda: not session.state.document.photos[1].enabled, "it is left out")
    assert session.state.selected == 1, "only the innermost of what was clicked counts"
    assert is_unharmed(driver)


@pytest.mark.errors("Content Security Policy", "404")
def test_script_in_an_attribute_does_not_run_even_where_it_gets_in(shown):
    """The policy, should escaping fail once."""
    _, driver, said, _ = shown
    assert driver.page.evaluate(
        """() => new Promise((done) => {
          const box = document.createElement('div');
          box.innerHTML = `<img src=x onerror="window.ran=1">`;
          box.firstChild.addEventListener('error', () => setTimeout(done, 0, !window.ran));
          document.body.append(box);
        })"""
    )
    assert any("Content Security Policy" in text for text in said)
