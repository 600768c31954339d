"""viser's buffer of messages between threads."""

import asyncio
import threading

import pytest
from viser import _messages

from app.web.access import AccessControl, start_viser
from app.web.photo_server import PhotoServer
from app.web.viser_patches import LoopEvent, ThreadSafeBuffer
from tests.browser.driver import wait_until

N_BROWSERS, N_MESSAGES = 30, 3_000


@pytest.fixture
def loop():
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    yield loop
    asyncio.run_coroutine_threadsafe(_wind_up(), loop).result(10)
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()


async def _wind_up() -> None:
    left = asyncio.all_tasks() - {asyncio.current_task()}
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)
    await asyncio.get_running_loop().shutdown_asyncgens()


def test_messages_of_another_thread_reach_every_browser(loop):
    buffer = ThreadSafeBuffer(loop, persistent_messages=True)
    buffer.window_duration_sec = 0.0

    last = _messages.SetGuiPanelLabelMessage("last")

    async def browse(number: int) -> int:
        async for window in buffer.window_generator(number):
            for message in window:
                if message == last:
                    return number
        return -1

    browsers = [
        asyncio.run_coroutine_threadsafe(browse(number), loop)
        for number in range(N_BROWSERS)
    ]
    for i in range(N_MESSAGES):
        buffer.push(_messages.SetGuiPanelLabelMessage(str(i)))
    buffer.push(last)
    assert [browser.result(60) for browser in browsers] == list(range(N_BROWSERS))


def test_another_thread_leaves_the_loops_waiters_alone(loop):
    event = LoopEvent(loop)
    waiting = asyncio.run_coroutine_threadsafe(event.wait(), loop)
    wait_until(lambda: event._waiters, "it waits")
    event.set()
    assert not any(waiter.done() for waiter in event._waiters)
    loop.call_soon_threadsafe(event.set)
    assert waiting.result(10)


def test_the_page_uses_it():
    server = start_viser(AccessControl(), 0, PhotoServer())
    try:
        assert isinstance(server._websock_server._broadcast_buffer, ThreadSafeBuffer)
    finally:
        server.stop()
