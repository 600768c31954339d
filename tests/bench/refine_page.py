"""A refinement on the page: how soon it is seen, how often, what watching costs, and how
soon its death is told."""

import contextlib
import dataclasses
import os
import signal
import statistics
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from app.control.controller import Controller
from app.engine.overlay_job import Drawing
from app.engine.picture_stream import PictureStream
from app.engine.refine_job import RefineJob
from app.engine.scene_opening import demo_folder, open_folder
from app.model.messages import Live, Refine
from app.model.pictures import OverlayView
from app.model.run import PRESET_NAMES
from app.model.session import Session, setting
from photoreg.registration.config import PresetName, RegistrationConfig
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.processor import processor_s
from tests.bench.served import served
from tests.bench.wire import listening
from tests.browser.driver import FINE, Driver, launch, wait_until

N_STARTS = 6
REST_MS = 2_500
"""Who has aligned the cameras looks at them before pressing Refine."""
N_PAIRS = 24
N_TOLD = 4
"""How often a run tells of itself while pictures are on, or off: two thirds of a second."""

SETTLED = 10_000
N_KILLS = 5

_WATCH = """() => {
  const image = document.querySelector('img[src^="blob:"]');
  window.pictures = [];
  new MutationObserver(() => pictures.push(Date.now()))
    .observe(image, {attributes: true, attributeFilter: ['src']});
}"""

_TOLD = """() => [...document.querySelectorAll('.mantine-Notification-root')]
  .some(message => message.textContent.includes('engine process died')) && Date.now()"""


class _Load:
    """Cores that server, worker and browser keep busy while it is watched."""

    def __init__(self, controller: Controller) -> None:
        self._worker = controller.worker.pid or 0
        self._used: dict[str, float] = {"server": 0.0, "worker": 0.0, "browser": 0.0}
        self._seconds = 0.0

    def start(self) -> None:
        self._since, self._before = time.monotonic(), self._now()

    def stop(self) -> None:
        self._seconds += time.monotonic() - self._since
        for name, used in self._now().items():
            self._used[name] += used - self._before[name]

    def _now(self) -> dict[str, float]:
        server = time.process_time()
        below = processor_s(os.getpid(), without=(self._worker,))
        return {
            "server": server,
            "worker": processor_s(self._worker),
            "browser": below - server,
        }

    def metrics(self, name: str) -> Iterator[Metric]:
        for process, used in self._used.items():
            yield Metric(
                f"{name}.cores.{process}", used / self._seconds, "cores", "lower",
                None, 1.0, "the server's include the bench's own"
                if process == "server" else "",
            )  # fmt: skip


class _Switched(PictureStream):
    """Draws only while it is on."""

    is_on = False

    def offer(self, *arguments: Any, **options: Any) -> None:
        """Passes over what comes while it is off."""
        if self.is_on:
            super().offer(*arguments, **options)


@bench
def refine_page(setting: Setting) -> Iterator[Metric]:
    """The demo, refined in a window of software WebGL, beside one that draws elsewhere.

    Where there is a graphics card, the search has the processor to itself: that is what
    a client tells that takes all messages and draws nothing.
    """
    del setting
    yield from _slowdown()
    with served(open_folder(demo_folder())) as (session, controller, page):
        address = f"http://127.0.0.1:{page.port}"
        wait_until(lambda: session.state.speed is not None, "it is timed", 300)
        yield from _listening(session, controller, address)
        with sync_playwright() as playwright:
            browser = launch(playwright)
            window = browser.new_page(viewport={"width": 1100, "height": 700})
            driver = Driver(window, address, FINE, still=False)
            yield from _watching(session, controller, driver)
            yield from _dying(session, controller, driver)
            browser.close()


def _listening(
    session: Session, controller: Controller, address: str
) -> Iterator[Metric]:
    """Pictures a second and round trips of a client that draws nothing."""
    pictures: list[float] = []
    seen: dict[str, float] = {}

    def hear(message: dict[str, Any]) -> None:
        updates = message.get("updates", {})
        if "_data" in updates:
            pictures.append(time.time())
        if isinstance(updates.get("value"), str):
            seen[updates["value"]] = time.perf_counter()

    rates, trips_ms, load = [], [], _Load(controller)
    with listening(address, hear):
        for _ in range(N_STARTS):
            session.change(None, setting(preset="thorough"))
            controller.refinement.start()
            wait_until(lambda: session.state.run.curve, "a first update")
            pictures.clear()
            load.start()
            since = time.time()
            while time.time() - since < 3.0 and session.state.run.is_active:
                # The dropdown of the presets follows; it changes nothing in the run.
                is_default = session.state.preset == "default"
                preset: PresetName = "thorough" if is_default else "default"
                name = PRESET_NAMES[preset]
                seen.clear()
                asked = time.perf_counter()
                session.change(None, setting(preset=preset))
                wait_until(lambda name=name: name in seen, "it is heard", poll_s=0.001)
                trips_ms.append(1e3 * (seen[name] - asked))
                time.sleep(0.04)
            load.stop()
            rates.append(_rate(pictures))
            controller.refinement.stop(revert=True)
            wait_until(lambda: session.state.run.status == "idle", "it stops")
    yield from _rates_and_trips(
        "refine_page.drawn_elsewhere", rates, trips_ms, "a client that draws nothing"
    )
    yield from load.metrics("refine_page.drawn_elsewhere")


def _watching(
    session: Session, controller: Controller, driver: Driver
) -> Iterator[Metric]:
    """First update after the click, pictures a second, round trips meanwhile."""
    driver.dismiss_toasts()
    driver.tab("3 Refine")
    driver.page.evaluate(_WATCH)
    refine = driver.page.get_by_role("button", name="Refine", exact=True)
    session.change(None, setting(preset="thorough"))
    rested_ms, at_once_ms, rates, trips_ms = [], [], [], []
    load = _Load(controller)
    for i in range(N_STARTS):
        driver.frames(3)
        first_ms = at_once_ms if i % 2 else rested_ms
        if first_ms is rested_ms:
            driver.page.wait_for_timeout(REST_MS)
        box = refine.bounding_box()
        assert box is not None
        updated = []
        leave = session.listen(
            lambda old, new, updated=updated: (
                updated.append(time.time())
                if new.run.curve and not old.run.curve
                else None
            )
        )
        began = time.time()
        driver.page.mouse.click(
            box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        )
        wait_until(lambda updated=updated: updated, "a first update")
        leave()
        first_ms.append(1e3 * (updated[0] - began))
        driver.page.evaluate("() => { pictures.length = 0; }")
        load.start()
        since = time.time()
        while time.time() - since < 3.0 and session.state.run.is_active:
            asked = time.perf_counter()
            session.change(
                None, setting(mesh_opacity=0.5 + 0.001 * (len(trips_ms) % 100))
            )
            driver.page.evaluate("() => 0")
            trips_ms.append(1e3 * (time.perf_counter() - asked))
            driver.page.wait_for_timeout(40)
        load.stop()
        rates.append(
            _rate([1e-3 * at for at in driver.page.evaluate("() => pictures")])
        )
        controller.refinement.stop(revert=True)
        wait_until(lambda: session.state.run.status == "idle", "it stops")
    for name, times, note in (
        ("first_update", rested_ms, "the cameras have rested"),
        ("first_update_at_once", at_once_ms, "right after another run"),
    ):
        note = f"n={len(times)}; after the click, {note}"
        yield Metric(
            f"refine_page.{name}.median",
            statistics.median(times), "ms", "lower", 500.0, 1.0, note,
        )  # fmt: skip
        yield Metric(
            f"refine_page.{name}.worst", max(times), "ms", "lower", None, 2.0, note
        )
    yield from _rates_and_trips("refine_page", rates, trips_ms, "software WebGL")
    yield from load.metrics("refine_page")


def _dying(
    session: Session, controller: Controller, driver: Driver
) -> Iterator[Metric]:
    """How soon the page says that the worker was killed in the middle of a run."""
    told_ms = []
    for _ in range(N_KILLS):
        driver.dismiss_toasts()
        wait_until(lambda: session.state.worker == "", "the engine is warm", 300)
        controller.refinement.start()
        wait_until(lambda: session.state.kept_search, "a state is kept")
        pid = controller.worker.pid
        assert pid is not None
        killed = time.time()
        os.kill(pid, signal.SIGKILL)
        told = driver.page.wait_for_function(_TOLD, polling=10).json_value()
        told_ms.append(told - 1e3 * killed)
        controller.refinement.revert()
    note = f"n={len(told_ms)}; after kill -9 in a run, software WebGL"
    yield Metric(
        "refine_page.death_told.median",
        statistics.median(told_ms), "ms", "lower", None, 1.0, note,
    )  # fmt: skip
    yield Metric(
        "refine_page.death_told.worst",
        max(told_ms), "ms", "lower", 1_000.0, 1.0, note,
    )  # fmt: skip


def _rate(times: list[float]) -> float:
    """Pictures a second; 0 where there were too few to tell."""
    if len(times) < 3:
        return 0.0
    return (len(times) - 1) / (times[-1] - times[0])


def _rates_and_trips(
    name: str, rates: list[float], trips_ms: list[float], note: str
) -> Iterator[Metric]:
    yield Metric(
        f"{name}.overlay_rate.median",
        statistics.median(rates), "1/s", "higher", 5.0, 0.25,
        f"n={len(rates)}; 1024 px, {note}",
    )  # fmt: skip
    note = f"n={len(trips_ms)}; a change of the state and its answer, {note}"
    for which, share in (("median", 0.5), ("p95", 0.95)):
        yield Metric(
            f"{name}.round_trip.{which}",
            float(np.quantile(trips_ms, share)), "ms", "lower", None, 1.0, note,
        )  # fmt: skip


def _slowdown() -> Iterator[Metric]:
    """Time of an evaluation that is watched, over that of one that is not.

    Pictures are switched on and off in turn within a search, so that whatever else the
    machine does meets both alike.
    """
    document = open_folder(demo_folder())
    mesh, photos = document.mesh, tuple(entry.photo for entry in document.used)
    assert mesh is not None
    drawing = Drawing(mesh, photos, tuple(photo.name for photo in photos))
    config = RegistrationConfig.preset("thorough")
    genetic = dataclasses.replace(config.genetic, generations=100_000)
    job = Refine(
        cameras=document.used_cameras,
        config=dataclasses.replace(config, genetic=genetic),
        view=OverlayView(style="blend", onto=0, surface="photos"),
        truth=document.true_cameras([entry.name for entry in document.used]),
    )
    drawing.surface(job.cameras, "photos")  # What takes long the first time.
    stream = _Switched(lambda _: None)
    told: list[Live] = []
    spent: list[float] = []

    def send(event: Any) -> None:
        is_search = isinstance(event, Live) and event.progress.phase == "search"
        # At first individuals that see little are valued quickly.
        if not is_search or event.progress.evaluations < SETTLED:
            return
        told.append(event)
        if len(told) > N_TOLD:
            # What was on its way at the switch is over by the second.
            first, last = told[1].progress, told[-1].progress
            seconds = last.elapsed_s - first.elapsed_s
            spent.append(seconds / (last.evaluations - first.evaluations))
            told[:] = [event]
            stream.is_on = len(spent) % 4 in (1, 2)

    def messages(_: bool) -> Iterator[Any]:
        if len(spent) == 2 * N_PAIRS:
            raise _EnoughError
        yield from ()

    with contextlib.suppress(_EnoughError):
        RefineJob(job, mesh, photos, drawing, stream, lambda _: None, send).run(
            messages
        )
    stream.finish()
    off, on = np.array(spent)[0::4], np.array(spent)[1::4]
    ratios = np.concatenate([on / off, spent[2::4] / np.array(spent)[3::4]]) - 1.0
    error = 1.25 * ratios.std(ddof=1) / np.sqrt(len(ratios))
    yield Metric(
        "refine_page.slowdown.median",
        100.0 * float(np.median(ratios)), "%", "lower", 10.0, 1.0,
        f"n={len(ratios)}, standard error {100.0 * error:.1f}; of the search, by pictures "
        "and surface",
    )  # fmt: skip


class _EnoughError(Exception):
    """The search has run for long enough."""
