"""Controls that viser lacks, as HTML: a row of choices, a row of tool buttons."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import viser
from viser._icons import svg_from_icon

from app.model.markup import escaped, mounted, sending
from app.web.bridge import Bridge, Values
from app.web.controls import put
from photoreg.errors import InputError

SELECTED = "background:#26a69a;color:#04211e;font-weight:600"
ROW = "display:flex;align-items:center;margin:0 12px 8px"
LABEL = "width:5.6em;flex:none;font-size:13px;opacity:.7"
TROUGH = (
    "display:flex;flex-wrap:wrap;gap:2px;padding:2px;border-radius:7px;flex:1;"
    "min-width:0;background:rgba(128,140,155,.18)"
)
BUTTON = (
    "flex:1 1 auto;min-width:0;max-width:100%;border:0;border-radius:5px;padding:4px "
    "8px;font:inherit;font-size:12.5px;line-height:1.35;cursor:pointer;color:inherit;"
    "background:transparent;white-space:nowrap;overflow:hidden;text-overflow:ellipsis"
)
COLUMNS = ";display:grid;grid-template-columns:repeat({n},auto)"
SMALL_BUTTON = (
    "font:inherit;font-size:12.5px;color:inherit;background:rgba(128,140,155,.25);border:0;"
    "border-radius:5px;padding:3px 10px;cursor:pointer"
)
"""Of a button within a line of text."""
HELP = "margin:-3px 14px 9px;font-size:12.5px;line-height:1.35;opacity:.75"


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
    return f'<div style="{HELP}">{text}</div>' if text else ""


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
        columns = COLUMNS.format(n=n) if is_grid else ""
        buttons = "".join(
            _button(
                _sending(self._act, key),
                escaped(option.label),
                f'role="radio" aria-checked="{str(key == value).lower()}" '
                f'title="{escaped(option.title or _plain(option.help))}"',
                (SELECTED if key == value else "")
                + (";padding:4px 3px" if is_tight or columns else ""),
                option.enabled,
            )
            for key, option in self._options.items()
        )
        # All lie over each other, so that what comes below keeps its place.
        helps = "".join(
            f'<div style="grid-area:1/1{"" if key == value else ";visibility:hidden"}">'
            f"{option.help}</div>"
            for key, option in self._options.items()
            if option.help
        )
        put(
            self._html,
            "content",
            f'<div style="{ROW}"><div style="{LABEL}">{escaped(self._label)}</div>'
            f'<div style="{TROUGH}{columns}" role="radiogroup" aria-label='
            f'"{escaped(self._label)}">{buttons}</div></div>'
            + (f'<div style="{HELP};display:grid">{helps}</div>' if helps else ""),
        )
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
        worded = any(tool.label for tool in tools)
        buttons = "".join(
            _button(
                (_holding if self._repeat else _sending)(self._act, tool.value),
                (_icon(tool.icon) if tool.icon else "") + escaped(tool.label),
                f'aria-label="{escaped(tool.title)}" title="{escaped(tool.title)}"',
                f"flex:{1 if tool.label or not worded else '0 0 30px'};padding:4px 3px"
                ";text-align:center;white-space:normal",
                tool.enabled,
            )
            for tool in tools
        )
        label = (
            f'<div style="{LABEL}">{escaped(self._label)}</div>' if self._label else ""
        )
        put(
            self._html,
            "content",
            f'{self._head}<div style="{ROW}">{label}'
            f'<div style="{TROUGH};flex-wrap:nowrap">'
            f"{buttons}</div></div>",
        )
        put(self._html, "visible", visible)


def _listen(bridge: Bridge, heard: Heard, is_there: Callable[[str], bool]) -> str:
    act = f"widget-{next(_numbers)}"

    def on_message(values: Values, client: viser.ClientHandle) -> None:
        if not is_there(values["value"]):
            raise InputError("That button is not there any more. Press another.")
        heard(client, values["value"])

    bridge.on(act, on_message, value=str)
    return act


def _sending(act: str, value: str) -> str:
    return sending(act, value=value)


def _holding(act: str, value: str) -> str:
    """Goes on telling ``value`` while held."""
    return sending(act, value=value).replace("data-send", "data-hold", 1)


def _button(action: str, inner: str, attributes: str, style: str, enabled: bool) -> str:
    state = "" if enabled else " disabled"
    dim = "" if enabled else ";opacity:.35;cursor:default"
    return (
        f'<button type="button" {attributes} {action} style="{BUTTON};{style}{dim}"'
        f"{state}>{inner}</button>"
    )


_icons: dict[str, str] = {}


def _icon(name: viser.IconName) -> str:
    if name not in _icons:
        _icons[name] = svg_from_icon(name).replace(
            'width="24" height="24"',
            'width="16" height="16" style="vertical-align:-3px"',
        )
    return _icons[name]


def _plain(text: str) -> str:
    return text.replace("<b>", "").replace("</b>", "")
