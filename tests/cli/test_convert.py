"""`photoreg convert` and `photoreg texture` by suffix, as a person meets them."""

import json
from pathlib import Path

import pytest
import trimesh
from PIL import Image

from photoreg.cli.commands import run
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import (
    CAMERA_FORMATS,
    read_cameras,
    write_cameras,
)
from photoreg.formats.models.ply import save_mesh
from tests.formats.camera_files import NAMES, camera_set, largest_error_px
from tests.painted import ball_and_moon, cameras_around, photograph


@pytest.fixture
def folder(tmp_path) -> Path:
    """Cameras as cameras.json, and their photos."""
    write_cameras(tmp_path / "cameras.json", camera_set(tmp_path))
    return tmp_path


def convert(folder: Path, *words: str) -> int:
    return run(["convert", str(folder / "cameras.json"), *words])


def test_there_and_back_gives_the_same_projections(folder, capsys):
    model = folder / "my model"
    assert convert(folder, "--out", str(model), "--to", "colmap") == 0
    said = capsys.readouterr().err
    assert "3 cameras, photoreg to colmap." in said
    assert "Nothing is lost." in said
    back = folder / "back.json"
    assert run(["convert", str(model), "--out", str(back), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures == {
        "from": "colmap",
        "to": "photoreg",
        "cameras": 3,
        "files": [str(back)],
        "losses": [],
    }
    before = read_cameras(folder / "cameras.json").cameras
    for name, camera in read_cameras(back).cameras.items():
        error = largest_error_px(before[name], camera)
        assert error < 1e-6, (name, error)


def test_what_is_lost_is_said(folder, capsys):
    out = folder / "bundle.out"
    photos = ["--photos", str(folder)]
    assert convert(folder, "--out", str(out), *photos) == 0
    said = capsys.readouterr().err.splitlines()
    lost = [line for line in said if line.startswith("Lost: ")]
    assert len(lost) == 3
    assert all(
        f"Lost: {name} loses its two focal" in said_
        for name, said_ in zip(NAMES, lost, strict=True)
    )


def test_a_meshlab_project_names_mesh_and_photos_from_where_it_lies(folder, capsys):
    (folder / "out").mkdir()
    mesh = folder / "a mesh.ply"
    save_mesh(mesh, ball_and_moon(1))
    out = folder / "out" / "project.mlp"
    words = ["--mesh", str(mesh), "--photos", *(str(folder / n) for n in NAMES)]
    assert convert(folder, "--out", str(out), *words) == 0
    text = out.read_text(encoding="utf-8")
    assert 'filename="../a mesh.ply"' in text
    assert len(list(out.parent.glob("*.padded.*.png"))) == 3


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--out", "somewhere"], "does not show its format"),
        (["--out", "a.mlp"], "Give the photos too"),
        (["--out", "a.json", "--from", "meshlab"], "is not XML"),
        (["--out", "a.json", "--from", "blender"], "cannot read"),
        (["--out", "a.json", "--from", "colmap"], "should be a folder"),
        (["--out", "missing/a.json"], "does not exist"),
        (["--out", "a.mlp", "--mesh", "no.ply"], "mesh"),
        (["--out", "a.mlp", "--photos", "no.jpg"], "photo"),
    ],
)
def test_what_cannot_be_converted_is_refused_in_one_sentence(
    folder, capsys, monkeypatch, words, sentence
):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    assert convert(folder, *words) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.startswith("photoreg: ")
    assert said.count("\n") == 1
    assert sorted(folder.iterdir()) == before


def test_a_missing_file_is_named(tmp_path, capsys):
    words = ["convert", str(tmp_path / "none"), "--out", str(tmp_path / "a.json")]
    assert run(words) == 2
    assert "none do not exist" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "options", "n_files"),
    [("m.glb", [], 1), ("m.ply", [], 2), ("m.ply", ["--at-vertices"], 1)],
)
def test_texture_writes_what_the_suffix_says_from_cameras_of_any_format(
    tmp_path, capsys, name, options, n_files
):
    mesh, cameras = ball_and_moon(1), cameras_around(2, 160, 120)
    save_mesh(tmp_path / "mesh.ply", mesh)
    paths = {}
    for i, camera in enumerate(cameras):
        paths[f"{i}.png"] = tmp_path / f"{i}.png"
        Image.fromarray(photograph(mesh, camera).pixels).save(paths[f"{i}.png"])
    given = CameraSet(dict(zip(paths, cameras, strict=True)), paths)
    write_cameras(tmp_path / "model", given, "colmap-text")
    (tmp_path / "out").mkdir()
    out = tmp_path / "out" / name
    words = ["texture", str(tmp_path / "mesh.ply"), *map(str, paths.values())]
    words += ["--cameras", str(tmp_path / "model"), "--out", str(out), "--size", "256"]
    assert run([*words, "--json", *options]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert sorted(figures["files"]) == sorted(map(str, out.parent.iterdir()))
    assert len(figures["files"]) == n_files
    loaded = trimesh.load(out, force="mesh")
    assert isinstance(loaded, trimesh.Trimesh)
    assert len(loaded.faces) == len(mesh.faces)


def test_the_help_says_what_each_format_loses(capsys):
    with pytest.raises(SystemExit):
        run(["convert", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    for name, known in CAMERA_FORMATS.items():
        assert f"{name}: {known.in_words}" in said
