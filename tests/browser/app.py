"""The running app as the tests hold it."""

import dataclasses

from app.conductor import Conductor
from app.server import Page
from app.session import Session
from app.state import State
from tests.browser.driver import Driver


@dataclasses.dataclass
class App:
    """The running app, from both sides: its state, and the page a person sees."""

    session: Session
    conductor: Conductor
    page: Page
    driver: Driver

    @property
    def state(self) -> State:
        return self.session.state
