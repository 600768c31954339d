"""Code blocks of README and documentation: found, looked at, and run page by page.

A page is one session in one folder. Comments that readers do not see say how it begins:
``<!-- files: demo -->`` with the demo's files in it, ``<!-- before: COMMAND -->`` with
what a command makes.
"""

import dataclasses
import functools
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tyro

from photoreg.cli.commands import commands

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
        *(ROOT / "docs").rglob("*.md"),
    ]
)
OTHER_PROGRAMS = ("ssh", ".venv/bin/pytest")
"""Programs that the tests do not run."""

OTHER_LIBRARIES = ("dask_jobqueue", "dask_kubernetes")
"""Libraries that need a cluster to be of any use, and that the tests do not install."""

_BLOCK = re.compile(r"^( *)```(\w+)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)


@dataclasses.dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    """From the top folder."""
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, in order."""
    where = str(page.relative_to(ROOT))
    text = page.read_text(encoding="utf-8")
    return [
        Block(where, language, re.sub(rf"^{indent}", "", body, flags=re.MULTILINE))
        for indent, language, body in _BLOCK.findall(text)
    ]


def of_language(language: str) -> list[Block]:
    """All blocks of a language."""
    return [b for page in PAGES for b in blocks(page) if b.language == language]


def words_of(text: str) -> Iterator[list[str]]:
    """The command lines of a block, each in words; settings before it are left out."""
    for line in text.splitlines():
        words = shlex.split(line, comments=True)
        while words and re.match(r"[A-Z_]+=", words[0]):
            words.pop(0)
        if words:
            yield words


def hidden(page: Path, name: str) -> list[str]:
    """What a page says in ``<!-- name: ... -->``."""
    return re.findall(
        rf"^<!-- {name}: (.*) -->$", page.read_text("utf-8"), re.MULTILINE
    )


def check_photoreg(argv: list[str]) -> None:
    """Has the command line's own parser read the words, without doing what they say.

    Raises:
        SystemExit: if it refuses them.
    """
    argv = argv or ["app"]
    tyro.extras.subcommand_cli_from_dict(
        {name: _inert(command) for name, command in commands(argv).items()},
        prog="photoreg",
        args=argv,
    )


def _inert(command: Callable[..., int]) -> Callable[..., int]:
    @functools.wraps(command)
    def inert(*args: Any, **kwargs: Any) -> int:
        return 0

    return inert
