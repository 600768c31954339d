"""A run whose engine is killed, breaks or starves loses nothing, and the next one works."""

import contextlib
import dataclasses
import logging
import multiprocessing
import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from app.control.user_data import log_into
from app.model.reducers import has_moved
from app.model.session import setting
from photoreg.registration.config import RegistrationConfig
from tests.browser.driver import wait_until
from tests.browser.refine_runs import QUICK, drop, open_to_refine, start, to_its_end


@pytest.fixture(scope="module")
def app(open_app_once):
    return open_to_refine(open_app_once)


@pytest.mark.errors("The worker process died")
def test_a_killed_worker_costs_no_work_and_the_next_run_ends(app):
    start(app)
    os.kill(app.controller.worker.pid, signal.SIGKILL)
    wait_until(lambda: app.state.run.status == "review", "the page knows", 5)
    assert "died" in app.state.run.outcome
    assert app.state.run.cameras
    app.driver.page.get_by_text("Tab 3 has it as it was").wait_for()
    app.driver.page.get_by_role("button", name="Go on where it was").wait_for()
    drop(app)
    start(app, QUICK, hold=False)
    to_its_end(app)
    drop(app)
    assert "died" not in app.state.runs[-1].outcome


class BreaksInPolish(RegistrationConfig):
    """Settings at which the engine breaks when the search has ended."""

    def __repr__(self) -> str:
        return repr(
            RegistrationConfig(**vars(self))
        )  # What a checkpoint knows them by.

    def __getattribute__(self, name: str) -> Any:
        if name == "prior_scales" and multiprocessing.parent_process() is not None:
            raise ZeroDivisionError("of the test")
        return super().__getattribute__(name)


@pytest.mark.errors("Refine failed")
def test_a_run_that_breaks_midway_is_told_kept_and_logged_and_goes_on(app, tmp_path):
    handler = log_into(tmp_path)
    assert handler is not None
    app.driver.dismiss_toasts()  # That of the run before says the same.
    broken = BreaksInPolish(**vars(QUICK))
    try:
        app.session.change(None, setting(config=broken))
        app.driver.click("Refine")
        to_its_end(app)
    finally:
        logging.getLogger().removeHandler(handler)
        handler.close()
    window = app.driver.page
    window.get_by_text("The refinement was cut short", exact=True).wait_for()
    window.get_by_text(
        "photoreg did not foresee this; photoreg.log in "
        "the project's folder has the details. Tab 3 has it as it was, to go on with.",
        exact=True,
    ).wait_for()
    run = app.state.run
    assert run.outcome == "The refinement failed; this is the best until then."
    assert has_moved(run)
    assert run.curve[-1].best < 1.0
    text = (tmp_path / "photoreg.log").read_text()
    assert text.count("Traceback") == 1
    assert "Refine failed" in text
    assert text.rstrip().endswith("ZeroDivisionError: of the test")
    assert len(text) < 5000, "the lines of code, and nothing of the photos"
    # What broke it is gone: it goes on, and the next run works from its start.
    run = dataclasses.replace(run, config=QUICK)
    app.session.change(None, setting(run=run, config=None))
    app.driver.click("Go on where it was")
    wait_until(lambda: app.state.run.start_cost is not None, "it ends", 240)
    assert not app.state.can_go_on
    drop(app)
    start(app, QUICK, hold=False)
    to_its_end(app)
    assert app.state.run.start_cost is not None
    drop(app)


class StarvesInPolish(RegistrationConfig):
    """Settings at which the engine gets no more memory when the search has ended."""

    __repr__ = BreaksInPolish.__repr__

    def __getattribute__(self, name: str) -> Any:
        if name == "prior_scales" and multiprocessing.parent_process() is not None:
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            used = pages * resource.getpagesize()
            _, most = resource.getrlimit(resource.RLIMIT_AS)
            resource.setrlimit(resource.RLIMIT_AS, (used + 1_000_000, most))
            # What earlier runs gave back might be enough for a scene as small as this; it
            # is less than all there is.
            bytearray(used)
        return super().__getattribute__(name)


@pytest.mark.skipif(sys.platform != "linux", reason="limits memory as Linux does")
@pytest.mark.errors("Refine failed", "The worker process died")
def test_a_run_without_memory_for_its_polish_ends_and_the_next_one_works(app):
    worker = app.controller.worker
    fast = RegistrationConfig.preset("fast")
    app.session.change(None, setting(config=StarvesInPolish(**vars(fast))))
    app.driver.click("Refine")
    to_its_end(app)
    # The engine goes on where it can tell what failed, and is started anew where not.
    assert "this is the best until then" in app.state.run.outcome
    app.driver.page.get_by_text("The refinement was cut short").first.wait_for()
    assert has_moved(app.state.run)
    with contextlib.suppress(ProcessLookupError):
        limits = resource.prlimit(worker.pid, resource.RLIMIT_AS)
        resource.prlimit(worker.pid, resource.RLIMIT_AS, (limits[1], limits[1]))
    drop(app)
    app.session.change(None, setting(config=None))
    start(app, QUICK, hold=False)
    to_its_end(app)
    assert app.state.run.start_cost is not None
    drop(app)
