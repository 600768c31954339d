"""Small adapters around viser's controls: guarded callbacks, quiet writes, questions."""

import asyncio
import contextlib
import functools
import threading
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import viser

from app.model.failures import MESSAGE_SECONDS, UNFORESEEN, is_news, log_failure
from app.model.markup import in_markdown
from photoreg.errors import PhotoregError

BRAND = (38, 166, 154)
TYPING_REST_S = 1.0


def put(handle: Any, field: str, value: Any) -> None:
    """Writes a property only if it differs: viser sends every assignment."""
    if getattr(handle, field) != value:
        setattr(handle, field, value)


def put_value(handle: Any, value: Any) -> None:
    """Writes an input's value only if it differs."""
    if handle.value != value:
        handle.value = value


def put_jpeg(handle: viser.GuiImageHandle | viser.ImageHandle, jpeg: bytes) -> None:
    """Shows a JPEG file as it is: the public setter takes pixels and encodes them.

    It would do so on the thread that serves the page.
    """
    handle._data = jpeg


def guarded(
    callback: Callable[[Any], None],
) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """A callback whose errors reach the person who clicked; viser would only print.

    It runs on the event loop, in the order of the clicks, and must be quick. Events
    without a client are echoes of our own writes and are ignored.
    """

    @functools.wraps(callback)
    async def run(event: Any) -> None:
        _call(callback, event)

    return run


def guarded_all(
    callback: Callable[[Any], Coroutine[Any, Any, None]],
) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """The same for a callback that waits for others, of either kind."""

    @functools.wraps(callback)
    async def run(event: Any) -> None:
        if event.client is not None:
            with _reporting(event.client, _name(callback)):
                await callback(event)

    return run


def guarded_slow(callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """The same for callbacks that read or write files: on a thread of viser's pool."""

    @functools.wraps(callback)
    def run(event: Any) -> None:
        _call(callback, event)

    return run


def in_background(
    client: viser.ClientHandle, what: str, action: Callable[[], object]
) -> None:
    """Does what is too slow for the event loop; its errors reach this person, too."""
    threading.Thread(target=_try, args=(client, what, action), daemon=True).start()


def guarded_client(
    callback: Callable[[viser.ClientHandle], None],
) -> Callable[[viser.ClientHandle], None]:
    """The same for what is done as a browser comes or goes."""

    @functools.wraps(callback)
    def run(client: viser.ClientHandle) -> None:
        _try(client, _name(callback), lambda: callback(client))

    return run


def _call(callback: Callable[[Any], None], event: Any) -> None:
    if event.client is not None:
        _try(event.client, _name(callback), lambda: callback(event))


def _name(callback: Callable[..., object]) -> str:
    return getattr(callback, "__qualname__", "A callback")


def _try(client: viser.ClientHandle, what: str, action: Callable[[], object]) -> None:
    with _reporting(client, what):
        action()


@contextlib.contextmanager
def _reporting(client: viser.ClientHandle, what: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # noqa: BLE001 - nothing may vanish here.
        if not has_left(client, error):
            report(client, what, error)


def has_left(client: viser.ClientHandle, error: Exception) -> bool:
    """Whether ``error`` is viser's refusal to write to a browser that left meanwhile."""
    return (
        isinstance(error, RuntimeError)
        and "on a removed" in str(error)
        and client._websock_connection.get_message_buffer().done
    )


def report(client: viser.ClientHandle, what: str, error: Exception) -> None:
    """Tells one person, and the log what nobody foresaw, that something failed.

    What is on that person's screen already is not told again.
    """
    foreseen = isinstance(error, PhotoregError)
    title = "That is not possible" if foreseen else "That did not work"
    text = str(error) if foreseen else UNFORESEEN
    if not foreseen:
        log_failure(what, error)
    if is_news(client.client_id, f"{what}: {error}"):
        notify(client, title, text)


Typing = tuple[float | None, ...]
"""Numbers that were typed, None for those that were not touched."""


class Typed:
    """A number, or a row of them, that is typed: taken at once where it is valid.

    Every keystroke arrives, so a value may be refused only because it is half typed.
    While somebody types, nothing is written into the control: it would undo the key
    struck meanwhile. When typing has rested, a refusal is told, and the value in force
    shown.
    """

    def __init__(self, handle: Any, take: Callable[[Typing], None]) -> None:
        self.handle = handle
        self._take = take
        self._shown: tuple[float, ...] = ()
        self._rest: asyncio.TimerHandle | None = None
        handle.on_update(guarded(self._on_update))

    def show(self, value: tuple[float, ...]) -> None:
        """Shows the value in force, as soon as nobody types here."""
        self._shown = value
        if self._rest is None:
            put_value(self.handle, value if len(value) > 1 else sum(value))

    def _on_update(self, event: Any) -> None:
        if self._rest is not None:
            self._rest.cancel()
        refusal = self._refusal()
        # On the loop, like this callback: nothing comes after the page has closed.
        self._rest = asyncio.get_running_loop().call_later(
            TYPING_REST_S, self._on_rest, event.client, refusal
        )

    def _refusal(self) -> str | None:
        """Takes what is typed; the sentence that tells why not, where it is refused."""
        typed = self.handle.value
        typed = tuple(typed) if isinstance(typed, tuple | list) else (typed,)
        shown = self._shown or (None,) * len(typed)
        new = tuple(
            None if value == old else float(value)
            for value, old in zip(typed, shown, strict=True)
        )
        if any(value is not None for value in new):
            try:
                self._take(new)
            except PhotoregError as error:
                return str(error)
        return None

    def _on_rest(self, client: viser.ClientHandle, refusal: str | None) -> None:
        self._rest = None
        self.show(self._shown)
        if refusal is not None:
            notify(client, "That is not possible", refusal)


def notify(client: viser.ClientHandle, title: str, text: str, bad: bool = True) -> None:
    """Shows a message to one browser, for some seconds."""
    client.add_notification(
        title,
        text,
        color="red" if bad else "teal",
        auto_close_seconds=MESSAGE_SECONDS,
    )


def confirm(
    client: viser.ClientHandle,
    title: str,
    text: str,
    yes: str,
    then: Callable[[], None],
) -> None:
    """Asks one browser before something is done; that may take long."""
    modal = client.gui.add_modal(title)
    with modal:
        client.gui.add_markdown(in_markdown(text))
        do_it = client.gui.add_button(yes, color="red")
        leave_it = client.gui.add_button("Cancel", color="gray")

    @do_it.on_click
    @guarded_slow
    def _(_: viser.GuiEvent) -> None:
        modal.close()
        then()

    @leave_it.on_click
    @guarded
    def _(_: viser.GuiEvent) -> None:
        modal.close()
