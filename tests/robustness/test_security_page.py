"""SECURITY.md: each promise names tests, and these are there."""

import ast
import re
from pathlib import Path

from photoreg.limits import Limits, variable

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
TEST = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")


def promises() -> list[str]:
    section = PAGE.split("## What is promised")[1].split("\n## ")[0]
    found = re.split(r"\n- (?=\*\*)", section)[1:]
    assert len(found) > 10
    return found


def test_each_promise_names_a_test():
    for promise in promises():
        assert TEST.search(promise), promise[:60]


def test_every_test_that_is_named_is_there():
    named = TEST.findall(PAGE)
    assert len(named) > 30
    for path, name in named:
        assert name, f"{path}: which test of it?"
        tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
        functions = [n.name for n in tree.body if isinstance(n, ast.FunctionDef)]
        assert name in functions, f"there is no {path}::{name}"


def test_every_limit_is_in_the_table_with_its_default():
    for name, default in vars(Limits()).items():
        assert f"| `{variable(name)}` | {default:g} |" in PAGE
