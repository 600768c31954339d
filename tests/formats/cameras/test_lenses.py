"""Lenses through every camera format: kept, or told; and what other programs mean."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras, save_cameras
from photoreg.formats.cameras.lens_models import opencv_lens
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens

LENS = Lens(-0.12, 0.05, 0.001, -0.002, -0.01)


def _camera(lens: Lens) -> Camera:
    camera = Camera.look_at([1.0, -2.0, 4.0], [0, 0, 0], [0, 0, 1], 90.0, 64, 48)
    return camera.with_lens(lens)


def _written(folder: Path, name: str, camera: Camera) -> tuple[Camera, list[str]]:
    photo = folder / "a.png"
    Image.new("RGB", (64, 48)).save(photo)
    place = {
        "colmap": "model",
        "colmap-text": "model",
        "nerfstudio": "transforms.json",
        "texrecon": "model",
        "opencv": "c.yml",
        "bundler": "c.out",
        "photoreg": "c.json",
        "meshlab": "c.mlp",
        "realityscan": "sidecars",
        "alicevision": "c.sfm",
    }[name]
    cameras = CameraSet({"a.png": camera}, {"a.png": photo})
    saved = write_cameras(folder / place, cameras, name)
    return read_cameras(folder / place, name, [photo]).cameras["a.png"], saved.losses


@pytest.mark.parametrize(
    "name",
    [
        *("photoreg", "opencv", "colmap", "colmap-text", "nerfstudio"),
        *("realityscan", "alicevision"),
    ],
)
@pytest.mark.parametrize("lens", [LENS, Lens(k1=-0.1), Lens(0.1, -0.2, 1e-3, 2e-3)])
def test_a_lens_is_kept(tmp_path: Path, name: str, lens: Lens) -> None:
    camera = _camera(lens)
    back, losses = _written(tmp_path, name, camera)
    assert back.lens == lens
    assert losses == []
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))
    np.testing.assert_allclose(back.project(points), camera.project(points), atol=1e-9)


def test_bundler_keeps_two_radial_terms_and_tells_the_rest(tmp_path: Path) -> None:
    back, losses = _written(tmp_path, "bundler", _camera(LENS))
    assert back.lens == Lens(LENS.k1, LENS.k2)
    assert "lens distortion" in losses[0]


@pytest.mark.parametrize("name", ["texrecon", "meshlab"])
def test_formats_without_a_lens_say_so(tmp_path: Path, name: str) -> None:
    back, losses = _written(tmp_path, name, _camera(LENS))
    assert back.lens.is_ideal
    assert "lens distortion" in losses[0]
    assert "photoreg undistort" in losses[0]


def test_the_version_is_2_only_where_a_lens_is(tmp_path: Path) -> None:
    for lens, version in ((Lens(), 1), (LENS, 2)):
        path = tmp_path / f"{version}.json"
        save_cameras(path, CameraFile({"a.png": _camera(lens)}))
        assert json.loads(path.read_text())["version"] == version
        assert load_cameras(path).cameras["a.png"].lens == lens


@pytest.mark.parametrize("terms", [{"k9": 1.0}, {"k1": "a"}, [0.1], {"k1": True}])
def test_a_lens_that_is_none_is_refused(tmp_path: Path, terms: object) -> None:
    path = tmp_path / "a.json"
    save_cameras(path, CameraFile({"a.png": _camera(LENS)}))
    document = json.loads(path.read_text())
    document["cameras"][0]["distortion"] = terms
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"lens|distortion"):
        load_cameras(path)


def test_a_rational_lens_is_fitted_or_refused() -> None:
    K, size = _camera(LENS).K, (64, 48)
    rational = [-0.05, 0.01, 0.001, 0.002, 0.0, 0.02, 0.005, 0.0]
    lens = opencv_lens(rational, K, size, "x")
    rays = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 2))
    points = np.column_stack([rays, np.ones(200)])
    theirs, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), K, np.array(rational)
    )
    ours = Camera(K, np.eye(3), np.zeros(3), *size, lens).project(points)
    np.testing.assert_allclose(ours, theirs[:, 0], atol=0.05)
    with pytest.raises(InputError, match="rational"):
        opencv_lens([0.0] * 5 + [-4.0, 0.0, 0.0], K, size, "x")


@pytest.mark.parametrize(
    ("line", "lens"),
    [
        ("SIMPLE_RADIAL 64 48 90 32 24 -0.1", Lens(-0.1)),
        ("RADIAL 64 48 90 32 24 -0.1 0.02", Lens(-0.1, 0.02)),
        (
            "OPENCV 64 48 90 91 32 24 -0.1 0.02 0.001 0.002",
            Lens(-0.1, 0.02, 1e-3, 2e-3),
        ),
    ],
)
def test_colmaps_models_are_read(tmp_path: Path, line: str, lens: Lens) -> None:
    (tmp_path / "cameras.txt").write_text(f"1 {line}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    assert read_cameras(tmp_path).cameras["a.png"].lens == lens
