"""A batch of three, one of which fails, on Dask as it is in earnest."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from photoreg.batch.record import load_record
from photoreg.formats.cameras.cameras_json import load_cameras, save_cameras
from tests.batch.collections import QUICK, QUICK_BATCH, make_collection, make_object

pytestmark = pytest.mark.cluster


def batch(collection: Path, out: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, as its workers import what it is."""
    command = [sys.executable, "-m", "photoreg", "batch", str(collection)]
    return subprocess.run(
        [*command, "--out", str(out), *QUICK_BATCH, *words],
        check=False,
        capture_output=True,
        text=True,
        timeout=600,
    )


def summary(out: Path) -> dict[str, dict[str, str]]:
    with (out / "summary.csv").open(newline="", encoding="utf-8") as file:
        return {row["object"]: row for row in csv.DictReader(file)}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, Path, str]:
    """Two objects and one whose photo is damaged, and what a batch made of them."""
    folder = tmp_path_factory.mktemp("batch")
    collection, out = make_collection(folder / "things", 2), folder / "results"
    broken = make_object(collection / "broken")
    (broken / "clean-left.png").write_bytes(b"no photo")
    ended = batch(collection, out)
    assert ended.returncode == 1, ended.stderr
    return collection, out, ended.stderr


def test_the_others_are_made_and_the_one_is_set_aside_with_its_log(made):
    _, out, said = made
    rows = summary(out)
    assert list(rows) == ["broken", "object 0000", "object 0001"]
    assert rows["broken"]["status"] == "failed"
    assert "clean-left.png" in rows["broken"]["sentence"]
    assert "broken (failed): " in said
    log = (out / "broken" / "log.txt").read_text()
    assert [f"Attempt {n}" in log for n in (1, 2, 3, 4)] == [True, True, True, False]
    for name in ("object 0000", "object 0001"):
        assert rows[name]["status"] == "done"
        kept = {"cameras.json", "report.html", "before.jpg", "after.jpg", "object.json"}
        assert kept < {path.name for path in (out / name).iterdir()}
        assert (out / rows[name]["model"]).stat().st_size > 10_000
    left = [path.name for path in out.iterdir() if path.name.startswith(".")]
    assert not left


def test_an_object_has_the_bits_of_refine_alone(made, tmp_path):
    collection, out, _ = made
    folder, alone = collection / "object 0001", tmp_path / "alone.json"
    photos = sorted(map(str, folder.glob("*.png")))
    words = ["refine", str(folder / "rock.ply"), *photos, "--out", str(alone)]
    words += ["--cameras", str(folder / "rough.json"), *QUICK]
    subprocess.run([sys.executable, "-m", "photoreg", *words], check=True)
    assert alone.read_bytes() == (out / "object 0001" / "cameras.json").read_bytes()


def test_what_is_done_is_not_done_again_and_what_changed_is(made, tmp_path):
    collection, out, _ = made
    things, again = tmp_path / "things", tmp_path / "again"
    shutil.copytree(collection, things, copy_function=shutil.copy)  # At another time.
    shutil.copytree(out, again)
    kept = {p: p.stat().st_ino for p in again.glob("*/cameras.json")}
    assert "1 failed" in (said := batch(things, again).stderr)
    assert "0 done now in" in said
    assert {p: p.stat().st_ino for p in again.glob("*/cameras.json")} == kept

    # One whose content changed, one that was repaired.
    rough = things / "object 0000" / "rough.json"
    file = load_cameras(rough)
    turned = dict(zip(file.cameras, [*file.cameras.values()][::-1], strict=True))
    save_cameras(rough, file.with_cameras(turned))
    shutil.copy(things / "object 0000" / "clean-left.png", things / "broken")
    ended = batch(things, again)
    assert ended.returncode == 0, ended.stderr
    assert "2 done now in" in ended.stderr
    assert not (again / "broken" / "log.txt").exists()
    record = load_record(again / "broken")
    assert record is not None
    assert record.ending == "done"
    assert (again / "object 0001" / "cameras.json").stat().st_ino in kept.values()


def test_files_that_are_not_ours_are_not_written_over(made, tmp_path):
    collection, _, _ = made
    out = tmp_path / "out"
    (out / "object 0000").mkdir(parents=True)
    (out / "object 0000" / "cameras.json").write_text('{"mine": 1}')
    ended = batch(collection, out)
    assert summary(out)["object 0000"]["status"] == "failed"
    assert "not photoreg's" in ended.stderr
    assert json.loads((out / "object 0000" / "cameras.json").read_text()) == {"mine": 1}
    (out / "summary.csv").write_text("mine\n")
    ended = batch(collection, out)
    assert ended.returncode == 2
    assert (out / "summary.csv").read_text() == "mine\n"
