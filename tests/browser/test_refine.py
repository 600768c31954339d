"""A run in the page: started, paused, stopped, reverted, held, seen twice, survived."""

import os
import signal

import numpy as np
import pytest

from app.session import setting
from app.state import Document
from tests.browser.driver import Driver, wait_until


@pytest.fixture(scope="module")
def app(open_app_once, toy_document: Document):
    """One app for all tests here: a worker compiles for long."""
    app = open_app_once(toy_document)
    app.driver.dismiss_toasts()
    app.session.change(None, setting(preset="thorough"))
    app.driver.tab("3 Refine")
    return app


def start(app) -> None:
    wait_until(lambda: app.state.worker == "", "the worker is ready", 120)
    app.driver.click("Refine")
    wait_until(
        lambda: app.state.run.curve and app.state.run.cameras != app.state.run.start,
        "the run finds something better",
        240,
    )


def back_to_idle(app) -> None:
    wait_until(lambda: app.state.run.status == "review", "the run ends", 240)
    app.driver.click("Revert")
    wait_until(lambda: app.state.run.status == "idle", "it is reverted")
    app.driver.frames(2)


def test_a_paused_run_stands_still_and_goes_on_when_resumed(app):
    start(app)
    app.driver.click("Pause")
    wait_until(lambda: app.state.run.status == "paused", "it pauses")
    # What was on its way arrives; then nothing more comes.
    app.driver.page.wait_for_timeout(500)
    before = app.state.run.evaluations, len(app.state.run.curve)
    app.driver.page.wait_for_timeout(700)
    assert (app.state.run.evaluations, len(app.state.run.curve)) == before
    assert app.state.run.status == "paused"
    app.driver.click("Resume")
    wait_until(lambda: len(app.state.run.curve) > before[1], "it goes on")
    costs = [point.best for point in app.state.run.curve]
    assert costs == sorted(costs, reverse=True)
    back_to_idle(app)


def test_stop_and_revert_leaves_the_cameras_as_they_were(app):
    document = app.state.document
    start(app)
    app.driver.click("Stop and revert")
    wait_until(lambda: app.state.run.status == "idle", "it stops", 60)
    assert app.state.document is document
    assert app.state.undo_name is None, "a run that was dropped is no step of undo"


def test_stop_and_keep_offers_the_best_so_far(app):
    start(app)
    app.driver.click("Stop and keep the best")
    wait_until(lambda: app.state.run.status == "review", "it stops", 60)
    app.driver.click("Accept")
    wait_until(lambda: app.state.undo_name == "Refine", "the cameras are taken")
    app.driver.click("Undo: Refine")
    wait_until(lambda: app.state.undo_name is None, "undo takes it back")


def test_what_is_ticked_stays_to_the_last_bit(app):
    first, second = (entry.camera for entry in app.state.document.photos)
    app.driver.page.get_by_text("What may move").click()
    app.driver.frames(2)
    keep_focal = app.driver.page.get_by_label("Keep focal length")
    keep_focal.nth(1).check()
    for label in ("Keep place and turn", "Keep focal length", "Keep principal point"):
        app.driver.page.get_by_label(label).nth(0).check()
    wait_until(lambda: len(app.state.held) == 4, "the ticks arrive")
    start(app)
    wait_until(lambda: app.state.run.status == "review", "the run ends", 240)
    kept, moved = app.state.run.cameras
    np.testing.assert_array_equal(kept.K, first.K)
    np.testing.assert_array_equal(kept.R_cam_world, first.R_cam_world)
    np.testing.assert_array_equal(kept.t_cam_world, first.t_cam_world)
    assert moved.focal_px == second.focal_px
    assert not np.array_equal(moved.t_cam_world, second.t_cam_world)
    app.session.change(None, setting(held=()))
    back_to_idle(app)


def test_another_browser_sees_the_run_and_may_stop_it(app, chromium):
    start(app)
    window = chromium.new_page(viewport={"width": 1100, "height": 700})
    try:
        other = Driver(window, f"http://127.0.0.1:{app.page.port}")
        other.tab("3 Refine")
        if app.state.run.is_active:
            other.click("Stop and keep the best")
        wait_until(lambda: app.state.run.status == "review", "it ends", 60)
        other.frames(2)
        assert other.page.get_by_role("button", name="Accept", exact=True).is_visible()
    finally:
        window.close()
    back_to_idle(app)


def test_a_killed_worker_costs_no_work_and_the_next_run_ends(app):
    start(app)
    app.driver.click("Pause")
    wait_until(lambda: app.state.run.status == "paused", "it pauses")
    os.kill(app.conductor.worker.pid, signal.SIGKILL)
    wait_until(lambda: app.state.run.status == "review", "the page knows", 5)
    assert "died" in app.state.run.outcome
    assert app.state.run.cameras
    back_to_idle(app)
    start(app)
    back_to_idle(app)
    assert "died" not in app.state.runs[-1].outcome
