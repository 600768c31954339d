"""A browser for all tests, and the app with a page on it."""

import logging
import re
from collections.abc import Iterator
from typing import Protocol

import pytest
from playwright.sync_api import Browser, sync_playwright

from app.control.controller import Controller
from app.engine.warm_up import toy_scene
from app.model.session import Session
from app.model.state import Document, PhotoEntry, State
from app.page.server import Page
from tests.browser.app import App
from tests.browser.driver import (
    COARSE,
    COMPLAINTS,
    PANELS_WITHOUT_GL,
    Driver,
    launch,
)


class OpenApp(Protocol):
    """Starts the app on a document and opens a window on it."""

    def __call__(self, document: Document, pixel_ratio: float = COARSE) -> App: ...


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = launch(playwright, PANELS_WITHOUT_GL)
        yield browser
        browser.close()


OF_VISER = (r"ERR_FILE_NOT_FOUND \(blob:",)
"""Complaints about viser's own: it takes a picture's address back when the next one comes,
read or not."""


@pytest.fixture(autouse=True)
def nothing_goes_wrong_unseen(
    request: pytest.FixtureRequest, caplog: pytest.LogCaptureFixture
) -> Iterator[None]:
    """Fails where a page's console or the server's log had an error that none expected.

    ``pytest.mark.errors(pattern, ...)`` names those that a test provokes.
    """
    COMPLAINTS.clear()
    yield
    logged = [
        record.getMessage()
        for record in caplog.get_records("call")
        if record.levelno >= logging.ERROR
    ]
    marks = request.node.iter_markers("errors")
    expected = [*OF_VISER, *(pattern for mark in marks for pattern in mark.args)]
    found = [
        text
        for text in (*COMPLAINTS, *logged)
        if not any(re.search(pattern, text) for pattern in expected)
    ]
    assert not found, "\n".join(found)


def _opening(chromium: Browser) -> Iterator[OpenApp]:
    running: list[App] = []

    def start(document: Document, pixel_ratio: float = COARSE) -> App:
        session = Session(State(document=document))
        controller = Controller(session, warm_up=False)
        page = Page(session, controller, port=0, shadows=False, surroundings=False)
        window = chromium.new_page(viewport={"width": 1100, "height": 700})
        driver = Driver(window, f"http://127.0.0.1:{page.port}", pixel_ratio)
        running.append(App(session, controller, page, driver))
        return running[-1]

    yield start
    for app in running:
        app.driver.page.close()
        app.page.close()
        app.controller.close()


@pytest.fixture
def open_app(chromium: Browser) -> Iterator[OpenApp]:
    """Starts the app on a document and opens a small window on it."""
    yield from _opening(chromium)


@pytest.fixture(scope="module")
def open_app_once(chromium: Browser) -> Iterator[OpenApp]:
    """The same for an app that the tests of one file share."""
    yield from _opening(chromium)


@pytest.fixture(scope="session")
def toy_document() -> Document:
    """A small rock and two photos of 160 x 120 px: quick to draw and to refine."""
    mesh, photos, cameras = toy_scene()
    return Document(mesh, mesh, tuple(map(PhotoEntry, photos, cameras)))
