"""The page that `?` opens: every key, what the mouse does, the tour, and what this is."""

from typing import Any

import viser

from app.model.markup import escaped, mounted
from app.web.controls import guarded
from app.web.widgets import help_line
from photoreg import __version__

SECTIONS = (
    (
        "Any view",
        (
            ("Ctrl+Z · Ctrl+Shift+Z", "undo · redo"),
            ("1 … 9", "choose a photo"),
            ("J L I K", "move the object left, right, up, down in the photo"),
            ("N M", "bring the object nearer, take it farther"),
            ("U O", "roll the camera left, right"),
            ("F V", "zoom in, out; the object keeps its size"),
            ("H", "frame all: the object and the cameras"),
            ("C", "show or hide the cameras"),
            ("Shift · Alt with these", "ten times coarser · ten times finer"),
            ("Ctrl+K", "all commands, to be searched"),
            ("?", "this help"),
        ),
    ),
    (
        "Move the camera",
        (
            ("drag", "orbit: the camera circles the object"),
            ("right drag", "shift the camera"),
            ("wheel", "closer, farther"),
        ),
    ),
    (
        "3-D scene",
        (
            ("drag", "turn the scene"),
            ("right drag", "shift the scene"),
            ("wheel", "closer, farther"),
            ("W A S D Q E, arrows", "walk, turn"),
            ("drag an arrow, an arc", "move the camera, turn it"),
        ),
    ),
    (
        "Look through",
        (
            ("wheel", "zoom in and out, at the cursor"),
            ("drag, arrows", "pan"),
            ("0", "the whole photo again"),
        ),
    ),
    (
        "Points, in the photo at the left",
        (
            ("click", "a point; then the same on the model"),
            ("drag a marker", "correct it, in the photo or on the model"),
            ("wheel, drag", "zoom at the cursor, pan"),
            ("Delete", "remove the marker in focus"),
        ),
    ),
)
KEY = (
    "background:rgba(128,140,155,.2);border-radius:4px;padding:1px 6px;"
    "font-size:12px;white-space:nowrap"
)


def help_html() -> str:
    """All keys and mouse actions: a table a section, in two columns where they fit."""
    tables = ""
    for title, entries in SECTIONS:
        rows = "".join(
            f'<tr><td style="padding:2px 14px 2px 0;vertical-align:top">'
            f'<span style="{KEY}">{escaped(keys)}</span></td>'
            f'<td style="padding:2px 0">{escaped(what)}</td></tr>'
            for keys, what in entries
        )
        tables += (
            '<div style="break-inside:avoid;padding-bottom:10px"><div style="'
            f'font-weight:650;padding-bottom:3px">{title}</div>'
            f"<table>{rows}</table></div>"
        )
    return (
        '<div class="pr-keys" style="columns:2 320px;column-gap:26px;font-size:13px;'
        f'line-height:1.4;margin:0 4px">{tables}</div>'
    )


def about_html() -> str:
    """Which photoreg this is, and under which licence."""
    return (
        f"photoreg {escaped(__version__)}, free software under the MIT licence: lays "
        "photographs onto a scanned surface, precisely. <b>photoreg --help</b> lists the "
        "commands; the documentation has tutorials and a list of symptoms."
    )


class Help:
    """Opens the help, once in each browser."""

    def __init__(self) -> None:
        self._open: dict[int, Any] = {}
        self._tours: dict[int, viser.GuiHtmlHandle] = {}

    def toggle(self, client: viser.ClientHandle) -> None:
        """Opens it, or closes it where it is open."""
        modal = self._open.pop(client.client_id, None)
        if modal is not None and not modal.closed:
            modal.close()
            return
        modal = client.gui.add_modal("Help")
        self._open[client.client_id] = modal
        with modal:
            client.gui.add_html(help_html())
            client.gui.add_html(help_line(about_html()))
            tour = client.gui.add_button(
                "Tour of the page",
                color="gray",
                hint="The four hints that the demo begins with.",
            )
            close = client.gui.add_button("Close", color="gray")

        @tour.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            self.toggle(client)
            known = self._tours.pop(client.client_id, None)
            if known is not None:
                known.remove()
            self._tours[client.client_id] = client.gui.add_html(
                mounted("tour", again="yes")
            )

        @close.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            self.toggle(client)

    def forget(self, client: viser.ClientHandle) -> None:
        """The browser has left."""
        self._open.pop(client.client_id, None)
        self._tours.pop(client.client_id, None)
