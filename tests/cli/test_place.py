"""photoreg place, and photoreg refine without cameras."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from photoreg.cli.commands import run
from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.projection_error import projection_error
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.encoding import encode
from photoreg.synthetic.scene import Scene, write_scene
from tests.scenes import small_scene

SEARCH = ["--preset", "fast"]


def files(folder: Path, scene: Scene) -> list[str]:
    write_scene(scene, folder)
    return [str(folder / name) for name in (scene.mesh.name, *scene.encoded)]


def error_px(scene: Scene, path: Path) -> float:
    found = load_cameras(path).cameras
    names = [photo.name for photo in scene.photos]
    cameras = [found[name] for name in names]
    return projection_error(scene.mesh, scene.cameras, cameras).mean


def test_cameras_are_found_and_refined_without_any_being_given(tmp_path, capsys):
    scene = small_scene(seed=5)
    paths = files(tmp_path / "scene", scene)
    out, drawn = tmp_path / "rough.json", tmp_path / "candidates"
    asked = ["--out", str(out), "--candidates", str(drawn), "--json"]
    assert run(["place", *paths, *asked]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["grade"] == "found"
    assert {one["found_by"] for one in figures["photos"].values()} == {"plain"}
    assert error_px(scene, out) < 5.0
    pictures = sorted(drawn.iterdir())
    assert 2 <= len(pictures) <= 6
    assert load_photo(pictures[0]).width == scene.photos[0].width
    refined = tmp_path / "refined.json"
    assert run(["refine", *paths, "--out", str(refined), *SEARCH]) == 0
    assert "looked for" in capsys.readouterr().err
    assert error_px(scene, refined) < 0.3, error_px(scene, refined)


def test_another_object_ends_with_status_2_and_what_to_do(tmp_path, capsys):
    scene, other = small_scene(seed=7), small_scene(seed=8)
    mesh = files(tmp_path / "scene", scene)[0]
    photos = files(tmp_path / "other", other)[1:]
    out = tmp_path / "rough.json"
    assert run(["place", mesh, photos[0], "--out", str(out)]) == 2
    assert "box" in capsys.readouterr().err


def test_where_no_camera_is_found_refine_says_what_to_do(tmp_path, capsys):
    mesh = files(tmp_path / "scene", small_scene())[0]
    empty = tmp_path / "empty.png"
    empty.write_bytes(encode(np.full((240, 320, 3), 90, np.uint8), ".png"))
    for command in ("place", "refine"):
        out = tmp_path / f"{command}.json"
        assert run([command, mesh, str(empty), "--out", str(out)]) == 2
        told = capsys.readouterr().err
        assert "not found" in told
        assert "box" in told
        assert not out.exists()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--box", "no.png", "0", "0", "50", "50"], "no photo no.png"),
        (["--focal", "no.png", "300"], "no photo no.png"),
    ],
)
def test_hints_that_cannot_be_are_refused(tmp_path, capsys, options, why):
    paths = files(tmp_path / "scene", small_scene())
    out = str(tmp_path / "rough.json")
    assert run(["place", *paths, "--out", out, *options]) == 2
    assert why in capsys.readouterr().err


def test_what_needs_cameras_is_refused_without_them(tmp_path, capsys):
    scene = small_scene()
    paths = files(tmp_path / "scene", scene)
    out = ["--out", str(tmp_path / "out.json")]
    name = scene.photos[0].name
    assert run(["refine", *paths, *out, "--lock", name]) == 2
    assert "--cameras" in capsys.readouterr().err
    rough = ["--cameras", str(tmp_path / "scene" / "rough.json")]
    box = ["--box", name, "0", "0", "99", "99"]
    assert run(["refine", *paths, *out, *rough, *box]) == 2
    assert "--box" in capsys.readouterr().err


def test_a_mask_in_the_photo_says_where_the_object_is(tmp_path, capsys):
    scene = small_scene(kind="clutter", seed=2)
    mesh = files(tmp_path / "scene", scene)[0]
    masked = []
    for photo, camera in zip(scene.photos, scene.cameras, strict=True):
        covered = render_geometry(scene.true_mesh, camera).covered
        alpha = np.where(covered, np.uint8(255), np.uint8(0))
        path = tmp_path / photo.name
        path.write_bytes(encode(np.dstack([photo.pixels, alpha]), ".png"))
        masked.append(str(path))
    out = tmp_path / "rough.json"
    assert run(["place", mesh, *masked, "--out", str(out), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert {one["found_by"] for one in figures["photos"].values()} == {"mask"}
    scene = dataclasses.replace(scene, mesh=scene.true_mesh)
    assert error_px(scene, out) < 5.0
