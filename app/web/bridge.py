"""What people do in the page's own HTML, told to the server.

viser has no clicks in pictures, no lists and no dropped files. The scripts in static/
do these, and send what was done as JSON through a hidden text input.
"""

import itertools
import json
from collections.abc import Callable
from typing import Annotated, Any

import msgspec
import viser

from app.model.markup import mounted
from app.web.controls import guarded
from app.web.incoming import LARGEST_NUMBER
from photoreg.errors import InputError
from photoreg.limits import Limits

_MOST = int(LARGEST_NUMBER)
Number = Annotated[float, msgspec.Meta(ge=-_MOST, le=_MOST)]
Whole = Annotated[int, msgspec.Meta(ge=-_MOST, le=_MOST)]

Values = dict[str, Any]
Handler = Callable[[Values, viser.ClientHandle], None]


class Bridge:
    """Takes messages of the page's scripts to their handlers."""

    def __init__(self, gui: viser.GuiApi, limits: Limits) -> None:
        self.limits = limits
        self._handlers: dict[str, tuple[Handler, dict[str, Any]]] = {}
        self._text = gui.add_text("page", "", visible=False)
        self.upload = gui.add_upload_button("Files", visible=True)
        self._boot = gui.add_html(self._boot_html())
        self._arrived = gui.add_html("")
        self._count = itertools.count(1)

        @self._text.on_update
        @guarded
        def _(event: viser.GuiEvent) -> None:
            assert event.client is not None
            self._deliver(event.target.value, event.client)

    def on(self, act: str, handler: Handler, **fields: Any) -> None:
        """Calls ``handler(values, client)`` for messages of this kind.

        Args:
            act: The kind of message.
            handler: What is called.
            fields: The values it has, and their types; no others reach the handler.
        """
        self._handlers[act] = handler, fields

    def off(self, act: str) -> None:
        """Forgets the handler of this kind of message."""
        self._handlers.pop(act, None)

    def arrived(self, name: str) -> None:
        """Tells the page that a file is here, so that it sends the next one."""
        count = str(next(self._count))
        self._arrived.content = mounted("uploaded", file=name, count=count)

    def _deliver(self, text: str, client: viser.ClientHandle) -> None:
        try:
            values = json.loads(text, parse_constant=_no_number)
            json.dumps(values, ensure_ascii=False).encode()
            handler, fields = self._handlers[values["act"]]
            given = {name: values[name] for name in fields}
        except UnicodeEncodeError as error:
            raise InputError(HALF_A_CHARACTER) from error
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise InputError(NOT_UNDERSTOOD) from error
        try:
            checked = {k: msgspec.convert(given[k], fields[k]) for k in fields}
        except ValueError as error:
            raise InputError(NOT_UNDERSTOOD) from error
        handler(checked, client)

    def _boot_html(self) -> str:
        return mounted(
            "boot",
            bridge=self._text._impl.uuid,
            upload=self.upload._impl.uuid,
            bytes=str(self.limits.file_bytes),
        )


NOT_UNDERSTOOD = "The page sent something this app does not know. Reload the page."
HALF_A_CHARACTER = (
    "This text holds half a character (a lone surrogate), which cannot be kept. Type it "
    "anew."
)


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON.")
