"""Names of files as they can be shown, kept and written, whatever a disk has."""

import os
import unicodedata
from pathlib import Path

TURNING = frozenset(
    "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
)
"""Marks that turn the direction of writing: "gpj.exe" shows as "exe.jpg"."""


def presentable(name: str) -> str:
    """The name with what cannot be shown or kept as the percent signs of its bytes.

    That is bytes that are no UTF-8, halves of characters, control characters, ends of
    lines and marks that turn the direction of writing. Other names stay as they are.
    """
    return "".join(c if _is_shown(c) else _percents(c) for c in name)


def _is_shown(character: str) -> bool:
    return (
        unicodedata.category(character) not in ("Cc", "Cs", "Zl", "Zp")
        and character not in TURNING
    )


def _percents(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # How Python has a byte that is no UTF-8.
        return f"%{code - 0xDC00:02X}"
    data = character.encode("utf-8", "surrogatepass")
    return "".join(f"%{byte:02X}" for byte in data)


def stored_path(path: Path) -> str | bytes:
    """A path as a database keeps it: text, or bytes where it is no text."""
    text = path.as_posix()
    try:
        text.encode()
    except UnicodeEncodeError:
        return os.fsencode(text)
    return text


def path_of(stored: str | bytes) -> Path:
    """The path that ``stored_path`` made this of."""
    return Path(os.fsdecode(stored))
