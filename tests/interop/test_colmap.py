"""COLMAP, by pycolmap, reads our models, and we read what it writes."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from tests.formats.camera_files import camera_set, largest_error_px, points_before

pytestmark = pytest.mark.slow


@pytest.fixture
def pycolmap() -> Any:
    return importlib.import_module("pycolmap")


@pytest.mark.parametrize("name", ["colmap", "colmap-text"])
def test_colmap_projects_points_where_photoreg_does(tmp_path, pycolmap, name):
    cameras = camera_set(tmp_path)
    write_cameras(tmp_path / "model", cameras, name)
    model = pycolmap.Reconstruction(tmp_path / "model")
    images = {image.name: image for image in model.images.values()}
    assert len(images) == len(cameras.cameras)
    for photo, camera in cameras.cameras.items():
        points = points_before(camera)
        # In text, COLMAP cuts names at spaces, as the exporter says.
        image = images[photo.split(" ")[0] if name == "colmap-text" else photo]
        pixels = [image.project_point(point) for point in points]
        # COLMAP has the centre of the first pixel at (0.5, 0.5).
        error = np.abs(np.array(pixels) - 0.5 - camera.project(points)).max()
        assert error < 1e-6, (photo, error)


@pytest.mark.parametrize("kind", ["text", "binary"])
def test_what_colmap_writes_is_read(tmp_path, pycolmap, kind):
    cameras = camera_set(tmp_path)
    write_cameras(tmp_path / "model", cameras, "colmap")
    model = pycolmap.Reconstruction(tmp_path / "model")
    out = Path(tmp_path / "again")
    out.mkdir()
    (model.write_text if kind == "text" else model.write_binary)(out)
    read = read_cameras(out).cameras
    for photo, camera in cameras.cameras.items():
        error = largest_error_px(camera, read[photo])
        assert error < 1e-6, (photo, error)


@pytest.mark.parametrize(
    "lens", [Lens(-0.12, 0.05, 1e-3, -2e-3, -0.01), Lens(0.1, -0.2, 1e-3, 2e-3)]
)
def test_colmap_bends_lines_as_photoreg_does(tmp_path, pycolmap, lens):
    look_at = Camera.look_at([1.0, -2.0, 4.0], [0, 0, 0], [0, 0, 1], 90.0, 64, 48)
    camera, photo = look_at.with_lens(lens), tmp_path / "a.png"
    Image.new("RGB", (64, 48)).save(photo)
    cameras = CameraSet({"a.png": camera}, {"a.png": photo})
    write_cameras(tmp_path / "model", cameras, "colmap")
    model = pycolmap.Reconstruction(tmp_path / "model")
    image = next(iter(model.images.values()))
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))
    theirs = [image.project_point(point) for point in points]
    np.testing.assert_allclose(
        camera.project(points) + 0.5, np.array(theirs), atol=1e-6
    )
