"""Every command and code block of README and documentation is one that works."""

import ast
import importlib
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from photoreg.cli.commands import run
from photoreg.formats.cameras.cameras_json import load_cameras
from tests.docs.blocks import (
    OTHER_LIBRARIES,
    OTHER_PROGRAMS,
    PAGES,
    ROOT,
    Block,
    blocks,
    check_photoreg,
    hidden,
    of_language,
    words_of,
)

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
    "optional-dependencies"
]
TARGETS = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
LANGUAGES = {"sh", "python", "json", "text", "mermaid", "nginx", "caddy"}
RUN_SMALLER = {"reproduce": "tests/paper/test_reproduce.py"}
"""Commands that take half an hour as they stand, and the tests that run them smaller."""

NEED_A_CLUSTER = ("slurm.md", "kubernetes.md")
"""Pages whose commands go to a cluster that is not there."""

TO_RUN = [
    page
    for page in PAGES
    if page.name not in ("CONTRIBUTING.md", "SECURITY.md", *NEED_A_CLUSTER)
    and any(block.language == "sh" for block in blocks(page))
]


def test_every_block_says_what_it_is() -> None:
    """A block without a language, or of one unknown here, would not be looked at."""
    for page in PAGES:
        fences = re.findall(r"^ *```(\S*)", page.read_text("utf-8"), re.MULTILINE)
        assert {*fences[::2]} <= LANGUAGES, page
        assert {*fences[1::2]} <= {""}, page


def test_commands_are_those_of_the_parser_and_of_the_makefile() -> None:
    seen = 0
    for block in of_language("sh"):
        for words in words_of(block.text):
            program, *arguments = words
            seen += 1
            match program:
                case "photoreg":
                    check_photoreg(arguments)
                case "make":
                    targets = [word for word in arguments if "=" not in word]
                    assert {*targets} <= {*TARGETS}, (block.page, words)
                case "pip":
                    named = re.findall(
                        r"(?:photoreg|\.)\[([\w,]+)\]", " ".join(arguments)
                    )
                    assert {e for n in named for e in n.split(",")} <= {*EXTRAS}
                case "python":
                    assert arguments[0] == "-c"
                    ast.parse(arguments[1])
                case "cd" | "cp":
                    assert arguments
                case _:
                    assert program in OTHER_PROGRAMS, (block.page, words)
    assert seen > 40


def test_a_command_that_the_parser_does_not_know_is_noticed() -> None:
    with pytest.raises(SystemExit):
        check_photoreg(["refine", "mesh.ply", "a.jpg", "--no-such-option"])


@pytest.mark.parametrize("block", of_language("python"), ids=lambda block: block.page)
def test_python_is_python_and_its_imports_are_there(block: Block) -> None:
    for node in ast.walk(ast.parse(block.text)):
        if isinstance(node, ast.ImportFrom) and not str(node.module).startswith(
            OTHER_LIBRARIES
        ):
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                assert hasattr(module, alias.name), alias.name


@pytest.mark.parametrize("block", of_language("json"), ids=lambda block: block.page)
def test_json_is_a_file_of_cameras(block: Block, tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text(block.text)
    (camera,) = load_cameras(tmp_path / "cameras.json").cameras.values()
    (entry,) = json.loads(block.text)["cameras"]
    assert camera.lens.k1 == entry.get("distortion", {"k1": 0.0})["k1"]


@pytest.mark.slow
@pytest.mark.parametrize("page", TO_RUN, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_commands_of_a_page_run_in_their_order(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if hidden(page, "files") == ["demo"]:
        shutil.copytree(ROOT / "static" / "demo", tmp_path, dirs_exist_ok=True)
    before = "\n".join(hidden(page, "before"))
    for block in [Block(page.name, "sh", before), *blocks(page)]:
        if block.language == "python":
            exec(compile(block.text, page.name, "exec"), {"__name__": "__main__"})
        for line in words_of(block.text if block.language == "sh" else ""):
            words = [
                str(name)
                for word in line
                for name in sorted(Path().glob(word) if "*" in word else ()) or [word]
            ]
            match words:
                case ["cd", folder]:
                    monkeypatch.chdir(folder)
                case ["cp", source, target]:
                    shutil.copy(source, target)
                case ["photoreg"] | ["photoreg", "app", *_]:
                    app_serves(words[1:] or ["app"])
                case ["photoreg", command, *_] if command not in RUN_SMALLER:
                    assert run(words[1:]) == 0, words


def app_serves(arguments: list[str]) -> None:
    """Starts the app as a page says, and ends it once it says where it is."""
    command = [sys.executable, "-m", "photoreg", *arguments, "--no-browser"]
    with subprocess.Popen(
        [*command, "--port", "0"], stdout=subprocess.PIPE, text=True
    ) as app:
        assert app.stdout is not None
        said = []
        for line in iter(app.stdout.readline, ""):
            said.append(line)
            if "photoreg is at" in line:
                break
        app.terminate()
    assert said, "it ended by itself"
    assert "photoreg is at" in said[-1], said
