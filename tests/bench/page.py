"""How quickly the page answers: a camera's move, on its way to everybody, and the cost."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from playwright.sync_api import Browser, sync_playwright

from app.engine.scene_opening import demo_folder, open_folder
from app.model.session import Session
from app.model.state import State
from app.panels.nudges import BY_NAME, Stepper
from tests.bench.metrics import Metric, Setting, bench, spread
from tests.bench.served import served
from tests.bench.wire import listening
from tests.browser.driver import FINE, Driver, launch, wait_until

N_MOVES = 20
_WATCH = """() => {
  const node = () => __viserMutable.nodeRefFromName['/cameras/0'];
  const place = () => node().position.toArray().join();
  window.bench = {last: place(), at: 0};
  setInterval(() => {
    const now = place();
    if (now !== bench.last) { bench.last = now; bench.at ||= Date.now(); }
  }, 3);
}"""
_LISTEN = """() => {
  const send = __viserMutable.sendMessage;
  window.bench = {sent: 0};
  __viserMutable.sendMessage = message => {
    if (message.type === 'ViewerCameraMessage') bench.sent ||= Date.now();
    send(message);
  };
}"""


@bench
def page(setting: Setting) -> Iterator[Metric]:
    """Latency in milliseconds, with the demo in two windows of software WebGL."""
    del setting
    with served(open_folder(demo_folder())) as (session, _, running):
        wait_until(lambda: session.state.agreement is not None, "a first measurement")
        yield from readouts("page.readout", session)
        address = f"http://127.0.0.1:{running.port}"
        watch = _Watch()
        with listening(address, watch.hear):
            yield from _on_the_wire(session, watch)
            with sync_playwright() as playwright:
                browser = launch(playwright)
                yield from _moves(session, browser, address, watch)
                browser.close()


class _Stamp:
    """The time of the first change of the state that ``happened`` accepts."""

    def __init__(
        self, session: Session, happened: Callable[[State, State], bool]
    ) -> None:
        self._event, self.at = threading.Event(), 0.0

        def listen(old: State, new: State) -> None:
            if not self._event.is_set() and happened(old, new):
                self.at = time.time()
                self._event.set()

        self._leave = session.listen(listen)

    def wait(self) -> float:
        """Waits for it; seconds since the epoch."""
        assert self._event.wait(30.0), "Waited 30 s in vain."
        self._leave()
        return self.at


class _Watch:
    """A browser that draws nothing: when the first camera's new place arrives there."""

    def __init__(self) -> None:
        self._arrived, self.at = threading.Event(), 0.0

    def hear(self, message: dict[str, Any]) -> None:
        """Takes one message of the page."""
        is_place = message["type"] == "SetPositionMessage"
        if is_place and message["name"] == "/cameras/0" and not self._arrived.is_set():
            self.at = time.time()
            self._arrived.set()

    def begin(self) -> None:
        """From now on the next one counts."""
        self._arrived.clear()

    def wait(self) -> float:
        """Waits for it; seconds since the epoch."""
        assert self._arrived.wait(30.0), "Waited 30 s in vain."
        return self.at


def _on_the_wire(session: Session, watch: _Watch) -> Iterator[Metric]:
    """From a camera's change to a browser that draws nothing, where none draws."""
    stepper, taken = Stepper(session), []
    wait_until(lambda: watch.at > 0.0, "the listener has the scene")
    for i in range(N_MOVES):
        time.sleep(0.2)
        watch.begin()
        began = time.time()
        stepper.take(BY_NAME["left" if i % 2 else "right"], 3.0)
        taken.append(1e3 * (watch.wait() - began))
    note = "painting, and viser's windows of 17 ms; no browser draws"
    yield from spread("page.to_wire", taken, "ms", 100.0, tolerance=1.0, note=note)


def readouts(name: str, session: Session) -> Iterator[Metric]:
    """From a camera's change to the new number in the state."""
    stepper, taken = Stepper(session), []
    for i in range(N_MOVES):
        stamp = _Stamp(session, lambda old, new: new.agreement != old.agreement)
        began = time.time()
        stepper.take(BY_NAME["left" if i % 2 else "right"], 3.0)
        taken.append(1e3 * (stamp.wait() - began))
        # At the pace of a drag: the overlay is still being drawn when the next comes.
        time.sleep(0.05)
    yield from spread(name, taken, "ms", 100.0, tolerance=1.0)


def _moves(
    session: Session, browser: Browser, address: str, watch: _Watch
) -> Iterator[Metric]:
    """From the wheel in one window to the state, and to the frustum in the other."""
    windows = [
        Driver(
            browser.new_page(viewport={"width": 1100, "height": 700}),
            address,
            FINE,
            still=False,
        )
        for _ in range(2)
    ]
    for window in windows:
        window.dismiss_toasts()
        window.tab("2 Align")
    one, other = windows
    one.choose("View", "Move the camera")
    one.frames(20)
    one.page.evaluate(_LISTEN)
    other.page.evaluate(_WATCH)
    box = one.canvas()
    one.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    to_state, answers, relays, to_other = [], [], [], []
    for i in range(N_MOVES):
        one.frames(4)
        other.frames(4)
        one.page.evaluate("() => { bench.sent = 0; }")
        other.page.evaluate("() => { bench.at = 0; }")
        stamp = _Stamp(session, lambda old, new: new.document is not old.document)
        watch.begin()
        began = time.time()
        one.page.mouse.wheel(0, 100 if i % 2 else -100)
        changed = stamp.wait()
        to_state.append(1e3 * (changed - began))
        sent = float(one.page.evaluate("() => bench.sent"))
        answers.append(1e3 * changed - sent)
        relays.append(1e3 * watch.wait() - sent)
        seen = other.page.wait_for_function("() => bench.at").json_value()
        to_other.append(float(seen) - 1e3 * began)
    note = "software WebGL, mostly the frames of the browsers"
    yield from spread("page.to_state", to_state, "ms", None, tolerance=1.0, note=note)
    own = "the server's part: from the browser's message to the state"
    yield from spread("page.answer", answers, "ms", 50.0, tolerance=1.0, note=own)
    ours = "from the browser's message to one that draws nothing: all that is ours"
    yield from spread("page.relay", relays, "ms", 100.0, tolerance=1.0, note=ours)
    yield from spread("page.to_other", to_other, "ms", None, tolerance=1.0, note=note)
