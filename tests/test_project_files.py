"""What the project says of itself beside the README: citation, contributing, metadata."""

import ast
import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

import photoreg

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FOR_THE_ENGINE = ("cluster", "draco", "jxl", "report", "usd")
"""Extras that let the engine do more."""

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


def test_the_changelog_has_this_version_below_what_is_unreleased() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    this = f"{photoreg.__version__} - {citation['date-released']}"
    assert headings[:2] == ["Unreleased", this]


def test_the_image_for_kubernetes_is_of_this_version() -> None:
    page = (ROOT / "docs" / "batch" / "kubernetes.md").read_text()
    assert re.findall(r"/photoreg:([\d.]+)", page) == [photoreg.__version__]


def named_packages(requirements: list[str]) -> set[str]:
    """The packages of requirements that hold without an extra, in small letters."""
    found = map(Requirement, requirements)
    return {
        wanted.name.lower()
        for wanted in found
        if not wanted.marker or wanted.marker.evaluate({"extra": ""})
    }


def imported_packages(folder: Path) -> set[str]:
    """The packages that the modules of a folder import, as an index names them."""
    packages = importlib.metadata.packages_distributions()
    modules = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                modules |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                modules.add(node.module)
    roots = {name.partition(".")[0] for name in modules} - sys.stdlib_module_names
    names = [packages.get(root, [root])[0] for root in roots - {"app", "photoreg"}]
    return {name.lower().replace("_", "-") for name in names}


def test_the_engine_depends_on_what_it_imports() -> None:
    always = named_packages(PROJECT["dependencies"])
    extras = PROJECT["optional-dependencies"]
    by_choice = named_packages(
        [package for name in FOR_THE_ENGINE for package in extras[name]]
    )
    imported = imported_packages(ROOT / "photoreg")
    # Distributed brings Dask.
    assert imported - {"dask"} <= always | by_choice
    assert len(imported) > 15


def test_the_app_depends_on_what_it_imports() -> None:
    own = named_packages(PROJECT["optional-dependencies"]["app"])
    # Of one version of viser, so that what comes with it is known.
    with_viser = named_packages(importlib.metadata.requires("viser") or [])
    imported = imported_packages(ROOT / "app")
    assert imported <= own | with_viser | named_packages(PROJECT["dependencies"])
    assert own <= imported


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
