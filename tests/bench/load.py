"""Many browsers at once: `make load`, or `python -m tests.bench.load --minutes 10`.

The server is a program of its own, as it is in use. All browsers move their view ten
times a second and watch refinements, one after the other. Measured are two round trips
of the interface, the server's memory, and how long a run takes beside one that a single
browser watches.

It is measured twice. First all browsers speak the page's protocol over a websocket and
draw nothing: what people's own computers draw costs the server nothing. Then some of
them are Chromium windows, which draw in software on the processor that the server has.
"""

import argparse
import asyncio
import concurrent.futures
import contextlib
import dataclasses
import html
import math
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import websockets
from playwright.sync_api import Browser, sync_playwright

from app.control.autosave import DOCUMENT_TYPES
from app.control.user_data import LOG_FILE
from photoreg.project.project import Project
from tests.bench.metrics import Metric
from tests.bench.processor import busy_s, processor_s
from tests.bench.wire import PROTOCOL, unpacked, view_from
from tests.browser.driver import FINE, Driver, launch, wait_until
from tests.browser.server_program import server

MOVES_PER_S = 10.0
ASK_EVERY_S = 2.0
"""How often each browser asks for the help, and waits until it is there."""
SELECT_EVERY_S = 3.0
"""How often one of them chooses the other photo, and all wait to see it."""
MAX_RUN_S = 600.0
N_ALONE = 3
"""Runs that one browser watches, after one that warms kernels."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """A photo that was chosen in one browser."""

    photo: str
    at: float
    """When, by ``time.monotonic()``."""
    seen: dict[int, float] = dataclasses.field(default_factory=dict)
    """When each browser first had it."""


class Crowd:
    """Browsers without a screen, on a thread of their own."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.watchers: list[Watcher] = []
        self.photos: list[str] = []
        self.choices: list[Choice] = []
        self.is_working = False
        """Whether they move, ask and choose, besides looking."""
        self._loop = asyncio.new_event_loop()
        self._tasks: list[concurrent.futures.Future[None]] = []
        self._pool = concurrent.futures.ThreadPoolExecutor(1)
        self._pool.submit(self._loop.run_forever)

    def come(self, n: int) -> None:
        """So many more browsers connect, one after the other."""
        for _ in range(n):
            watcher = Watcher(self, len(self.watchers))
            self.watchers.append(watcher)
            self._tasks.append(
                asyncio.run_coroutine_threadsafe(watcher.run(), self._loop)
            )
            wait_until(lambda w=watcher: w.is_served or w.n_errors, "it has the page")

    def press(self, label: str) -> None:
        """The first of them presses a button of the page."""
        pressing = self.watchers[0].press(label)
        asyncio.run_coroutine_threadsafe(pressing, self._loop).result()

    def leave(self) -> None:
        """All of them close."""
        for watcher in self.watchers:
            watcher.is_over = True
        concurrent.futures.wait(self._tasks)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._pool.shutdown()

    @property
    def to_all_ms(self) -> list[float]:
        """From a choice to each browser; infinite where the next choice came first."""
        numbers = [watcher.number for watcher in self.watchers]
        return [
            1e3 * (choice.seen.get(number, math.inf) - choice.at)
            for choice in self.choices[:-1]
            for number in numbers
        ]


class Watcher:
    """A browser without a screen: connects, moves its view, asks, and takes times."""

    def __init__(self, crowd: Crowd, number: int) -> None:
        self.number = number
        self._crowd = crowd
        self._socket: Any = None
        self._bridge = self._help = ""
        self._buttons: dict[str, str] = {}
        self._asked_at = 0.0
        self.answers_ms: list[float] = []
        self.n_errors = 0
        self.is_over = False

    @property
    def is_served(self) -> bool:
        """Whether the page is here."""
        return bool(self._help and self._bridge)

    async def run(self) -> None:
        """Works until it is over."""
        address = self._crowd.address
        try:
            async with websockets.connect(
                address.replace("http", "ws"),
                origin=address,  # pyright: ignore[reportArgumentType]
                subprotocols=[PROTOCOL],  # pyright: ignore[reportArgumentType]
                max_size=None,
            ) as self._socket:
                listening = asyncio.create_task(self._listen())
                await self._move(0.0)
                await self._work()
                listening.cancel()
        except (OSError, websockets.WebSocketException, AssertionError) as error:
            self.n_errors += 1
            print(f"browser {self.number}: {error}", flush=True)

    async def press(self, label: str) -> None:
        """Presses a button of the page."""
        await self._update(self._buttons[label], True)

    async def _work(self) -> None:
        asks = choose_at = time.monotonic() + 2.0 + 0.1 * self.number
        crowd = self._crowd
        while not self.is_over:
            await asyncio.sleep(1.0 / MOVES_PER_S)
            if not crowd.is_working:
                continue
            now = time.monotonic()
            await self._move(now)
            if now > asks and not self._asked_at and self._help:
                asks = now + ASK_EVERY_S
                self._asked_at = time.monotonic()
                await self._tell(self._help, value="help")
            if self.number == 0 and crowd.photos and now > choose_at:
                choose_at = now + SELECT_EVERY_S
                photo = crowd.photos[len(crowd.choices) % 2]
                crowd.choices.append(Choice(photo, time.monotonic()))
                await self._tell("select", photo=photo)

    async def _move(self, now: float) -> None:
        angle = 0.2 * now + self.number
        position = (3.0 * math.cos(angle), 3.0 * math.sin(angle), 1.0)
        await self._socket.send(view_from(position))

    async def _tell(self, act: str, **values: object) -> None:
        message = msgspec.json.encode({"act": act, **values, "at": time.time()})
        await self._update(self._bridge, message.decode())

    async def _update(self, uuid: str, value: object) -> None:
        updates = {"value": value}
        message = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}
        await self._socket.send(msgspec.msgpack.encode(message))

    async def _listen(self) -> None:
        async for raw in self._socket:
            for message in unpacked(raw):
                await self._hear(message)

    async def _hear(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        content = message.get("props", message.get("updates", {}))
        if kind == "GuiModalMessage" and self._asked_at:
            self.answers_ms.append(1e3 * (time.monotonic() - self._asked_at))
            self._asked_at = 0.0
            await self._tell(self._help, value="help")  # Closes it.
        elif kind == "GuiTextMessage" and content["label"] == "page":
            self._bridge = message["uuid"]
        elif kind == "GuiButtonMessage":
            self._buttons[content["label"]] = message["uuid"]
        text = content.get("content") if isinstance(content, dict) else None
        if isinstance(text, str):
            self._read(text)

    def _read(self, text: str) -> None:
        """Looks in the page's HTML for the help's button and the photo chosen."""
        if not self._help and "widget-" in text:
            found = re.search(
                r'\["(widget-\d+)", \{"value": "help"', html.unescape(text)
            )
            self._help = found[1] if found else ""
        if "data-photo=" not in text:
            return
        crowd = self._crowd
        pressed = dict(re.findall(r'data-photo="([^"]+)" aria-pressed="(\w+)"', text))
        crowd.photos = list(pressed)[:2]
        if crowd.choices and pressed.get(crowd.choices[-1].photo) == "true":
            crowd.choices[-1].seen.setdefault(self.number, time.monotonic())


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit status: 1 if a bar was missed."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.load")
    parser.add_argument("--minutes", type=float, default=10.0, help="each time")
    parser.add_argument("--browsers", type=int, default=10, help="all together")
    parser.add_argument(
        "--pages", type=int, nargs="+", default=[0, 2], help="those in Chromium"
    )
    chosen = parser.parse_args(arguments)
    are_reached = True
    with sync_playwright() as playwright:
        browser = launch(playwright)
        for n_pages in chosen.pages:
            for metric in _measure(chosen, n_pages, browser):
                verdict = {True: "reached", False: "MISSED", None: ""}[metric.reached]
                bar = "" if metric.bar is None else f"(bar {metric.bar:g}) "
                print(f"{metric.name}: {metric.value:.3g} {metric.unit} {bar}{verdict}")
                if metric.note:
                    print(f"    {metric.note}", flush=True)
                are_reached = are_reached and metric.reached is not False
        browser.close()
    return 0 if are_reached else 1


def _measure(
    chosen: argparse.Namespace, n_pages: int, browser: Browser
) -> Iterator[Metric]:
    with tempfile.TemporaryDirectory(prefix="photoreg-load-") as name:
        folder = Path(name) / "work"
        with server(folder) as (process, address):
            yield from _of_a_server(
                chosen, n_pages, folder, process.pid, address, browser
            )


def _of_a_server(
    chosen: argparse.Namespace,
    n_pages: int,
    folder: Path,
    pid: int,
    address: str,
    browser: Browser,
) -> Iterator[Metric]:
    errors: list[str] = []

    def window(number: int) -> Driver:
        driver = _page(browser, address, number)
        driver.page.on("pageerror", lambda error: errors.append(str(error)))
        return driver

    crowd, windows = Crowd(address), []
    if n_pages > 0:
        windows.append(window(0))
        windows[0].tab("3 Refine")
        press = windows[0].click
    else:
        crowd.come(1)
        press = crowd.press
    alone_s = [_run(press, folder) for _ in range(1 + N_ALONE)][1:]
    windows += [window(i) for i in range(1, n_pages)]
    crowd.come(chosen.browsers - n_pages - len(crowd.watchers))
    before_mb, seconds, memory_mb = _rss_mb(pid), [], []
    cores = Cores(pid)
    crowd.is_working = True
    until = time.monotonic() + 60.0 * chosen.minutes
    while time.monotonic() < until:
        seconds.append(_run(press, folder, windows, len(seconds)))
        memory_mb.append(_rss_mb(pid))
    used = cores.used()
    crowd.leave()
    for driver in windows:
        driver.page.close()
    answers = [ms for watcher in crowd.watchers for ms in watcher.answers_ms]
    path = folder / LOG_FILE
    log = path.read_text(encoding="utf-8") if path.exists() else ""
    n_errors = (
        len(errors) + sum(w.n_errors for w in crowd.watchers) + log.count(" ERROR ")
    )
    load = f"load.pages_{n_pages}"
    about = (
        f"{chosen.browsers} browsers ({n_pages} of them Chromium), "
        f"{chosen.minutes:g} min, {len(seconds)} runs"
    )
    yield Metric(f"{load}.errors", n_errors, "", "lower", 0, note=about)
    for what, taken in (("answer", answers), ("to_all", crowd.to_all_ms)):
        middle, p95 = np.percentile(taken, (50, 95), method="higher")
        note = f"median {middle:.0f}, worst {max(taken):.0f}, n={len(taken)}"
        yield Metric(f"{load}.{what}.p95", float(p95), "ms", "lower", 250.0, note=note)
    grown = memory_mb[-1] - memory_mb[0]
    note = f"{before_mb:.0f} MB before, then {', '.join(f'{m:.0f}' for m in memory_mb)}"
    yield Metric(f"{load}.memory_growth", grown, "MB", "lower", 30.0, note=note)
    ratio = float(np.median(seconds) / np.median(alone_s))
    alone, watched = (
        ", ".join(f"{s:.1f}" for s in taken) for taken in (alone_s, seconds)
    )
    note = f"alone {alone} s, then {watched}"
    yield Metric(f"{load}.run_slower", ratio, "times", "lower", 1.15, note=note)
    for what, value in used.items():
        yield Metric(f"{load}.cores.{what}", value, "cores", "lower")


class Cores:
    """Cores that server, engine, browsers and all else keep busy from now on."""

    def __init__(self, server_pid: int) -> None:
        self._pid = server_pid
        self._since, self._before = time.monotonic(), self._now()

    def used(self) -> dict[str, float]:
        """Cores until now, on average."""
        seconds = time.monotonic() - self._since
        now = self._now()
        return {who: (now[who] - self._before[who]) / seconds for who in now}

    def _now(self) -> dict[str, float]:
        children = Path(f"/proc/{self._pid}/task/{self._pid}/children")
        own = tuple(map(int, children.read_text().split()))
        own_s = processor_s(self._pid, without=own)
        ours_s = processor_s(os.getpid())
        served_s = processor_s(self._pid)
        return {
            "server": own_s,
            "engine": served_s - own_s,
            "browsers": ours_s - served_s,
            "others": busy_s() - ours_s,
        }


def _page(browser: Browser, address: str, number: int) -> Driver:
    window = browser.new_page(viewport={"width": 700 + 10 * number, "height": 500})
    driver = Driver(window, address, FINE, still=False)
    driver.dismiss_toasts()
    return driver


def _run(
    press: Callable[[str], None],
    folder: Path,
    moving: list[Driver] | None = None,
    turn: int = 0,
) -> float:
    """One refinement from the page, with cameras in motion; its seconds at work."""
    n_before = len(_run_seconds(folder))
    press("Refine")
    n_moves = 0

    def ended() -> bool:
        nonlocal n_moves
        for driver in moving or []:
            box = driver.canvas()
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            n_moves += 1
            driver.page.mouse.move(x, y)
            driver.page.mouse.down()
            driver.page.mouse.move(x + 40 * (-1) ** (n_moves + turn), y)
            driver.page.mouse.up()
        time.sleep(0.1)
        return len(_run_seconds(folder)) > n_before

    wait_until(ended, "the run ends", MAX_RUN_S)
    press("Revert")
    return _run_seconds(folder)[-1]


def _run_seconds(folder: Path) -> list[float]:
    with contextlib.closing(Project(folder, DOCUMENT_TYPES, create=False)) as project:
        return [
            float(run.figures["elapsed_s"])
            for run in project.runs.all()
            if run.ended_utc is not None
        ]


def _rss_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


if __name__ == "__main__":
    sys.exit(main())
