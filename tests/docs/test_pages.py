"""The pages of the documentation: complete, linked, and made from the code."""

import importlib
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from docs import check_site, generate, rooms_drawing
from photoreg.cli.commands import commands
from photoreg.formats.cameras.registry import CAMERA_FORMATS
from tests.docs.blocks import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
SETTINGS = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
FROM_TOP = {"security.md", "contributing.md", "code-of-conduct.md", "changelog.md"}
"""Pages that docs/hooks.py takes from the top folder."""


def in_nav(entry: Any) -> list[str]:
    """The pages that the navigation names."""
    if isinstance(entry, str):
        return [entry]
    parts = entry.values() if isinstance(entry, dict) else entry
    return [page for part in parts for page in in_nav(part)]


def test_the_navigation_has_every_page_once() -> None:
    pages = [str(page.relative_to(DOCS)) for page in PAGES]
    assert sorted(in_nav(SETTINGS["nav"])) == sorted([*pages, *FROM_TOP])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_takes_from_the_code_is_there(page: Path) -> None:
    text = generate.filled(page.read_text(encoding="utf-8"))
    assert "{{" not in text
    for name in re.findall(r"^::: (\S+)$", text, re.MULTILINE):
        module, _, attribute = name.rpartition(".")
        if attribute != "errors":
            assert hasattr(importlib.import_module(module), attribute), name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page: Path) -> None:
    """`make docs` looks at the places within them, too."""
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)#\s]+)", text):
        if not link.startswith("http") and Path(link).name not in FROM_TOP:
            assert (page.parent / link).exists(), link


def test_a_name_that_nothing_has_is_noticed() -> None:
    with pytest.raises(KeyError):
        generate.filled("{{ no such thing }}")


def test_the_commands_page_has_the_help_of_every_command() -> None:
    text = generate.filled((DOCS / "commands.md").read_text())
    for name in commands():
        assert f"usage: photoreg {name}" in text
    assert "--share-focal" in text
    assert "\x1b" not in text


def test_the_formats_page_says_what_each_format_loses() -> None:
    text = generate.filled((DOCS / "formats.md").read_text())
    for known in CAMERA_FORMATS.values():
        assert f"| {known.label} |" in text
        assert known.loses.removeprefix("It loses ") in text


def test_figures_and_formats_of_the_readme_are_those_of_the_code() -> None:
    """Change figures in tests/bench/published.json, by a measurement."""
    text = generate.README.read_text(encoding="utf-8")
    assert text.count("<!-- made: ") == text.count("<!-- end -->") == 4
    assert generate.renewed(text) == text, "run `python -m docs.generate`"


def test_figures_of_the_baseline_are_rounded_and_not_typed() -> None:
    assert generate.baseline("texture.usual.memory 1") == "1.4"


MEASURED = re.compile(
    r"(?<![\d.])\d[\d.,]* (px|pixels?) off|(tenths?|quarters?) of a pixel"
    r"|a pixel or more"
)
"""Errors in pixels, as pages would state them."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_type_no_measured_error(page: Path) -> None:
    """They take it from tests/bench/published.json: `figure` and `figures`."""
    text = re.sub(r"\s+", " ", page.read_text(encoding="utf-8"))
    assert not [found.group() for found in MEASURED.finditer(text)]


def test_a_measured_error_that_is_typed_is_noticed() -> None:
    for typed in ("about 20 pixels off", "under a tenth of a pixel", "0.3 px off"):
        assert MEASURED.search(typed), typed


def test_published_figures_that_the_baseline_has_are_those_of_the_baseline() -> None:
    for statistic in ("least", "worst"):
        measured = f"bumpy_scans.true_over_estimated.{statistic} 1"
        assert generate.figure(f"bumpy_scans.{statistic}") == generate.baseline(
            measured
        )
    right, n = (int(generate.figure(f"calibration.{name}")) for name in ("within", "n"))
    assert f"{right / n:.2f}" == generate.baseline("calibration.within_twice")


def test_the_reach_that_the_pages_promise_is_in_the_table_of_accuracy() -> None:
    starts = {row["rough_px"] for row in generate.published()["accuracy"]}
    for preset in ("default", "thorough"):
        assert generate.figure(f"reach.{preset}") in starts


def test_the_drawing_has_every_room_and_its_arrows_lead_down() -> None:
    page = (DOCS / "architecture.md").read_text()
    nodes = re.findall(r'^ +(\w+)\["', page, re.MULTILINE)
    edges = re.findall(r"^ +(\w+) --> (\w+)", page, re.MULTILINE)
    floor_of = {
        node: i
        for i, row in enumerate(rooms_drawing.floors(nodes, edges))
        for node in row
    }
    assert set(floor_of) == set(nodes)
    assert all(floor_of[a] < floor_of[b] for a, b in edges)
    drawn = rooms_drawing.drawn(page)
    assert "mermaid" not in drawn
    assert drawn.count("<rect") == len(nodes)
    assert drawn.count('class="arrow"') == len(edges)


def test_faults_of_a_site_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="#here"></a><a href="b.html#there"></a>'
        '<a href="https://elsewhere.example"></a><img src="gone.png">'
        '<script src="https://elsewhere.example/x.js"></script>'
    )
    (tmp_path / "b.html").write_text('<a href="a.html#here"></a>')
    assert sorted(check_site.faults(tmp_path)) == [
        "a.html: b.html#there: there is no such place.",
        "a.html: gone.png leads nowhere.",
        "a.html: https://elsewhere.example/x.js is fetched from elsewhere.",
    ]
