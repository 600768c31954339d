"""The app as the benches of the page hold it."""

import contextlib
from collections.abc import Iterator

from app.control.controller import Controller
from app.model.session import Session
from app.model.state import Document, State
from app.page.server import Page
from tests.browser.driver import wait_until


@contextlib.contextmanager
def served(
    document: Document | None = None,
) -> Iterator[tuple[Session, Controller, Page]]:
    """The app on a port of its own, its engine warm; ended afterwards."""
    session = Session(State(document=document or Document()))
    controller = Controller(session)
    page = Page(session, controller, port=0, shadows=False)
    try:
        wait_until(lambda: not session.state.worker, "the engine is warm", 300)
        yield session, controller, page
    finally:
        page.close()
        controller.close()
