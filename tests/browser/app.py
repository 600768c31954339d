"""The running app as the tests hold it."""

import dataclasses

from app.control.controller import Controller
from app.model.session import Session
from app.model.state import State
from app.page.server import Page
from tests.browser.driver import Driver


@dataclasses.dataclass
class App:
    """The running app, from both sides: its state, and the page a person sees."""

    session: Session
    controller: Controller
    page: Page
    driver: Driver

    @property
    def state(self) -> State:
        return self.session.state
