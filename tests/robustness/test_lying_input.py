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
import trimesh
from PIL import ExifTags, Image

from app.engine.warm_up import toy_scene
from photoreg.errors import PhotoregError
from photoreg.geometry.mesh import Mesh
from photoreg.registration.check_readiness import check_readiness
from tests.robustness.lying_archives import zip_archive_cases
from tests.robustness.lying_cameras import camera_cases
from tests.robustness.lying_foreign import foreign_cases
from tests.robustness.lying_input import Case, described, read
from tests.robustness.lying_meshes import mesh_cases
from tests.robustness.lying_photos import photo_cases

TABLES = Path(__file__).parents[2] / "build" / "lying-input"


def got(case: Case, folder: Path) -> tuple[str, str]:
    """What a case gets, and what is told beside."""
    try:
        value = read(case, folder)
        return described(value), " ".join(getattr(value, "notes", ()))
    except PhotoregError as error:
        return str(error).replace(f"{folder}/", ""), ""
    except Exception as error:  # noqa: BLE001 - this is what the test is about.
        return f"CRASH {type(error).__name__}: {error}", ""


def faults(case: Case, answer: str, told: str) -> str | None:
    """What is wrong with an answer; None if nothing is."""
    if case.told not in told:
        return f"expected {case.told!r} to be told"
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
        ("foreign", foreign_cases),
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
        answer, told = got(case, folder)
        cells = case.name, case.what, f"{answer}. {told}" if told else answer
        rows.append(f"| {' | '.join(cells)} |".replace("\n", " "))
        fault = faults(case, answer, told)
        if fault:
            wrong.append(f"{case.name}, {case.what}: {fault}; got: {answer} {told}")
    TABLES.mkdir(parents=True, exist_ok=True)
    table = ["| file | what is wrong | what one gets |", "|---|---|---|", *rows]
    (TABLES / f"{kind}.md").write_text("\n".join(table) + "\n", encoding="utf-8")
    assert not wrong, "\n".join([f"{len(wrong)} of {len(rows)}:", *wrong])


def test_a_mesh_that_is_inside_out_can_be_refined_all_the_same():
    mesh, photos, cameras = toy_scene()
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1], name="turned.ply")
    readiness = check_readiness(turned, photos, cameras)
    assert readiness.is_possible
    assert readiness.problems == check_readiness(mesh, photos, cameras).problems


def two_million_faces(path: Path) -> None:
    n = 1001
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(n), np.arange(n)))
    vertices = np.column_stack([x, y, 5.0 * np.sin(x / 40.0)])
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    faces = np.vstack(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)]
    )
    trimesh.Trimesh(vertices, faces, process=False, validate=False).export(path)


def slopes(dtype: type[np.unsignedinteger]) -> np.ndarray:
    steps = (np.add.outer(np.arange(8400), np.arange(12000)) % 251).astype(dtype)
    return steps * dtype(np.iinfo(dtype).max // 255)


def hundred_megapixels(path: Path) -> None:
    options = {
        ".png": {"compress_level": 1},
        ".tif": {"compression": "tiff_lzw"},
        ".jpg": {},
    }
    grey = Image.fromarray(slopes(np.uint8))
    Image.merge("RGB", [grey] * 3).save(path, **options[path.suffix])


def hundred_megapixels_on_its_side(path: Path) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Image.fromarray(slopes(np.uint8)).convert("CMYK").save(path, exif=exif)


def hundred_megapixels_of_16_bits(path: Path) -> None:
    Image.fromarray(slopes(np.uint16)).save(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "make", "expected", "most_mb"),
    [
        # Measured: 690 (PLY) to 1640 MB (OFF).
        *(
            (f"m.{suffix}", two_million_faces, "read: 2000000 triangles", 2500)
            for suffix in ("obj", "ply", "stl", "glb", "off")
        ),
        *(
            (f"p.{suffix}", hundred_megapixels, "read: 12000 x 8400 px", 1500)
            for suffix in ("jpg", "png", "tif")
        ),
        ("s.jpg", hundred_megapixels_on_its_side, "read: 8400 x 12000 px", 1500),
        ("d.tif", hundred_megapixels_of_16_bits, "read: 12000 x 8400 px", 1500),
    ],
)
def test_large_files_are_read_in_bounded_memory(
    name: str,
    make: Callable[[Path], None],
    expected: str,
    most_mb: int,
    tmp_path: Path,
):
    make(tmp_path / name)
    code = (
        "import sys; from pathlib import Path; "
        "from photoreg.limits import Limits; from tests.robustness import lying_input; "
        "from tests.robustness.memory import peak_memory_gb; "
        "lying_input.LIMITS = Limits(); "
        "print(lying_input.described(lying_input.read_path(Path(sys.argv[1])))); "
        "print(round(1000 * peak_memory_gb()))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / name],
        capture_output=True,
        text=True,
        check=True,
    )
    answer, memory_mb = done.stdout.splitlines()
    what = make.__name__.replace("_", " ")
    size_mb = (tmp_path / name).stat().st_size / 1e6
    told = f"{answer}, in {memory_mb} MB of memory"
    TABLES.mkdir(parents=True, exist_ok=True)
    (TABLES / f"large-{name}.md").write_text(
        f"| file | what it is | what one gets |\n|---|---|---|\n"
        f"| {name} | {what}, {size_mb:.0f} MB | {told} |\n",
        encoding="utf-8",
    )
    assert answer.startswith(expected)
    assert int(memory_mb) < most_mb, told
