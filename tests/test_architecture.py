"""docs/architecture.md is true, and viser's inside is known in one room."""

import ast
import importlib
import re
import tomllib

import pytest

from tests import rooms

PAGE = rooms.PAGE.read_text()
NAMES = sorted(
    set(re.findall(r"`((?:app|photoreg)(?:\.\w+)+)`", PAGE)) - {"photoreg.apps"}
)
PATHS = sorted(set(re.findall(r"`((?:app|photoreg|tests)/[\w/.]*)`", PAGE)))


def test_the_drawing_of_the_rooms_is_that_of_the_code() -> None:
    assert rooms.with_drawing(PAGE) == PAGE, "run `make rooms`"


def test_every_module_class_and_function_that_the_page_names_is_there() -> None:
    missing = [name for name in NAMES if not _is_there(name)]
    missing += [path for path in PATHS if not (rooms.ROOT / path).exists()]
    assert not missing
    assert len(NAMES) > 50
    assert len(PATHS) > 10


def _is_there(name: str) -> bool:
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        module = ".".join(parts[:n])
        try:
            found = importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise
            continue
        for attribute in parts[n:]:
            if not hasattr(found, attribute):
                return False
            found = getattr(found, attribute)
        return True
    return False


@pytest.mark.parametrize("name", ["app.model.nowhere", "photoreg.errors.NoSuchError"])
def test_a_name_that_is_gone_is_noticed(name: str) -> None:
    assert not _is_there(name)


def test_the_floors_are_few_and_nothing_is_excepted_from_them() -> None:
    settings = tomllib.loads((rooms.ROOT / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    assert not [c for c in contracts if "ignore_imports" in c]
    for package, most_floors, most_modules in (("photoreg", 12, 8), ("app", 6, 4)):
        (contract,) = [c for c in contracts if c.get("containers") == [package]]
        assert contract["exhaustive"]
        assert len(contract["layers"]) <= most_floors
        at_top = list((rooms.ROOT / package).glob("*.py"))
        assert 0 < len(at_top) <= most_modules, at_top


def test_viser_s_private_modules_are_imported_in_one_room_only() -> None:
    """Private attributes are ruff's to find (SLF001)."""
    importers = {
        str(path.relative_to(rooms.ROOT))
        for path in (rooms.ROOT / "app").rglob("*.py")
        if any(map(_is_private, _imported(ast.parse(path.read_text()))))
    }
    assert importers
    assert all(path.startswith("app/web/") for path in importers), importers


def _imported(tree: ast.Module) -> list[str]:
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def _is_private(name: str) -> bool:
    """Whether it is a part of viser that its documentation does not name."""
    root, *parts = name.split(".")
    is_inside = any(part.startswith("_") or part == "infra" for part in parts)
    return root == "viser" and is_inside
