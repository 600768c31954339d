"""Draws the rooms of the code into docs/architecture.md: `make rooms`.

A room is a package that the contracts of pyproject.toml place on a floor. What it says
of itself is the first sentence of its docstring; the arrows are the imports there are.
"""

import ast
import tomllib
from pathlib import Path
from typing import Any

import grimp

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- rooms: written by `make rooms` -->", "<!-- end of rooms -->"
PACKAGES = ("app", "photoreg")


def floors(package: str) -> list[list[str]]:
    """The rooms of a package, floor by floor from the top, as the contract has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    (contract,) = (
        contract
        for contract in settings["tool"]["importlinter"]["contracts"]
        if contract.get("containers") == [package]
    )
    return [
        sorted(
            f"{package}.{name.strip()}"
            for name in layer.split(":" if ":" in layer else "|")
        )
        for layer in contract["layers"]
    ]


def purpose(room: str) -> str:
    """The first sentence of what a room says of itself."""
    path = ROOT / Path(*room.split("."))
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    words = " ".join((ast.get_docstring(ast.parse(source.read_text())) or "").split())
    return words.split(". ")[0].rstrip(".") + "."


def arrows(rooms: list[str], graph: Any) -> dict[str, set[str]]:
    """Which rooms each room imports."""
    return {
        a: {
            b
            for b in rooms
            if a != b
            and graph.direct_import_exists(importer=a, imported=b, as_packages=True)
        }
        for a in rooms
    }


def without_detours(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """The arrows without those that a longer way implies, so that they can be read."""

    def below(room: str) -> set[str]:
        return imports[room].union(*map(below, imports[room]))

    return {
        room: direct - set().union(*map(below, direct))
        for room, direct in imports.items()
    }


def drawing() -> str:
    """Both packages: a picture of the arrows, and a table of the rooms.

    The picture leaves out the arrows that a longer way implies; the table has them.
    """
    graph = grimp.build_graph(*PACKAGES)
    of = {package: floors(package) for package in PACKAGES}
    rooms = [room for package in PACKAGES for floor in of[package] for room in floor]
    imports = arrows(rooms, graph)
    lines = ["```mermaid", "flowchart TD"]
    for package in PACKAGES:
        lines += [f"  subgraph {package}"]
        for floor in of[package]:
            lines += [f'    {_id(room)}["{room.partition(".")[2]}"]' for room in floor]
        lines += ["  end"]
    for room, direct in without_detours(imports).items():
        lines += [f"  {_id(room)} --> {_id(other)}" for other in sorted(direct)]
    lines += ["```"]
    for package in PACKAGES:
        lines += ["", f"| floor | room of `{package}` | what it is | imports |"]
        lines += ["|---|---|---|---|"]
        for number, floor in zip(
            range(len(of[package]), 0, -1), of[package], strict=True
        ):
            for room in floor:
                own = [
                    r.partition(".")[2]
                    for r in sorted(imports[room])
                    if r.startswith(package + ".")
                ]
                theirs = [
                    r for r in sorted(imports[room]) if not r.startswith(package + ".")
                ]
                used = ", ".join(own + theirs)
                name = room.partition(".")[2]
                lines += [f"| {number} | `{name}` | {purpose(room)} | {used} |"]
    return "\n".join(lines)


def _id(room: str) -> str:
    return room.replace(".", "_")


def with_drawing(text: str) -> str:
    """The page with the drawing between its marks."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n\n{drawing()}\n\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_drawing(PAGE.read_text()))
