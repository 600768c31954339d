"""A person's whole way with files of their own, in Chromium, timed by its steps."""

import time
from collections.abc import Iterator

from playwright.sync_api import sync_playwright

from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.served import served
from tests.browser.app import App
from tests.browser.driver import FINE, Driver, launch
from tests.browser.own_files import whole_way

NOTES = {
    "open": "mesh and two photos dropped, until their agreement is on screen",
    "points1": "8 pairs clicked in photo and model, solved live",
    "points2": "the same for the other photo",
    "refine": "to the end, preset default",
    "texture": "made and shown",
    "download": "the model as a zip",
}


@bench
def way(setting: Setting) -> Iterator[Metric]:
    """Seconds of the machine for each step; a person's own time comes on top."""
    del setting
    scene = make_scene(SceneOptions(kind="shell", seed=5))
    with served() as (session, controller, page), sync_playwright() as playwright:
        browser = launch(playwright)
        window = browser.new_page(viewport={"width": 1280, "height": 800})
        driver = Driver(window, f"http://127.0.0.1:{page.port}", FINE, still=False)
        app = App(session, controller, page, driver)
        began = time.perf_counter()
        for step in whole_way(app, scene):
            taken = time.perf_counter() - began
            yield Metric(f"way.{step}", taken, "s", "lower", None, 1.0, NOTES[step])
            began = time.perf_counter()
        browser.close()
