"""Takes the README's pictures from the running app: `make screenshots`.

Drives the demo in Chromium as a person would and writes docs/*.png.
"""

import io
import os
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from app.control.controller import Controller
from app.control.projects import Projects
from app.engine.scene_opening import demo_folder, open_folder
from app.model.session import Session, setting
from app.page.server import Page
from tests.browser.driver import FINE, PANELS_WITHOUT_GL, Driver, launch, wait_until

FOLDER = Path(__file__).parents[2] / "docs"
MAX_BYTES = 500_000
"""Pictures above this are reduced to 256 colours."""


def main() -> int:
    """Writes the pictures; returns the exit status."""
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["PHOTOREG_DATA"] = folder
        session = Session()
        projects = Projects(session)
        projects.new(open_folder(demo_folder()), Path(folder) / "Shell")
        controller = Controller(session, projects=projects)
        page = Page(session, controller, port=0)
        drive(session, controller, projects, page)
    return 0


def drive(
    session: Session, controller: Controller, projects: Projects, page: Page
) -> None:
    """Opens a browser on the page, and closes all at the end."""
    try:
        with sync_playwright() as playwright:
            browser = launch(playwright, PANELS_WITHOUT_GL)
            window = browser.new_page(viewport={"width": 1280, "height": 800})
            take_all(session, Driver(window, f"http://127.0.0.1:{page.port}", FINE))
            refinement(session, Driver(window, f"http://127.0.0.1:{page.port}", FINE))
            browser.close()
    finally:
        page.close()
        controller.close()
        projects.close()


def take_all(session: Session, driver: Driver) -> None:
    """The whole way, with a picture of each tab and of the running refinement."""
    driver.dismiss_toasts()
    wait_until(lambda: not session.state.worker, "the engine is warm", 300)
    wait_until(lambda: session.state.run.error_px is not None, "the overlay is drawn")
    picture(driver, "1-data")
    driver.tab("2 Align")
    driver.choose("View", "Move the camera")
    driver.frames(20)
    picture(driver, "2-align")
    driver.choose("View", "3-D scene")
    driver.frames(10)
    driver.tab("3 Refine")
    driver.click("Refine")
    wait_until(
        lambda: (
            session.state.run.phase == "polish" and session.state.run.fraction > 0.4
        ),
        "the polish is under way",
        300,
    )
    # At once, without waiting for frames: the run goes on meanwhile.
    picture(driver, "3-refine", settle=False)
    wait_until(lambda: session.state.run.status == "review", "the run ends", 300)
    picture(driver, "app")
    driver.click("Accept")
    driver.tab("4 Export")
    driver.click("Make the texture")
    wait_until(lambda: session.state.texture is not None, "the texture is made", 300)
    driver.frames(10)
    picture(driver, "4-export")


def refinement(session: Session, driver: Driver) -> None:
    """The running refinement at its start, its middle and its end, dark and light."""
    driver.tab("3 Refine")
    rough = open_folder(demo_folder())
    for theme, dark in (("dark", True), ("light", False)):
        session.begin(rough)
        session.change(None, setting(dark=dark, preset="thorough"))
        wait_until(lambda: session.state.reach is not None, "the reach is known")
        driver.frames(10)
        driver.dismiss_toasts()
        driver.click("Refine")
        wait_until(lambda: session.state.run.generation > 15, "it searches", 300)
        picture(driver, f"refine-start-{theme}", settle=False)
        wait_until(
            lambda: (
                session.state.run.phase == "polish" and session.state.run.fraction > 0.5
            ),
            "the polish is under way",
            300,
        )
        picture(driver, f"refine-middle-{theme}", settle=False)
        wait_until(lambda: session.state.run.status == "review", "the run ends", 300)
        driver.page.get_by_role("button", name="Blink").wait_for()
        picture(driver, f"refine-end-{theme}")
        driver.click("Revert")
    session.change(None, setting(dark=True))


def picture(driver: Driver, name: str, settle: bool = True) -> None:
    """Writes what is on screen."""
    if settle:
        driver.frames(6)
    data = driver.page.screenshot()
    path = FOLDER / f"{name}.png"
    whole = Image.open(io.BytesIO(data)).convert("RGB")
    whole.save(path, optimize=True)
    if path.stat().st_size > MAX_BYTES:
        whole.quantize(256).save(path, optimize=True)
    print(f"docs/{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    sys.exit(main())
