"""Browsers that come to the page together, without a browser."""

import contextlib
import threading
import time
from typing import Any

import pytest

from app import server
from app.conductor import Conductor
from app.panel_view import ViewPanel
from app.server import Page
from app.session import Session
from tests.bench.wire import listening
from tests.browser.driver import wait_until

N_BROWSERS = 12


class UnhurriedPanel(ViewPanel):
    """Takes its time, so that others come while it is made."""

    def __init__(self, *arguments: Any) -> None:
        time.sleep(0.02)
        super().__init__(*arguments)


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path))
    monkeypatch.setattr(server, "ViewPanel", UnhurriedPanel)
    session = Session()
    conductor = Conductor(session)
    page = Page(session, conductor, port=0)
    yield page
    page.close()
    conductor.close()


def test_each_of_many_browsers_at_once_gets_its_own_choice_of_views(page, caplog):
    address = f"http://127.0.0.1:{page.port}"
    choices: list[set[str]] = [set() for _ in range(N_BROWSERS)]
    together = threading.Barrier(N_BROWSERS)
    over = threading.Event()

    def browse(mine: set[str]) -> None:
        def hear(message: dict[str, Any]) -> None:
            change = message.get("props", message.get("updates"))
            if 'aria-label="View"' in str(change):
                mine.add(message["uuid"])

        together.wait()
        with listening(address, hear):
            over.wait()

    browsers = [threading.Thread(target=browse, args=(mine,)) for mine in choices]
    for browser in browsers:
        browser.start()
    try:
        with contextlib.suppress(TimeoutError):
            wait_until(lambda: all(choices), "every browser can choose its view", 30)
    finally:
        over.set()
        for browser in browsers:
            browser.join()
    assert not [record.message for record in caplog.records]
    assert [len(mine) for mine in choices] == [1] * N_BROWSERS
