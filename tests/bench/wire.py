"""The page's protocol without a browser: a websocket, and what comes in over it."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import viser
import websockets
import zstandard
from websockets.sync.client import connect

PROTOCOL = f"viser-v{viser.__version__}"


def unpacked(raw: bytes) -> list[dict[str, Any]]:
    """The messages of one frame of the socket; arrays are left out of them."""
    size = int.from_bytes(raw[8:16], "little")
    inner = zstandard.ZstdDecompressor().decompress(
        raw[16 : 16 + size], int.from_bytes(raw[:8], "little")
    )
    return msgspec.msgpack.decode(inner)["messages"]


def view_from(position: tuple[float, float, float]) -> bytes:
    """What a browser tells of its view of the origin; by the first it is one."""
    return msgspec.msgpack.encode(
        {
            "type": "ViewerCameraMessage",
            "wxyz": (1.0, 0.0, 0.0, 0.0),
            "position": position,
            "fov": 0.8,
            "near": 0.01,
            "far": 1000.0,
            "image_height": 700,
            "image_width": 1100,
            "look_at": (0.0, 0.0, 0.0),
            "up_direction": (0.0, 0.0, 1.0),
        }
    )


@contextlib.contextmanager
def listening(
    address: str, hear: Callable[[dict[str, Any]], None]
) -> Iterator[Callable[[bytes], None]]:
    """Calls ``hear`` with every message of the page, on a thread, meanwhile.

    It tells of a view, so that the page counts it as somebody who looks.

    Yields:
        What sends a frame as it is.
    """
    origin: Any = address
    protocols: Any = [PROTOCOL]
    socket = connect(
        address.replace("http", "ws"),
        origin=origin,
        subprotocols=protocols,
        max_size=None,
    )

    def listen() -> None:
        with contextlib.suppress(websockets.ConnectionClosed):
            for raw in socket:
                assert isinstance(raw, bytes)
                for message in unpacked(raw):
                    hear(message)

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    socket.send(view_from((3.0, 0.0, 1.0)))
    try:
        yield socket.send
    finally:
        socket.close()
        thread.join()
