"""At the end of the program: what browsers have sent by then still counts."""

import asyncio
import contextlib
import logging

import viser

TIMEOUT_S = 2.0
"""How long a browser that does not answer is waited for."""
REST_S = 0.1
"""Time for what has come to be followed."""

log = logging.getLogger(__name__)


def hear_out(server: viser.ViserServer, timeout_s: float = TIMEOUT_S) -> None:
    """Waits until all that browsers had sent when this was called has been followed.

    Each is asked for an answer (a ping), which comes after what it had sent before. To
    close the connection instead would end the taking of messages first.
    """
    websocket_server = server._websock_server
    loop = websocket_server._background_event_loop
    connections = tuple(websocket_server._live_connections.values())
    if loop is None or not connections:
        return

    async def ask() -> None:
        async def one(connection: object) -> None:
            with contextlib.suppress(Exception):  # It has gone meanwhile.
                await (await connection.ping())  # pyright: ignore[reportAttributeAccessIssue]

        await asyncio.wait(
            [asyncio.create_task(one(connection)) for connection in connections],
            timeout=timeout_s,
        )
        await asyncio.sleep(REST_S)

    try:
        asyncio.run_coroutine_threadsafe(ask(), loop).result(timeout_s + 1.0)
    except (TimeoutError, RuntimeError) as error:
        log.warning("Browsers were not heard out: %s", error)
