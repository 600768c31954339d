"""Files on their way from a browser: as long as they said, and not too long.

viser gathers the parts of a file in memory, however many come.
"""

import dataclasses
from collections.abc import Callable

import viser
from viser import _messages
from viser.infra import WebsockClientConnection

from photoreg.limits import Limits, variable

IN_FLIGHT = 4
"""All files on their way together may be so many times the size of one."""

SMALLEST_PART = 1024
"""viser's page sends parts of 512 kB."""

MAX_NAME_CHARACTERS = 1000

Refused = Callable[[int, str, str], None]
"""Called with the browser, the file's name and a sentence."""


def too_large(name: str, size: int, limits: Limits) -> str:
    """The sentence about a file that is too large."""
    return (
        f"{name} has {size / 1e6:,.0f} MB; files of up to {limits.file_mb:,.0f} MB are "
        f"taken ({variable('file_mb')} sets the limit). Reduce it first."
    )


@dataclasses.dataclass
class _Transfer:
    browser: int
    announced: int
    received: int = 0


def limit_uploads(
    server: viser.ViserServer, limits: Limits, on_refused: Refused
) -> None:
    """Refuses files that are too large, by their announced size and by what comes.

    The page looks at sizes before it sends, and says the same; this is for what does
    not heed it.
    """
    transfers: dict[str, _Transfer] = {}
    gui = server.gui
    start, part = gui._handle_file_transfer_start, gui._handle_file_transfer_part

    def objection(message: _messages.FileTransferStartUpload) -> str | None:
        size = message.size_bytes
        if len(message.filename) > MAX_NAME_CHARACTERS:
            return "A file's name is too long."
        if size > limits.file_bytes:
            return too_large(message.filename, size, limits)
        if size < 0 or not 0 <= message.part_count <= size // SMALLEST_PART + 1:
            return f"{message.filename} says a size that cannot be; reload the page."
        for key in [k for k in transfers if k not in gui._current_file_upload_states]:
            del transfers[key]
        coming = sum(transfer.announced for transfer in transfers.values())
        if coming + size > IN_FLIGHT * limits.file_bytes:
            return (
                f"{message.filename} has to wait: {coming / 1e6:,.0f} MB of other files "
                "are on their way. Try again when they are here."
            )
        return None

    def on_start(browser: int, message: _messages.FileTransferStartUpload) -> None:
        sentence = objection(message)
        if sentence is None:
            if message.part_count:
                transfers[message.transfer_uuid] = _Transfer(
                    browser, message.size_bytes
                )
            start(browser, message)  # pyright: ignore[reportArgumentType]
            return
        # As if it were done: the page's button and message are free again.
        gui._websock_interface.queue_message(
            _messages.FileTransferPartAck(
                message.source_component_uuid, message.transfer_uuid, 1, 1
            )
        )
        on_refused(browser, message.filename, sentence)

    def on_part(browser: int, message: _messages.FileTransferPart) -> None:
        transfer = transfers.get(message.transfer_uuid)
        if transfer is None or transfer.browser != browser:
            return
        transfer.received += len(message.content)
        if transfer.received > transfer.announced:
            # More than it announced: viser would gather all of it first.
            del transfers[message.transfer_uuid]
            gui._current_file_upload_states.pop(message.transfer_uuid, None)
            return
        part(browser, message)  # pyright: ignore[reportArgumentType]

    def on_leave(connection: WebsockClientConnection) -> None:
        # viser forgets the files of pages only, not of what merely connected.
        gone = [k for k, t in transfers.items() if t.browser == connection.client_id]
        for key in gone:
            del transfers[key]
            gui._current_file_upload_states.pop(key, None)

    server._websock_server.on_client_disconnect(on_leave)
    for kind, handler in (
        (_messages.FileTransferStartUpload, on_start),
        (_messages.FileTransferPart, on_part),
    ):
        gui._websock_interface.unregister_handler(kind)
        gui._websock_interface.register_handler(kind, handler)  # pyright: ignore
