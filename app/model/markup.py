"""HTML and Markdown that contain text from outside this program.

Names, paths and sentences come from files, other programs and other people. viser's
page inserts HTML unescaped, and HTML within Markdown too. So whatever is not written
in this program's source is escaped here, and what a click does is passed as data, which
static/page.js reads: the page's policy runs no script in an attribute.
"""

import html
import json
from typing import Any

_MARKDOWN = {ord(c): f"&#{ord(c)};" for c in "\\`*_[]<>&~|!#{}\"'"}
_MARKDOWN |= {ord(c): " " for c in "\r\n\t\v\f"}


def escaped(value: object) -> str:
    """A value as text of HTML, also within quotes."""
    return html.escape(str(value), quote=True)


def in_markdown(value: object) -> str:
    """A value as text of Markdown: one line, and nothing in it is markup or HTML.

    viser looks for pictures before Markdown is read, and would open files by their names.
    """
    return str(value).translate(_MARKDOWN)


def sending(act: str, **values: Any) -> str:
    """The attribute that has a click send this message; `app.web.bridge` takes it."""
    return f'data-send="{escaped(json.dumps([act, values]))}"'


def opening(tab: str, mode: str = "") -> str:
    """The attribute that has a click open a tab, and the photo in it in one of its modes."""
    of_mode = f' data-mode="{escaped(mode)}"' if mode else ""
    return f'data-open="{escaped(tab)}"{of_mode}'


def mounted(kind: str, **data: str) -> str:
    """HTML that the function of the page's ``photoreg.define(kind, ...)`` gets when shown."""
    fields = "".join(f' data-{name}="{escaped(text)}"' for name, text in data.items())
    return f'<span style="display:none" data-kind="{escaped(kind)}"{fields}></span>'
