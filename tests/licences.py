"""Writes the licences of what photoreg installs into docs/licences.md: `make licences`.

They are what the installed packages' own metadata says, from pyproject.toml on through all
that its dependencies depend on.
"""

import importlib.metadata
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
BEGIN, END = "<!-- licences: written by `make licences` -->", "<!-- end of licences -->"
EXTRAS = ("app", "cluster", "draco", "jxl", "report", "usd")
"""Extras that users install; the others are for developers."""

Kind = Literal["permissive", "weak copyleft", "copyleft", "unknown"]

_TEXTS = {
    "MIT": "permission is hereby granted, free of charge",
    "BSD": "redistribution and use in source and binary forms",
}
"""A sentence that only the text of a licence has."""

_CLASSIFIERS = {
    "MIT License": "MIT",
    "BSD License": "BSD",
    "Apache Software License": "Apache-2.0",
    "ISC License (ISCL)": "ISC",
    "GNU General Public License v3 or later (GPLv3+)": "GPL-3.0-or-later",
}


def licence(package: str) -> str:
    """What an installed package says of its licence, as short as it can be said.

    Its SPDX expression; else a short field, a classifier, or a text that is known.
    """
    metadata = importlib.metadata.metadata(package)
    if "License-Expression" in metadata:
        return metadata["License-Expression"]
    field = metadata["License"].strip() if "License" in metadata else ""
    classified = [
        str(name).rpartition(" :: ")[2]
        for name in metadata.get_all("Classifier", [])
        if str(name).startswith("License :: ")
    ]
    if field and len(field) < 40 and "\n" not in field:
        return field
    if classified:
        return " or ".join(_CLASSIFIERS.get(name, name) for name in classified)
    words = " ".join(field.split()).casefold()
    known = [name for name, sentence in _TEXTS.items() if sentence in words]
    return known[0] if known else "not said"


def kind(said: str) -> Kind:
    """What a licence asks of those who pass the package on."""
    if re.search(r"(?<!L)GPL", said):
        return "copyleft"
    if re.search(r"LGPL|MPL|EPL", said):
        return "weak copyleft"
    if re.search(r"MIT|BSD|Apache|TOST|ISC|PSF|Zlib|HPND|Python", said):
        return "permissive"
    return "unknown"


def installed() -> dict[str, tuple[str, ...]]:
    """Every package that photoreg installs, and which ones ask for it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    todo = [("photoreg", wanted) for wanted in project["dependencies"]]
    todo += [(f"photoreg[{e}]", wanted) for e in EXTRAS for wanted in extras[e]]
    found: dict[str, tuple[str, ...]] = {}
    while todo:
        asker, wanted = todo.pop()
        needed = Requirement(wanted)
        if needed.marker and not needed.marker.evaluate({"extra": ""}):
            continue
        name = re.sub(r"[-_.]+", "-", needed.name).lower()
        if name not in found:
            more = importlib.metadata.distribution(name).requires or []
            todo += [(name, wanted) for wanted in more]
        found[name] = tuple(sorted({*found.get(name, ()), asker}))
    return dict(sorted(found.items()))


def table() -> str:
    """The packages with their licences, a row each."""
    rows = ["| package | licence | kind | asked for by |", "|---|---|---|---|"]
    for name, askers in installed().items():
        said = licence(name)
        rows.append(f"| {name} | {said} | {kind(said)} | {', '.join(askers)} |")
    return "\n".join(rows)


def listed(page: str) -> Iterator[tuple[str, str]]:
    """Each package of the page's table, and of what kind its licence is."""
    for row in page.split(BEGIN)[1].split(END, maxsplit=1)[0].splitlines():
        cells = [cell.strip() for cell in row.split("|")[1:-1]]
        if len(cells) == 4 and cells[0] not in ("package", "---"):
            yield cells[0], cells[2]


if __name__ == "__main__":
    text = PAGE.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n\n{table()}\n\n{END}{after}")
