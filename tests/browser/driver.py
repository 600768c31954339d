"""Drives the page as a person would: waits for frames and states, never for time."""

import time
from collections.abc import Callable

import numpy as np
from playwright.sync_api import Browser, ConsoleMessage, Page, Playwright, expect

from tests.browser.ensure_chromium import find_chromium

FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
"""Software WebGL, said explicitly: no test may depend on a graphics card."""

PANELS_WITHOUT_GL = "--disable-gpu-compositing"
"""With software WebGL for the panels, too, drawing them takes half the time of a test. Not
where the page is measured."""

COARSE, FINE = 0.25, 1.0
"""Pixel ratio of the 3-D scene for tests that do not look at it, and for those that do and
what measures the page: drawing it in software at full size takes most of a test's time."""

_WAIT_FRAMES = """n => new Promise(done => {
  const m = __viserMutable, info = __viserTestpoints.rendererInfo.render;
  const first = info.frame;
  const look = () => {
    m.requestRender();
    (info.frame - first >= n && !m.messageQueue.length) ? done() : setTimeout(look, 20);
  };
  look();
})"""


class NoChromiumError(RuntimeError):
    """There is no Chromium to test with."""


def launch(playwright: Playwright, *flags: str) -> Browser:
    """Chromium with software WebGL: the system's, or playwright's own."""
    path = find_chromium()
    if path is None:
        raise NoChromiumError(
            "The browser tests need Chromium: install Debian's package `chromium`, or "
            "run `playwright install chromium`."
        )
    return playwright.chromium.launch(executable_path=path, args=[*FLAGS, *flags])


def wait_until(
    happened: Callable[[], object],
    what: str,
    timeout_s: float = 60.0,
    poll_s: float = 0.02,
) -> None:
    """Polls until ``happened()`` is true; fails with ``what`` after the timeout."""
    deadline = time.monotonic() + timeout_s
    while not happened():
        if time.monotonic() > deadline:
            raise AssertionError(f"Waited {timeout_s:g} s in vain: {what}.")
        time.sleep(poll_s)


COMPLAINTS: list[str] = []
"""Errors that pages said in their console since they were last looked at."""


def hear_complaints(page: Page) -> None:
    """Collects what the page's scripts, and what it asked the server for, failed at."""

    def on_console(said: ConsoleMessage) -> None:
        if said.type == "error":
            COMPLAINTS.append(f"{said.text} ({said.location.get('url', '')})")

    page.on("console", on_console)
    page.on("pageerror", lambda error: COMPLAINTS.append(str(error)))


class Driver:
    """One browser page on the app."""

    def __init__(
        self,
        page: Page,
        address: str,
        pixel_ratio: float = COARSE,
        still: bool = True,
        tour: bool = False,
    ) -> None:
        """``tour``: as who has never seen the page, and gets its hints on the demo."""
        self.page = page
        if not tour:
            # Empty pages, between two, have no storage.
            page.add_init_script(
                "if (origin !== 'null') localStorage.setItem('photoreg-tour', 'seen')"
            )
        hear_complaints(page)
        if still:
            page.emulate_media(reduced_motion="reduce")
        # Else viser lowers the ratio on a slow machine while one measures.
        page.goto(f"{address}/?fixedDpr={pixel_ratio:g}")
        page.wait_for_function(
            "() => window.__viserMutable?.requestRender"
            " && window.__viserTestpoints?.rendererInfo",
            timeout=60_000,
        )
        page.get_by_role("tab", name="1 Data").wait_for(timeout=60_000)
        self.frames(3)

    def frames(self, n: int = 3) -> None:
        """Waits until ``n`` more frames are drawn and all messages are handled."""
        self.page.evaluate(_WAIT_FRAMES, n)

    def rest(self) -> None:
        """Waits until the view no longer moves: it glides to where it is sent."""
        places: list[np.ndarray] = []

        def is_at_rest() -> bool:
            self.frames(5)
            places.append(self.viewport_camera()[0])
            return len(places) > 1 and np.array_equal(places[-1], places[-2])

        wait_until(is_at_rest, "the view comes to rest")

    def dismiss_toasts(self) -> None:
        """Closes the messages at the top left (software WebGL brings one)."""
        # In the page: messages also go by themselves while one reaches for them.
        self.page.wait_for_function(
            """() => {
              const found = document.querySelectorAll(
                '.mantine-Notification-closeButton');
              found.forEach(button => button.click());
              return found.length === 0;
            }"""
        )

    def tab(self, name: str) -> None:
        """Opens a tab."""
        self.page.get_by_role("tab", name=name).click()

    def click(self, button: str) -> None:
        """Clicks a button by its exact label."""
        self.page.get_by_role("button", name=button, exact=True).click()

    def choose(self, group: str, option: str) -> None:
        """Chooses one of a row of options, by their exact labels; it is marked then."""
        row = self.page.get_by_role("radiogroup", name=group, exact=True)
        row.get_by_role("radio", name=option, exact=True).click()
        row.get_by_role("radio", name=option, exact=True, checked=True).wait_for()

    def command(self, label: str) -> None:
        """Looks a command up by Ctrl+K and presses it.

        The search takes keys only once it has the focus, and Enter presses the line that
        is marked, which follows the words a moment later.
        """
        self.page.keyboard.press("Control+k")
        search = self.page.get_by_placeholder("Search commands")
        expect(search).to_be_focused()
        search.fill(label)
        marked = self.page.locator(".mantine-Spotlight-action[data-selected]")
        expect(marked.filter(has_text=label)).to_be_visible()
        self.page.keyboard.press("Enter")
        expect(search).to_be_hidden()

    def canvas(self) -> dict[str, float]:
        """Position and size of the 3-D canvas in the window."""
        return self.page.evaluate(
            "() => { const r = document.querySelector('canvas')"
            ".getBoundingClientRect(); return {x: r.x, y: r.y, width: r.width,"
            " height: r.height}; }"
        )

    def drag(self, start: tuple[float, float], way: tuple[float, float]) -> None:
        """Presses at ``start`` (window pixels), moves by ``way`` and releases."""
        mouse = self.page.mouse
        mouse.move(*start)
        self.frames(2)
        mouse.down()
        self.frames(1)
        for i in range(1, 6):
            mouse.move(start[0] + way[0] * i / 5, start[1] + way[1] * i / 5)
            self.frames(1)
        mouse.up()
        self.frames(2)

    def viewport_camera(self) -> tuple[np.ndarray, np.ndarray, float]:
        """The browser's own camera: position, R_page_cam and vertical view in radians.

        viser turns the page's axes so that three.js has its y upwards; the pose of a
        node at the root tells how.
        """
        found = self.page.evaluate(
            """() => {
              const c = __viserMutable.camera, nodes = __viserMutable.nodeRefFromName;
              const root = nodes['/solid'] ?? nodes['/clear'];
              c.updateMatrixWorld(); root.updateMatrixWorld();
              return {camera: c.matrixWorld.elements, fov: c.fov,
                      root: root.matrixWorld.elements};
            }"""
        )
        camera, root = (
            np.array(found[name]).reshape(4, 4).T for name in ("camera", "root")
        )
        pose = np.linalg.inv(root) @ camera
        # three.js looks along -z with y up; here cameras look along +z with y down.
        rotation = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
        return pose[:3, 3], rotation, float(np.radians(found["fov"]))
