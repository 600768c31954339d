"""What browsers send, checked before viser acts on it.

viser 1.1.1 sets whatever attribute of a widget a message names, casts values without
looking, and ends a connection by whatever it cannot decode. Only kinds of messages that
its page sends come in, of the types they declare, and of a widget only a value that a
person could give it. All else is dropped, with a line in the log.
"""

import dataclasses
import logging
import math
from collections.abc import Callable, Iterable
from typing import Any

import msgspec
import viser
from viser import _messages, _viser
from viser._gui_api import GuiApi
from viser.infra import _infra
from websockets.asyncio.server import ServerConnection

from app.model.failures import is_news
from app.web.controls import notify
from photoreg.errors import InputError

log = logging.getLogger(__name__)

LARGEST_NUMBER = 1e15
"""Of every number that is typed: its digits survive JavaScript, msgpack and SQLite."""

LONGEST_TEXT = 1_000
"""Characters that a person types into one box."""

LONGEST_MESSAGE = 1_000_000
"""Characters of what the page's scripts send through the text input nobody sees."""

LONGEST_NAME = 10_000
"""Characters of identifiers, names of files and of nodes of the scene."""

LARGEST_CANVAS_PX = 1 << 16

KINDS = {
    kind.__name__: kind
    for kind in (
        _messages.CommandTriggerMessage,
        _messages.FileTransferPart,
        _messages.FileTransferStartUpload,
        _messages.GuiButtonHoldMessage,
        _messages.GuiUpdateMessage,
        _messages.SceneNodeClickMessage,
        _messages.SceneNodeDragMessage,
        _messages.ScenePointerMessage,
        _messages.TransformControlsDragEndMessage,
        _messages.TransformControlsDragStartMessage,
        _messages.TransformControlsUpdateMessage,
        _messages.ViewerCameraMessage,
    )
}
"""What viser's page sends to an app without forms, pictures of the view and sharing."""


class NotUnderstoodError(ValueError):
    """A message that viser's page does not send."""


def check_incoming() -> None:
    """Has all servers of viser made from now on check what comes in."""
    _infra._message_consumer = _consume  # pyright: ignore[reportAttributeAccessIssue]
    _viser.GuiApi = CheckedGuiApi  # pyright: ignore[reportPrivateImportUsage]


async def _consume(
    websocket: ServerConnection,
    handle_message: Callable[[Any], None],
    message_class: type,  # noqa: ARG001 - viser's signature.
) -> None:
    """Takes in the messages of one browser until it leaves."""
    while True:
        raw = await websocket.recv()
        try:
            message = understood(raw)
        except NotUnderstoodError as error:
            _drop(str(error))
        else:
            handle_message(message)


def understood(raw: str | bytes) -> Any:
    """The message of a frame of the socket.

    Raises:
        NotUnderstoodError: if it is damaged, of another kind or of other types than the
            page sends, or if a number in it is not finite.
    """
    if not isinstance(raw, bytes):
        raise NotUnderstoodError("text instead of msgpack")
    try:
        content = msgspec.msgpack.decode(raw)
    except (ValueError, RecursionError) as error:
        raise NotUnderstoodError(f"damaged msgpack ({error})") from error
    if not isinstance(content, dict):
        raise NotUnderstoodError("no message")
    name = content.pop("type", None)
    kind = KINDS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise NotUnderstoodError(f"an unknown kind of message, {name!r:.80}")
    try:
        message = msgspec.convert(content, kind)
    except (ValueError, RecursionError) as error:
        raise NotUnderstoodError(f"{name}: {error}") from error
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        if isinstance(value, str) and len(value) > LONGEST_NAME:
            raise NotUnderstoodError(f"{name}: {field.name} is too long")
        if not all(abs(number) <= LARGEST_NUMBER for number in _numbers(value)):
            raise NotUnderstoodError(f"{name}: {field.name} is out of bounds")
    problem = _CHECKS.get(kind, lambda _: None)(message)
    if problem:
        raise NotUnderstoodError(f"{name}: {problem}")
    return message


def _numbers(value: object) -> Iterable[float]:
    """The numbers of a field; values of widgets are looked at with their widget."""
    if isinstance(value, float | int):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)


def _view_problem(view: _messages.ViewerCameraMessage) -> str | None:
    if not all(
        0 <= n <= LARGEST_CANVAS_PX for n in (view.image_width, view.image_height)
    ):
        return "no canvas has that size"
    if not 0.0 < view.fov < math.pi:
        return "no camera has that field of view"
    if not _is_rotation(view.wxyz):
        return "wxyz is no rotation"
    return None


def _is_rotation(wxyz: tuple[float, ...]) -> bool:
    return math.isclose(math.hypot(*wxyz), 1.0, abs_tol=0.01)


def _pointer_problem(pointer: _messages.ScenePointerMessage) -> str | None:
    if pointer.event_type == "click":
        is_whole = pointer.ray_origin and pointer.ray_direction and pointer.screen_pos
        return None if is_whole else "a click without its ray"
    return None if len(pointer.screen_pos) == 2 else "a box has two corners"


_CHECKS: dict[type, Callable[[Any], str | None]] = {
    _messages.ViewerCameraMessage: _view_problem,
    _messages.ScenePointerMessage: _pointer_problem,
    _messages.TransformControlsUpdateMessage: lambda pull: (
        None if _is_rotation(pull.wxyz) else "wxyz is no rotation"
    ),
}


class CheckedGuiApi(GuiApi):
    """viser's widgets, which take only what a person could give them."""

    async def _handle_gui_updates(
        self, client_id: Any, message: _messages.GuiUpdateMessage
    ) -> None:
        handle = self._gui_input_handle_from_uuid.get(message.uuid)
        if handle is None or handle._impl.removed:
            return  # Pressed as it went; or the other of viser's two tables has it.
        if set(message.updates) != {"value"}:
            _drop(f"{', '.join(message.updates)!r:.80} of a widget to be set")
            return
        try:
            message.updates["value"] = checked_value(handle, message.updates["value"])
        except NotUnderstoodError as error:
            _drop(f"{type(handle).__name__}: {error}")
        except InputError as error:
            # Somebody typed it: told, and what is in force is shown again.
            self._websock_interface.queue_message(
                _messages.GuiUpdateMessage(message.uuid, {"value": handle.value})
            )
            client = self._resolve_client(client_id)
            if client is not None and is_news(client_id, str(error)):
                notify(client, "That is not possible", str(error))
        else:
            await super()._handle_gui_updates(client_id, message)


def checked_value(handle: Any, value: object) -> Any:
    """The value for a widget, as its type and within its bounds.

    Raises:
        NotUnderstoodError: if the page never sends such a value for this widget.
        InputError: if it is a number or a text that can be typed, but is too large.
    """
    for kind, check in _VALUES.items():
        if isinstance(handle, kind):
            return check(handle, value)
    raise NotUnderstoodError("it sends no values")


def _pressed(_: object, value: object) -> bool:
    if value is not True:
        raise NotUnderstoodError("a button is pressed by true")
    return True


def _ticked(_: object, value: object) -> bool:
    if not isinstance(value, bool):
        raise NotUnderstoodError("a tick is true or false")
    return value


def _text(handle: viser.GuiTextHandle, value: object) -> str:
    if not isinstance(value, str) or "\0" in value:
        raise NotUnderstoodError("no text")
    if len(value) > (LONGEST_TEXT if handle.visible else LONGEST_MESSAGE):
        raise InputError(
            f"{handle.label} should have up to {LONGEST_TEXT:,} characters, but has "
            f"{len(value):,}."
        )
    return value


def _option(handle: viser.GuiDropdownHandle[str], value: object) -> str:
    if not isinstance(value, str) or value not in handle.options:
        raise NotUnderstoodError("none of its options")
    return value


def _number(handle: Any, value: object) -> float | int:
    return type(handle.value)(_typed(handle, value))


def _on_slider(handle: Any, value: object) -> float | int:
    # Half of a number that is typed beside it may lie outside.
    checked = min(max(_finite(value), handle.min), handle.max)
    return type(handle.value)(checked)


def _vector(handle: Any, value: object) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or len(value) != len(handle.value):
        raise NotUnderstoodError("not as many numbers as it has")
    return tuple(float(_typed(handle, part)) for part in value)


def _colour(_: object, value: object) -> tuple[int, ...]:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise NotUnderstoodError("a colour has three parts")
    return tuple(round(min(max(_finite(part), 0), 255)) for part in value)


def _typed(handle: Any, value: object) -> float | int:
    number = _finite(value)
    if abs(number) > LARGEST_NUMBER:
        raise InputError(
            f"{handle.label} should lie between {-LARGEST_NUMBER:g} and "
            f"{LARGEST_NUMBER:g}, but is {number:g}."
        )
    return number


def _finite(value: object) -> float | int:
    if isinstance(value, bool) or not isinstance(value, float | int):
        raise NotUnderstoodError("no number")
    if not math.isfinite(value):
        raise NotUnderstoodError("not finite")
    return value


_VALUES: dict[type, Callable[[Any, object], Any]] = {
    viser.GuiButtonHandle: _pressed,
    viser.GuiCheckboxHandle: _ticked,
    viser.GuiTextHandle: _text,
    viser.GuiDropdownHandle: _option,
    viser.GuiNumberHandle: _number,
    viser.GuiSliderHandle: _on_slider,
    viser.GuiVector2Handle: _vector,
    viser.GuiVector3Handle: _vector,
    viser.GuiRgbHandle: _colour,
}
"""How each kind of widget that the app has takes a value."""


def _drop(what: str) -> None:
    if is_news(None, what):
        log.warning("Dropped what a browser sent: %s", what)
