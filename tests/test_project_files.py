"""What the project says of itself beside the README: citation, contributing, metadata."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import photoreg

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()


def test_the_citation_is_of_this_version_and_names_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert {"title", "message", "authors"} <= set(citation)
    assert citation["version"] == PROJECT["version"] == photoreg.__version__
    assert citation["license"] == PROJECT["license"]
    (paper,) = citation["references"]
    names = [author["family-names"] for author in paper["authors"]]
    assert names == ["Jankó", "Chetverikov"]
    assert paper["year"] == 2004
    assert paper["title"].startswith("Photo-Consistency Based Registration")


@pytest.mark.parametrize("package", ["photoreg", "app"])
def test_type_checkers_are_told_that_the_package_is_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()


def test_the_classifiers_name_every_python_from_the_oldest_on() -> None:
    _, oldest = PROJECT["requires-python"].split(">=3.")
    named = [
        int(match[1])
        for classifier in PROJECT["classifiers"]
        if (
            match := re.fullmatch(
                r"Programming Language :: Python :: 3\.(\d+)", classifier
            )
        )
    ]
    assert named == list(range(int(oldest), max(named) + 1))
    assert PROJECT["keywords"]


def test_contributing_names_targets_and_files_that_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
    named = set(re.findall(r"(?:`|^)make ([a-z-]+)", CONTRIBUTING, re.M))
    assert named <= targets, named - targets
    assert len(named) > 4
    paths = set(
        re.findall(r"`((?:app|photoreg|tests|docs|\.ci)/[\w/.]*)`", CONTRIBUTING)
    )
    paths |= set(re.findall(r"\]\((?!http)([^)#]+)", CONTRIBUTING))
    missing = {
        path
        for path in paths
        if not (ROOT / path).exists() and not path.endswith(("acme.py", "_acme.py"))
    }
    assert not missing
    assert len(paths) > 15


@pytest.mark.parametrize("path", sorted((ROOT / ".github").rglob("*.md")))
def test_a_template_begins_with_its_name_and_what_it_is_for(path: Path) -> None:
    _, head, body = path.read_text().split("---\n", 2)
    assert set(yaml.safe_load(head)) == {"name", "about", "labels"}
    assert body.count("\n## ") >= 3
