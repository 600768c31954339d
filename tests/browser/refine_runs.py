"""Runs of the page on a small scene, as several tests need them: started, ended, dropped."""

import dataclasses

from app.model.reducers import has_moved
from app.model.session import setting
from app.model.state import Document, PhotoEntry
from photoreg.polish.config import PolishConfig
from photoreg.registration.config import RegistrationConfig
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from tests.browser.app import App
from tests.browser.conftest import OpenApp
from tests.browser.driver import wait_until

QUICK = dataclasses.replace(
    RegistrationConfig.preset("fast"),
    polish=PolishConfig(
        blurs_px=(4.0, 1.0),
        points=(500, 1000),
        rounds=(1, 1),
        extra_rounds=0,
        rim_reaches_px=(12.0, 6.0),
    ),
    distortion="none",
)
"""A run through all its stages in a second, for tests that do not ask how exact it is."""


def open_to_refine(open_app: OpenApp) -> App:
    """The app on a small scene that is refined quickly, its Refine tab open."""
    scene = make_scene(
        SceneOptions(kind="clean", width=160, height=120, error_px=(3.0, 4.0))
    )
    entries = tuple(map(PhotoEntry, scene.photos, scene.rough_cameras))
    names = [photo.name for photo in scene.photos]
    truth = tuple(zip(names, scene.cameras, strict=True))
    app = open_app(Document(scene.mesh, scene.mesh.decimated(5_000), entries, truth))
    app.driver.dismiss_toasts()
    app.driver.tab("3 Refine")
    return app


def start(app, config: RegistrationConfig | None = None, hold: bool = True) -> None:
    """Starts a run and waits until it has something to offer; then holds it there.

    Held, it does not end by itself while a slow browser makes ready to click. Without
    settings of its own it is as long as the longest preset.
    """
    app.session.change(None, setting(preset="thorough", config=config))
    wait_until(lambda: app.state.worker == "", "the worker is ready", 120)
    app.driver.click("Refine")
    wait_until(
        # The first generation's best may beat the start already: the curve begins there.
        lambda: (
            any(point.best < 1.0 for point in app.state.run.curve)
            and has_moved(app.state.run)
        ),
        "the run finds something better",
        240,
    )
    if hold:
        app.controller.refinement.pause()
        wait_until(lambda: app.state.run.status == "paused", "it pauses")


def drop(app) -> None:
    """Leaves the run, which goes on, is paused, or has ended."""
    if app.state.run.is_active:
        app.driver.click("Stop and revert")
        # It may have ended by itself at that very moment.
        wait_until(lambda: not app.state.run.is_active, "it stops", 60)
    if app.state.run.status == "review":
        app.driver.click("Revert")
    wait_until(lambda: app.state.run.status == "idle", "it is dropped")
    app.driver.frames(2)


def to_its_end(app) -> None:
    wait_until(lambda: app.state.run.status == "review", "the run ends", 240)
