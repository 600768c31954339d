"""Files that lie: each is read right or refused in a sentence, and nothing else happens.

The run writes what each got to build/lying-input/, a Markdown table a kind.
"""

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from app.warm_up import toy_scene
from photoreg.errors import PhotoregError
from photoreg.mesh import Mesh
from photoreg.readiness import check_readiness
from tests.lying_archives import zip_archive_cases
from tests.lying_cameras import camera_cases
from tests.lying_input import Case, described, read
from tests.lying_meshes import mesh_cases
from tests.lying_photos import photo_cases

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
    [
        ("meshes", mesh_cases),
        ("photos", photo_cases),
        ("cameras", camera_cases),
        ("archives", zip_archive_cases),
    ],
)
def test_every_lie_gets_a_sentence_or_is_read_right(
    kind: str, cases: Callable[[], Iterator[Case]], tmp_path: Path, monkeypatch
):
    monkeypatch.setenv("PHOTOREG_MAX_CAMERA_FILE_MB", "1")
    monkeypatch.setenv("PHOTOREG_MAX_FILE_MB", "1")
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


def test_a_mesh_that_is_inside_out_is_told_before_it_is_refined():
    mesh, photos, cameras = toy_scene()
    assert not check_readiness(mesh, photos, cameras).is_inside_out
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1], name="turned.ply")
    readiness = check_readiness(turned, photos, cameras)
    assert not readiness.is_possible
    assert len(readiness.problems) == 1
    assert readiness.problems[0].startswith("The mesh is inside out")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "off"])
def test_two_million_faces_are_read_in_bounded_memory(suffix: str, tmp_path: Path):
    n = 1001
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(n), np.arange(n)))
    vertices = np.column_stack([x, y, 5.0 * np.sin(x / 40.0)])
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    faces = np.vstack(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)]
    )
    path = tmp_path / f"m.{suffix}"
    Mesh(vertices, faces).save(path)
    code = (
        "import resource, sys; from photoreg.mesh import load_mesh; "
        "print(len(load_mesh(sys.argv[1]).faces), "
        "resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, path], capture_output=True, text=True, check=True
    )
    n_faces, memory_mb = map(int, done.stdout.split())
    assert n_faces == 2_000_000
    # Measured: 690 (PLY) to 1640 MB (OFF).
    assert memory_mb < 2500, f"{memory_mb} MB"
