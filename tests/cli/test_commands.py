"""The command line as a person meets it: words, figures, files and exit status."""

import dataclasses
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
import trimesh.visual
from PIL import Image

from photoreg.cli import refine as refine_module
from photoreg.cli import texture as texture_module
from photoreg.cli.commands import commands, run
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras, save_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.ply import save_mesh
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from tests.scenes import small_scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A small scene as files; a test that spoils one makes its own copy."""
    scene, folder = small_scene(), tmp_path_factory.mktemp("scene")
    save_mesh(folder / "mesh.ply", scene.mesh)
    names = [photo.name for photo in scene.photos]
    for photo in scene.photos:
        Image.fromarray(photo.pixels).save(folder / photo.name)
    for file, cameras in (("truth", scene.cameras), ("rough", scene.rough_cameras)):
        cameras = dict(zip(names, cameras, strict=True))
        save_cameras(folder / f"{file}.json", CameraFile(cameras, {"by": "a test"}))
    return folder


def photo_paths(folder: Path) -> list[str]:
    return [str(folder / photo.name) for photo in small_scene().photos]


def refine_words(folder: Path, **changes: str) -> list[str]:
    words = {
        "mesh": str(folder / "mesh.ply"),
        "cameras": str(folder / "rough.json"),
        "out": str(folder / "refined.json"),
        **changes,
    }
    files = ["--cameras", words["cameras"], "--out", words["out"]]
    return ["refine", words["mesh"], *photo_paths(folder), *files, "--preset", "fast"]


def refused(argv: list[str], capsys) -> str:
    """Runs what should be refused; checks status 2 and one sentence; returns it."""
    status = run(argv)
    printed = capsys.readouterr()
    assert status == 2, printed.err
    assert printed.out == ""
    assert "Traceback" not in printed.err
    assert printed.err.strip().startswith("photoreg: ")
    return printed.err


def test_one_photo_goes_the_whole_way_too(folder, tmp_path, capsys):
    out, model = tmp_path / "refined.json", tmp_path / "model.glb"
    mesh, photo = str(folder / "mesh.ply"), photo_paths(folder)[0]
    rough = ["--cameras", str(folder / "rough.json")]
    words = ["refine", mesh, photo, *rough, "--out", str(out), "--preset", "fast"]
    assert run([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"]["grade"] != "unconvincing"
    scene = small_scene()
    camera = load_cameras(out).cameras[scene.photos[0].name]
    error = projection_error(scene.mesh, scene.cameras[:1], [camera]).mean
    assert error < 0.5, error
    words = ["texture", mesh, photo, "--cameras", str(out), "--out", str(model)]
    assert run(words) == 0
    assert isinstance(trimesh.load(model, force="mesh"), trimesh.Trimesh)


def test_refine_evaluate_texture_is_the_whole_way(folder, tmp_path, capsys):
    out = tmp_path / "refined.json"
    assert run([*refine_words(folder, out=str(out)), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["cost"] <= figures["start_cost"]
    assert load_cameras(out).extra == {"by": "a test"}

    truth = ["--truth", str(folder / "truth.json"), "--json"]
    mesh = str(folder / "mesh.ply")
    assert run(["evaluate", mesh, "--cameras", str(out), *truth]) == 0
    after = json.loads(capsys.readouterr().out)
    scene = small_scene()
    refined = list(load_cameras(out).cameras.values())
    expected = projection_error(scene.mesh, scene.cameras, refined).mean
    assert after["mean_px"] == pytest.approx(expected, rel=1e-3)
    before = projection_error(scene.mesh, scene.cameras, scene.rough_cameras).mean
    assert after["mean_px"] < 0.2 * before

    model = tmp_path / "a model.obj"
    words = ["texture", mesh, *photo_paths(folder), "--cameras", str(out)]
    assert run([*words, "--out", str(model)]) == 0
    loaded = trimesh.load(model)
    assert isinstance(loaded, trimesh.Trimesh)
    assert len(loaded.faces) == len(scene.mesh.faces)
    assert isinstance(loaded.visual, trimesh.visual.TextureVisuals)
    uv = np.asarray(loaded.visual.uv)
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0

    # Once more onto the model, which now has a layout: it is kept, or not, by choice.
    words[1] = str(model)
    again, anew = tmp_path / "again.obj", tmp_path / "anew.obj"
    capsys.readouterr()
    assert run([*words, "--out", str(again)]) == 0
    assert "laid out as the mesh's own" in capsys.readouterr().err.replace("\n", " ")
    assert run([*words, "--out", str(anew), "--no-keep-uv", "--json"]) == 0
    assert not json.loads(capsys.readouterr().out)["own_uv"]
    kept, other = load_mesh(again).corner_uv, load_mesh(anew).corner_uv
    np.testing.assert_array_equal(kept, load_mesh(model).corner_uv)
    assert kept is not None
    assert other is not None
    assert kept.shape == other.shape


def test_what_is_locked_or_shared_is_so_in_the_file(folder, tmp_path, capsys):
    out = tmp_path / "refined.json"
    words = refine_words(folder, out=str(out))
    first, second = (Path(path).name for path in photo_paths(folder))
    search = ["--population", "20", "--generations", "2", "--no-polish-after"]
    rough = load_cameras(folder / "rough.json").cameras
    assert run([*words, *search, "--lock", first]) == 0
    cameras = load_cameras(out).cameras
    assert np.array_equal(cameras[first].P, rough[first].P)
    assert not np.array_equal(cameras[second].P, rough[second].P)
    assert run([*words, *search, "--share-focal", "--lock-focal", second]) == 0
    cameras = load_cameras(out).cameras
    assert cameras[first].focal_px == cameras[second].focal_px == rough[second].focal_px
    assert run([*words, *search, "--lock", first]) == 0
    locked = out.read_bytes()
    assert run([*words, *search, "--only", second]) == 0
    assert out.read_bytes() == locked
    capsys.readouterr()
    said = refused([*words, "--lock-pose", "nobody.png"], capsys)
    assert "no photo nobody.png to hold" in said
    said = refused([*words, "--cropped", first, "--cropped", "nobody.png"], capsys)
    assert "no photo nobody.png" in said
    said = refused([*words, "--only", "nobody.png"], capsys)
    assert "no photo nobody.png to refine" in said
    said = refused([*words, "--only", first, "--lock", first], capsys)
    assert "both refined (--only) and locked" in said


def test_evaluate_of_the_truth_is_zero(folder, capsys):
    truth = str(folder / "truth.json")
    words = ["evaluate", str(folder / "mesh.ply"), "--cameras", truth]
    assert run([*words, "--truth", truth]) == 0
    assert "Mean projection error 0.000 px" in capsys.readouterr().out


def test_synthesize_makes_a_scene_that_evaluates(tmp_path, capsys):
    target = tmp_path / "new scene"
    options = ["--kind", "clean", "--seed", "3", "--n-faces", "1280"]
    options += ["--photos", "3", "--jpeg-quality", "90"]
    assert run(["synthesize", str(target), *options]) == 0
    assert len(list(target.glob("*.jpg"))) == 3
    (mesh,) = target.glob("*.ply")
    words = ["evaluate", str(mesh), "--cameras", str(target / "rough.json")]
    truth = ["--truth", str(target / "cameras.json"), "--json"]
    capsys.readouterr()
    assert run(words + truth) == 0
    assert 15.0 <= json.loads(capsys.readouterr().out)["mean_px"] <= 25.0


def test_synthesize_never_writes_into_a_folder_in_use(folder, capsys):
    assert "not empty" in refused(["synthesize", str(folder)], capsys)


# What a person may give, and the words that tell them.


def test_a_missing_file_is_named(folder, capsys):
    words = refine_words(folder, mesh=str(folder / "nothing.ply"))
    assert "nothing.ply does not exist" in refused(words, capsys)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.ply", "", "is empty"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no triangles"),
        ("nan.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    ],
)
def test_a_mesh_without_a_surface_is_refused(
    folder, tmp_path, capsys, name, content, words
):
    (tmp_path / name).write_text(content)
    said = refused(refine_words(folder, mesh=str(tmp_path / name)), capsys)
    assert words in said
    assert name in said


def test_a_text_file_named_jpg_is_refused(folder, tmp_path, capsys):
    (tmp_path / "notes.jpg").write_text("hello")
    words = refine_words(folder)
    words[2] = str(tmp_path / "notes.jpg")
    assert "notes.jpg could not be read" in refused(words, capsys)


def test_a_photo_of_one_pixel_is_refused(folder, tmp_path, capsys):
    name = small_scene().photos[0].name
    Image.new("RGB", (1, 1)).save(tmp_path / name)
    words = refine_words(folder)
    words[2] = str(tmp_path / name)
    assert f"{name} is 1x1 px" in refused(words, capsys)


def test_cameras_of_other_photos_are_refused(folder, tmp_path, capsys):
    cameras = load_cameras(folder / "rough.json").cameras
    other = {f"other-{name}": camera for name, camera in cameras.items()}
    save_cameras(tmp_path / "other.json", CameraFile(other))
    words = refine_words(folder, cameras=str(tmp_path / "other.json"))
    assert "matched by file name" in refused(words, capsys)


def test_cameras_that_do_not_see_the_mesh_are_refused(folder, tmp_path, capsys):
    scene = small_scene()
    away = scene.mesh.vertices + np.array([100.0 * scene.mesh.diagonal, 0.0, 0.0])
    trimesh.Trimesh(away, scene.mesh.faces, process=False).export(tmp_path / "away.ply")
    said = refused(refine_words(folder, mesh=str(tmp_path / "away.ply")), capsys)
    assert "see" in said


def test_a_texture_of_a_mesh_that_the_photos_do_not_show_is_told(
    folder, tmp_path, capsys
):
    mesh = small_scene().mesh
    # Mirrored, and so turned inside out; and moved by a quarter of its size.
    mirrored = Mesh(mesh.vertices * [1.0, 1.0, -1.0], mesh.faces)
    moved = Mesh(mesh.vertices + 0.25 * mesh.diagonal * np.eye(3)[0], mesh.faces)
    save_mesh(tmp_path / "mirrored.ply", mirrored)
    save_mesh(tmp_path / "moved.ply", moved)

    def texture(mesh: str) -> list[str]:
        words = ["--cameras", str(folder / "truth.json"), "--size", "64"]
        out = ["--out", str(tmp_path / "m.glb")]
        return ["texture", str(tmp_path / mesh), *photo_paths(folder), *words, *out]

    assert "mirror image: " in refused(texture("mirrored.ply"), capsys)
    assert not (tmp_path / "m.glb").exists()
    assert run(texture("moved.ply")) == 0
    assert "Warning: Unconvincing: " in capsys.readouterr().err


def test_a_camera_that_looks_away_is_named_with_what_is_wrong(folder, tmp_path, capsys):
    file = load_cameras(folder / "truth.json")
    name, camera = next(iter(file.cameras.items()))
    flip = np.diag([1.0, -1.0, -1.0])  # OpenGL's axes.
    away = dataclasses.replace(
        camera,
        R_cam_world=flip @ camera.R_cam_world,
        t_cam_world=flip @ camera.t_cam_world,
    )
    save_cameras(tmp_path / "away.json", file.with_cameras({name: away}))
    mesh, wrong = str(folder / "mesh.ply"), str(tmp_path / "away.json")
    right = str(folder / "truth.json")
    for cameras, truth in ((wrong, right), (right, wrong)):
        said = refused(
            ["evaluate", mesh, "--cameras", cameras, "--truth", truth], capsys
        )
        assert f"The camera of {name} in away.json sees nothing of mesh.ply. " in said
        assert "OpenGL" in said
    words = ["texture", mesh, *photo_paths(folder), "--cameras", wrong]
    assert run([*words, "--out", str(tmp_path / "m.ply"), "--size", "64"]) == 0
    said = capsys.readouterr().err
    assert f"Warning: The camera of {name} sees nothing of mesh.ply. " in said
    assert "OpenGL" in said


@pytest.mark.parametrize("place", ["nowhere/refined.json", "refined.txt", ""])
def test_an_unwritable_output_is_found_before_the_search(
    folder, tmp_path, capsys, monkeypatch, place
):
    def never(*_: object) -> None:
        raise AssertionError("The search was started.")

    monkeypatch.setattr("photoreg.cli.refine.refine_in_attempts", never)
    said = refused(refine_words(folder, out=str(tmp_path / place)), capsys)
    assert "Cannot write" in said


def test_the_same_photo_twice_is_refused(folder, capsys):
    words = refine_words(folder)
    words[2] = words[3]
    assert "given twice" in refused(words, capsys)


def test_an_unknown_option_ends_with_status_2(folder):
    with pytest.raises(SystemExit) as ended:
        run([*refine_words(folder), "--speed", "11"])
    assert ended.value.code == 2


@pytest.mark.parametrize("command", ["app", *commands()])
def test_every_command_has_help(command):
    done = subprocess.run(
        [sys.executable, "-m", "photoreg", command, "--help"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "usage: photoreg" in done.stdout


def test_ctrl_c_writes_the_best_so_far_and_says_so(folder, tmp_path):
    out = tmp_path / "refined.json"
    words = refine_words(folder, out=str(out))
    words[words.index("fast")] = "paper"
    with subprocess.Popen(
        [sys.executable, "-m", "photoreg", *words],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "FORCE_COLOR": "1", "TTY_COMPATIBLE": "1"},
    ) as process:
        assert process.stderr is not None
        said = ""
        # The bar names a generation once the search runs.
        while "generation" not in said and process.poll() is None:
            said += process.stderr.read(64)
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        said += process.stderr.read()
    assert process.returncode == 1, said
    assert f"The best cameras so far are in {out}." in said.replace("\n", "")
    assert set(load_cameras(out).cameras) == set(
        load_cameras(folder / "rough.json").cameras
    )


@pytest.mark.parametrize("meanwhile", ["somebody's file", "the folder is gone"])
def test_cameras_are_not_lost_where_their_place_is_taken_during_the_run(
    folder, tmp_path, monkeypatch, capsys, meanwhile
):
    place = tmp_path / "results"
    place.mkdir()
    out = place / "refined.json"
    whole = refine_module.refine_in_attempts

    def refine(*arguments):
        yield from itertools.islice(whole(*arguments), 3)
        if meanwhile == "somebody's file":
            out.write_text("somebody's")
        else:
            place.rmdir()

    monkeypatch.setattr(refine_module, "refine_in_attempts", refine)
    monkeypatch.chdir(tmp_path)
    assert run([*refine_words(folder, out=str(out)), "--json"]) == 2
    printed = capsys.readouterr()
    figures = json.loads(printed.out)
    beside = place if meanwhile == "somebody's file" else tmp_path
    assert figures["out"] == str(beside / "refined-2.json")
    assert len(load_cameras(beside / "refined-2.json").cameras) == 2
    told = " ".join(printed.err.split())
    assert f"The cameras were written to {beside / 'refined-2.json'} instead." in told
    if meanwhile == "somebody's file":
        assert out.read_text() == "somebody's"


def test_a_coverage_picture_is_written_with_the_model_or_neither_is(
    folder, tmp_path, monkeypatch, capsys
):
    coverage, out = tmp_path / "coverage.png", tmp_path / "model.obj"
    whole = texture_module.baking

    def baking(*arguments):
        yield from whole(*arguments)
        coverage.write_bytes(b"somebody's")

    monkeypatch.setattr(texture_module, "baking", baking)
    words = ["texture", str(folder / "mesh.ply"), *photo_paths(folder), "--size", "64"]
    words += ["--cameras", str(folder / "truth.json"), "--out", str(out)]
    assert "coverage.png" in refused([*words, "--coverage", str(coverage)], capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["coverage.png"]
    assert coverage.read_bytes() == b"somebody's"
