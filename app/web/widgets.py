"""Controls that viser lacks, as HTML: a row of choices, a row of tool buttons."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import viser
from viser._icons import svg_from_icon

from app.model.markup import mounted
from app.web.bridge import Bridge, Values
from app.web.controls import put
from photoreg.errors import InputError
from photoreg.report.templates import part


class Option(NamedTuple):
    """One of several things to choose from."""

    label: str
    help: str = ""
    enabled: bool = True
    title: str = ""
    """What pointing at it tells, where that is not its help."""


class Tool(NamedTuple):
    """A button of a row of tools."""

    value: str
    title: str
    icon: viser.IconName | None = None
    label: str = ""
    enabled: bool = True


Heard = Callable[[viser.ClientHandle, str], object]
_numbers = itertools.count()


def help_line(text: str) -> str:
    """A line of help, which is HTML, in small print."""
    return f'<div class="pr-help">{text}</div>' if text else ""


class Choice:
    """A row of buttons of which one is chosen, with a line of help on it."""

    def __init__(
        self,
        gui: viser.GuiApi,
        bridge: Bridge,
        label: str,
        options: Mapping[Any, Option],
        on_choice: Heard,
        order: float | None = None,
    ) -> None:
        self._label = label
        self._options: dict[str, Option] = dict(options)
        self._act = _listen(bridge, on_choice, lambda value: value in self._options)
        self._html = gui.add_html("", order=order)

    def forget(self, bridge: Bridge) -> None:
        """Listens no longer: its browser has left."""
        bridge.off(self._act)

    def show(
        self,
        value: str,
        visible: bool = True,
        options: Mapping[Any, Option] | None = None,
    ) -> None:
        """Marks the one that is chosen."""
        if options is not None:
            self._options = dict(options)
        letters = sum(len(option.label) for option in self._options.values())
        # Many short words fit into one row with less around each.
        is_tight = len(self._options) > 4 and letters < 24
        is_grid = len(self._options) > 4 and not is_tight
        # Long ones, such as names of photos, are told apart at their ends.
        n = 3 if letters < 10 * len(self._options) else 2
        content = part(
            "widgets.html",
            "choice",
            act=self._act,
            label=self._label,
            chosen=value,
            options=self._options,
            shape="pr-tight" if is_tight else "pr-tight pr-columns" if is_grid else "",
            columns=n,
        )
        put(self._html, "content", content)
        put(self._html, "visible", visible)


class Tools:
    """A row of buttons; with ``repeat`` they go on while they are held.

    Held with Shift or Alt, a button's value comes with "+" or "-" after it.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        bridge: Bridge,
        label: str,
        tools: Sequence[Tool],
        on_press: Heard,
        repeat: bool = False,
        head: bool = False,
    ) -> None:
        """``head``: it stays on screen while its panel scrolls."""
        self._label = label
        self._head = mounted("head") if head else ""
        self._repeat = repeat
        self._values: set[str] = set()
        self._act = _listen(bridge, on_press, lambda value: value in self._values)
        self._html = gui.add_html("")
        self.show(tools)

    def show(self, tools: Sequence[Tool], visible: bool = True) -> None:
        """Makes the buttons as they should be now; words get the room icons leave."""
        sizes = ("", "+", "-") if self._repeat else ("",)
        self._values = {tool.value + size for tool in tools for size in sizes}
        content = part(
            "widgets.html",
            "tools",
            act=self._act,
            label=self._label,
            tools=tools,
            icons={tool.icon: _icon(tool.icon) for tool in tools if tool.icon},
            sends="hold" if self._repeat else "send",
        )
        put(self._html, "content", self._head + content)
        put(self._html, "visible", visible)


def _listen(bridge: Bridge, heard: Heard, is_there: Callable[[str], bool]) -> str:
    act = f"widget-{next(_numbers)}"

    def on_message(values: Values, client: viser.ClientHandle) -> None:
        if not is_there(values["value"]):
            raise InputError("That button is not there any more. Press another.")
        heard(client, values["value"])

    bridge.on(act, on_message, value=str)
    return act


_icons: dict[str, str] = {}


def _icon(name: viser.IconName) -> str:
    if name not in _icons:
        _icons[name] = svg_from_icon(name).replace(
            'width="24" height="24"',
            'width="16" height="16" style="vertical-align:-3px"',
        )
    return _icons[name]
