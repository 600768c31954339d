"""Bundler's bundle.out: one focal length, the principal point in the middle."""

import numpy as np
import pytest

from photoreg.formats.cameras.camera_set import CameraSet, largest_shift_px
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from photoreg.geometry.camera import Camera
from tests.formats.camera_files import (
    NAMES,
    camera_set,
    largest_error_px,
    points_before,
    write,
)


def test_bundler_keeps_a_plain_camera_and_tells_what_another_loses(
    tmp_path, photo_folder
):
    cameras = camera_set(photo_folder)
    path, saved = write(tmp_path, "bundler", cameras)
    assert len(saved.losses) == 3
    read = read_cameras(path).cameras
    for loss, (name, camera) in zip(saved.losses, cameras.cameras.items(), strict=True):
        assert "two focal lengths" in loss
        assert "principal point" in loss
        moved = largest_shift_px(camera, read[name])
        told = float(loss.split(" px.")[0].split()[-1])
        assert told == pytest.approx(moved, rel=0.05)
        # Turned to make up for it: less is lost than the principal point was off.
        off = camera.K[:2, 2] - (0.5 * (camera.width - 1), 0.5 * (camera.height - 1))
        assert moved < 0.6 * np.linalg.norm(off), (moved, off)
        np.testing.assert_allclose(read[name].center, camera.center, atol=1e-9)
    again = tmp_path / "again.out"
    assert write_cameras(again, CameraSet(read, cameras.photos)).losses == []
    for name, camera in read.items():
        error = largest_error_px(camera, read_cameras(again).cameras[name])
        assert error < 1e-6, error


def test_bundler_s_middle_is_that_of_the_photo(tmp_path, photo_folder):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0.1, 1], 150.0, 160, 97)
    cameras = CameraSet({NAMES[0]: camera}, camera_set(photo_folder).photos)
    path, saved = write(tmp_path, "bundler", cameras)
    assert saved.losses == []
    rows = [list(map(float, r.split())) for r in path.read_text().splitlines()[2:]]
    points = points_before(camera)
    P = points @ np.array(rows[1:4]).T + rows[4]
    p = -P[:, :2] / P[:, 2:] * rows[0][0]
    pixels = np.column_stack([79.5 + p[:, 0], 48.0 - p[:, 1]])
    error = np.abs(pixels - camera.project(points)).max()
    assert error < 1e-6, error
