"""Files that lie: each is read right or refused in a sentence, and nothing else happens.

The run writes what each got to build/lying-input/, a Markdown table a kind.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from photoreg.errors import PhotoregError
from tests.lying_input import (
    Case,
    camera_cases,
    described,
    mesh_cases,
    photo_cases,
    read,
)

TABLES = Path(__file__).parents[1] / "build" / "lying-input"


def got(case: Case, folder: Path) -> str:
    try:
        return described(read(case, folder))
    except PhotoregError as error:
        return str(error).replace(f"{folder}/", "")
    except Exception as error:  # noqa: BLE001 - this is what the test is about.
        return f"CRASH {type(error).__name__}: {error}"


def faults(case: Case, answer: str) -> str | None:
    """What is wrong with an answer; None if nothing is."""
    if answer.startswith("CRASH"):
        return "not a sentence of photoreg"
    if (
        answer.startswith("read:")
        and not answer.endswith(case.expected)
        and ("texture coordinates" in case.expected)
    ):
        return "took more than it may"
    if case.expected not in answer:
        return f"expected {case.expected!r}"
    if len(answer) > 400 or "\n" in answer:
        return "too long for a message"
    if not answer.startswith("read:") and not re.search(r"[.?]$", answer):
        return "not a whole sentence"
    return None


@pytest.mark.parametrize(
    ("kind", "cases"),
    [("meshes", mesh_cases), ("photos", photo_cases), ("cameras", camera_cases)],
)
def test_every_lie_gets_a_sentence_or_is_read_right(
    kind: str, cases: Callable[[], Iterator[Case]], tmp_path: Path, monkeypatch
):
    monkeypatch.setenv("PHOTOREG_MAX_CAMERA_FILE_MB", "1")
    rows, wrong = [], []
    for number, case in enumerate(cases()):
        # Two levels down, so that files above it lie within the test's folder.
        folder = tmp_path / str(number) / "in"
        folder.mkdir(parents=True)
        answer = got(case, folder)
        rows.append(f"| {case.name} | {case.what} | {answer} |".replace("\n", " "))
        fault = faults(case, answer)
        if fault:
            wrong.append(f"{case.name}, {case.what}: {fault}; got: {answer}")
    TABLES.mkdir(parents=True, exist_ok=True)
    table = ["| file | what is wrong | what one gets |", "|---|---|---|", *rows]
    (TABLES / f"{kind}.md").write_text("\n".join(table) + "\n", encoding="utf-8")
    assert not wrong, "\n".join([f"{len(wrong)} of {len(rows)}:", *wrong])
