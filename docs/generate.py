"""What the documentation takes from the code, so that it stays true.

A page says ``{{ name }}`` or ``{{ name argument }}`` on a place of its own, and gets
Markdown. `docs/hooks.py` calls ``filled`` for MkDocs, the tests call it without. The README, which is read as it stands, has the same
between ``<!-- made: name -->`` and ``<!-- end -->``; `python -m docs.generate` renews it.
"""

import contextlib
import importlib
import io
import json
import os
import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

from photoreg.cli.commands import commands, run
from photoreg.formats.cameras.registry import CAMERA_FORMATS
from photoreg.formats.meshes.read import MESH_SUFFIXES
from photoreg.formats.models.registry import TEXTURED_FORMATS
from photoreg.formats.photos.registry import PHOTO_FORMATS, formats_in_words
from photoreg.words import listed

ROOT = Path(__file__).resolve().parents[1]
PUBLISHED = ROOT / "tests" / "bench" / "published.json"
BASELINE = ROOT / "tests" / "bench" / "baseline.json"
HELP_COLUMNS = 98

README = ROOT / "README.md"

_MADE = re.compile(r"(<!-- made: ([^>]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_PLACEHOLDER = re.compile(r"\{\{ ([^{}]+) \}\}")


def filled(text: str) -> str:
    """A page with what stands in its braces.

    Raises:
        KeyError: if nothing is called so.
    """
    return _PLACEHOLDER.sub(lambda found: _fill(found[1]), text)


def renewed(text: str) -> str:
    """The README with what stands between its marks."""

    def made(found: re.Match[str]) -> str:
        content = _fill(found[2])
        if "\n" not in content:
            content = textwrap.fill(content, 104)
        # A table needs an empty line around it.
        space = "\n" if content.startswith("|") else ""
        return f"{found[1]}{space}{content}\n{space}{found[3]}"

    return _MADE.sub(made, text)


def _fill(words: str) -> str:
    if words in _TABLES:
        return _TABLES[words]()
    name, _, argument = words.partition(" ")
    return _WITH_ARGUMENT[name](argument)


def help_of(command: str) -> str:
    """What `photoreg COMMAND --help` prints, without colours."""
    printed = io.StringIO()
    plain = {"COLUMNS": str(HELP_COLUMNS), "NO_COLOR": "1", "TERM": "dumb"}
    with (
        mock.patch.dict(os.environ, plain),
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        run([command, "--help"])
    return "\n".join(line.rstrip() for line in printed.getvalue().splitlines())


def _commands() -> str:
    return "\n\n".join(
        f"## photoreg {name}\n\n```text\n{help_of(name)}\n```" for name in commands()
    )


def _camera_formats() -> str:
    rows = ["| format | `--to` | path | keeps | loses |", "|---|---|---|---|---|"]
    for name, known in CAMERA_FORMATS.items():
        path = "a folder" if known.is_folder else f"`{known.place}`"
        choice = f"`{name}`" if known.save is not None else "read only"
        keeps = known.keeps.removeprefix("It keeps ")
        loses = known.loses.removeprefix("It loses ")
        rows.append(f"| {known.label} | {choice} | {path} | {keeps} | {loses} |")
    return "\n".join(rows)


def _photo_formats() -> str:
    rows = ["| format | suffixes |", "|---|---|"]
    for known in PHOTO_FORMATS:
        suffixes = " ".join(f"`{suffix}`" for suffix in known.suffixes)
        rows.append(f"| {known.name} | {suffixes} |")
    return "\n".join(rows)


def _formats_in_words() -> str:
    meshes = [f"`{suffix}`" for suffix in MESH_SUFFIXES]
    models = [f"`{suffix}`" for suffix in TEXTURED_FORMATS]
    both, read, written = {}, {}, {}
    for known in CAMERA_FORMATS.values():
        kind = read if known.save is None else written if known.load is None else both
        kind[known.label.partition(" (")[0].replace(", ", "/")] = None
    return (
        f"**Meshes**: {listed(meshes)}; **textured models**: {listed(models)}. "
        f"**Photos**: {formats_in_words()}. **Cameras**: {listed([*both])}; "
        f"{listed([*read])} is read only, {listed([*written])} written only."
    )


def _mesh_formats() -> str:
    return f"Read: {', '.join(f'`{suffix}`' for suffix in MESH_SUFFIXES)}."


def _model_formats() -> str:
    suffixes = [f"`{suffix}`" for suffix in TEXTURED_FORMATS]
    return f"Written by `photoreg texture` and the Export tab: {', '.join(suffixes)}."


def published() -> dict[str, Any]:
    """The figures that README and documentation show."""
    return json.loads(PUBLISHED.read_text(encoding="utf-8"))


def figure_row(row: dict[str, Any]) -> str:
    """A row of the table of accuracy."""
    refined = ", ".join(
        f"{mean} ({worst})" if worst else mean for mean, worst in row["refined_px"]
    )
    cells = (row["photos"], row["starts"], row["rough_px"], refined, row["cpu_s"])
    return f"| {row['scene']} | {' | '.join(cells)} |"


def _figures_table() -> str:
    return "\n".join(
        [
            "| scene | photos | starts | rough, px | refined: mean (worst), px | CPU s |",
            "|---|---|---|---|---|---|",
            *map(figure_row, published()["accuracy"]),
        ]
    )


def summary_table() -> str:
    """The rows of the table of accuracy that are marked for the first page."""
    rows = [row for row in published()["accuracy"] if row.get("on_first_page")]
    lines = ["| scene | starts off by | ends off by: mean (worst) |", "|---|---|---|"]
    for row in rows:
        refined = ", ".join(
            f"{mean} ({w}) px" if w else f"{mean} px" for mean, w in row["refined_px"]
        )
        lines.append(f"| {row['first_page_name']} | {row['rough_px']} px | {refined} |")
    return "\n".join(lines)


def _sentence(name: str) -> str:
    entry = published()["sentences"][name]
    return entry["text"].format(**entry.get("values", {}))


def figure(path: str) -> str:
    """One value of a sentence: ``sentence.value``."""
    sentence, _, value = path.partition(".")
    return str(published()["sentences"][sentence]["values"][value])


def _value(path: str) -> str:
    module, _, name = path.rpartition(".")
    return f"{getattr(importlib.import_module(module), name):,.9g}"


def _file(path: str) -> str:
    text = (ROOT / path).read_text(encoding="utf-8").rstrip()
    return f"```python\n{text}\n```"


def _notebook(path: str) -> str:
    """The cells of a notebook, without its title."""
    cells = json.loads((ROOT / path).read_text(encoding="utf-8"))["cells"]
    sources = [(cell["cell_type"], "".join(cell["source"])) for cell in cells]
    return "\n\n".join(
        f"```python\n{source}\n```"
        if kind == "code"
        else re.sub(r"^# .*\n+", "", source)
        for kind, source in sources
    )


def baseline(key: str) -> str:
    """A figure of the committed baseline, to two digits."""
    name, _, digits = key.partition(" ")
    value = json.loads(BASELINE.read_text(encoding="utf-8"))[name]
    return f"{value:.{digits or 2}f}"


_TABLES: dict[str, Callable[[], str]] = {
    "commands": _commands,
    "camera formats": _camera_formats,
    "photo formats": _photo_formats,
    "formats in words": _formats_in_words,
    "mesh formats": _mesh_formats,
    "model formats": _model_formats,
    "figures table": _figures_table,
    "figures summary": summary_table,
    "machine": lambda: published()["machine"],
}
_WITH_ARGUMENT: dict[str, Callable[[str], str]] = {
    "figures": _sentence,
    "figure": figure,
    "value": _value,
    "file": _file,
    "notebook": _notebook,
    "baseline": baseline,
}


if __name__ == "__main__":
    README.write_text(renewed(README.read_text(encoding="utf-8")), encoding="utf-8")
