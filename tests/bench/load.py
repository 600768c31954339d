"""Many browsers at once: `make load`, or `python -m tests.bench.load --minutes 10`.

The server is a program of its own, as it is in use. Some browsers are real Chromium
windows, the others speak the page's protocol over a websocket: ten windows of software
WebGL take more processor than a server has. All move their view ten times a second and
watch refinements, one after the other. Measured are two round trips of the interface,
the server's memory, and how long a run takes beside one that nobody watches.
"""

import argparse
import asyncio
import concurrent.futures
import contextlib
import html
import math
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import websockets
from playwright.sync_api import Browser, sync_playwright

from app.autosave import DOCUMENT_TYPES
from app.shelf import LOG_FILE
from photoreg.project import Project
from tests.bench.metrics import Metric
from tests.bench.wire import PROTOCOL, unpacked, view_from
from tests.browser.driver import Driver, launch, wait_until
from tests.server_program import server

MOVES_PER_S = 10.0
ASK_EVERY_S = 2.0
"""How often each browser asks for the help, and waits until it is there."""
SELECT_EVERY_S = 3.0
"""How often one of them chooses the other photo, and all wait to see it."""
MAX_RUN_S = 600.0


class Watcher:
    """A browser without a screen: connects, moves its view, asks, and takes times."""

    def __init__(self, address: str, number: int) -> None:
        self._address, self._number = address, number
        self._socket: Any = None
        self._bus = self._help = ""
        self._asked_at = 0.0
        self._cards: dict[str, float] = {}
        self.answers_ms: list[float] = []
        self.seen_at: dict[str, float] = {}
        self.n_messages = self.n_errors = 0

    async def run(self, until: float, chooses: bool) -> None:
        """Works until the time of ``time.monotonic()`` is ``until``."""
        try:
            async with websockets.connect(
                self._address.replace("http", "ws"),
                origin=self._address,  # pyright: ignore[reportArgumentType]
                subprotocols=[PROTOCOL],  # pyright: ignore[reportArgumentType]
                max_size=None,
            ) as self._socket:
                listening = asyncio.create_task(self._listen())
                await self._move(0.0)
                asks = choose_at = time.monotonic() + 2.0 + 0.1 * self._number
                photos = 0
                while (now := time.monotonic()) < until:
                    await self._move(now)
                    if self._help and now > asks and not self._asked_at:
                        asks = now + ASK_EVERY_S
                        self._asked_at = time.monotonic()
                        await self._tell(self._help, value="help")
                    if chooses and len(PHOTOS) == 2 and now > choose_at:
                        choose_at = now + SELECT_EVERY_S
                        photos += 1
                        SENT.append((PHOTOS[photos % 2], time.monotonic()))
                        await self._tell("select", photo=PHOTOS[photos % 2])
                    await asyncio.sleep(1.0 / MOVES_PER_S)
                listening.cancel()
        except (OSError, websockets.WebSocketException, AssertionError) as error:
            self.n_errors += 1
            print(f"browser {self._number}: {error}", flush=True)

    async def _move(self, now: float) -> None:
        angle = 0.2 * now + self._number
        position = (3.0 * math.cos(angle), 3.0 * math.sin(angle), 1.0)
        await self._socket.send(view_from(position))

    async def _tell(self, act: str, **values: object) -> None:
        message = msgspec.json.encode({"act": act, **values, "at": time.time()})
        await self._send(
            type="GuiUpdateMessage", uuid=self._bus, updates={"value": message.decode()}
        )

    async def _send(self, **message: object) -> None:
        await self._socket.send(msgspec.msgpack.encode(message))

    async def _listen(self) -> None:
        async for raw in self._socket:
            for message in unpacked(raw):
                self.n_messages += 1
                await self._hear(message)

    async def _hear(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "GuiModalMessage" and self._asked_at:
            self.answers_ms.append(1e3 * (time.monotonic() - self._asked_at))
            self._asked_at = 0.0
            await self._tell(self._help, value="help")  # Closes it.
        elif kind == "GuiTextMessage" and message["props"]["label"] == "page":
            self._bus = message["uuid"]
        content = message.get("props", message.get("updates", {}))
        text = content.get("content") if isinstance(content, dict) else None
        if not isinstance(text, str):
            return
        if "Keys and mouse" in text and not self._help:
            plain = html.unescape(text)
            found = re.search(
                r'photoreg\.send\("(widget-\d+)",\{"value": "help"', plain
            )
            self._help = found[1] if found else ""
        chosen = re.search(r'data-photo="([^"]+)" aria-pressed="true"', text)
        if chosen:
            self.seen_at[chosen[1]] = time.monotonic()
            names = re.findall(r'data-photo="([^"]+)" aria-pressed', text)
            PHOTOS[:] = names[:2]
            if SENT and SENT[-1][0] == chosen[1]:
                SEEN_MS.append(1e3 * (time.monotonic() - SENT[-1][1]))


PHOTOS: list[str] = []
SENT: list[tuple[str, float]] = []
SEEN_MS: list[float] = []


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit status: 1 if a bar was missed."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.load")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--browsers", type=int, default=10, help="all together")
    parser.add_argument("--pages", type=int, default=2, help="those in Chromium")
    chosen = parser.parse_args(arguments)
    with (
        tempfile.TemporaryDirectory(prefix="photoreg-load-") as name,
        server(Path(name) / "work") as (process, address),
        sync_playwright() as playwright,
    ):
        browser = launch(playwright)
        found = list(
            _measure(chosen, Path(name) / "work", process.pid, address, browser)
        )
        browser.close()
    for metric in found:
        verdict = {True: "reached", False: "MISSED", None: ""}[metric.reached]
        bar = "" if metric.bar is None else f"(bar {metric.bar:g}) "
        print(f"{metric.name}: {metric.value:.3g} {metric.unit} {bar}{verdict}")
        if metric.note:
            print(f"    {metric.note}")
    return 1 if any(metric.reached is False for metric in found) else 0


def _measure(
    chosen: argparse.Namespace,
    folder: Path,
    pid: int,
    address: str,
    browser: Browser,
) -> Iterator[Metric]:
    first = _page(browser, address, 0)
    first.tab("3 Refine")
    # The first run warms kernels; the second is the one that nobody watches.
    alone_s = [_run(first, folder) for _ in range(2)][1]
    windows = [first, *(_page(browser, address, i) for i in range(1, chosen.pages))]
    errors: list[str] = []
    for window in windows:
        window.page.on("pageerror", lambda error: errors.append(str(error)))
    watchers = [
        Watcher(address, i) for i in range(max(0, chosen.browsers - chosen.pages))
    ]
    before_mb, seconds, memory_mb = _rss_mb(pid), [], []
    until = time.monotonic() + 60.0 * chosen.minutes

    def crowd() -> None:
        async def all_of_them() -> None:
            await asyncio.gather(
                *(w.run(until, i == 0) for i, w in enumerate(watchers))
            )

        asyncio.run(all_of_them())

    pool = concurrent.futures.ThreadPoolExecutor(1)
    crowding = pool.submit(crowd)
    turn = 0
    while time.monotonic() < until:
        seconds.append(_run(first, folder, windows, turn))
        memory_mb.append(_rss_mb(pid))
        turn += 1
    crowding.result()
    pool.shutdown()
    answers = [ms for watcher in watchers for ms in watcher.answers_ms]
    path = folder / LOG_FILE
    log = path.read_text(encoding="utf-8") if path.exists() else ""
    n_errors = len(errors) + sum(w.n_errors for w in watchers) + log.count(" ERROR ")
    about = (
        f"{chosen.browsers} browsers ({chosen.pages} of them Chromium), "
        f"{chosen.minutes:g} min, {len(seconds)} runs"
    )
    yield Metric("load.errors", n_errors, "", "lower", 0, note=about)
    for what, taken in (("answer", answers), ("to_all", SEEN_MS)):
        if taken:
            middle = float(np.median(taken))
            note = f"median {middle:.0f}, worst {max(taken):.0f}, n={len(taken)}"
            p95 = float(np.percentile(taken, 95))
            yield Metric(f"load.{what}.p95", p95, "ms", "lower", 250.0, note=note)
    grown = memory_mb[-1] - memory_mb[0]
    note = f"{before_mb:.0f} MB before, then {', '.join(f'{m:.0f}' for m in memory_mb)}"
    yield Metric("load.memory_growth", grown, "MB", "lower", 30.0, note=note)
    ratio = float(np.median(seconds)) / alone_s
    note = f"alone {alone_s:.1f} s, then {', '.join(f'{s:.1f}' for s in seconds)}"
    yield Metric("load.run_slower", ratio, "times", "lower", 1.15, note=note)


def _page(browser: Browser, address: str, number: int) -> Driver:
    window = browser.new_page(viewport={"width": 700 + 10 * number, "height": 500})
    driver = Driver(window, address)
    driver.dismiss_toasts()
    return driver


def _run(
    page: Driver, folder: Path, moving: list[Driver] | None = None, turn: int = 0
) -> float:
    """One refinement from the page, with cameras in motion; its seconds at work."""
    n_before = len(_run_seconds(folder))
    page.click("Refine")
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
    page.click("Revert")
    page.page.get_by_role("button", name="Refine", exact=True).wait_for()
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
