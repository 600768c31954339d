"""Cameras as YAML, read by OpenCV itself."""

import dataclasses

import cv2
import numpy as np
import pytest

from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from photoreg.geometry.camera import Camera
from tests.formats.camera_files import camera_set, points_before, refused, write


def test_opencv_reads_and_projects_what_is_written(tmp_path, photo_folder):
    cameras = camera_set(photo_folder, skew=1.0)
    path, _ = write(tmp_path, "opencv", cameras)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    node = storage.getNode("cameras")
    for i, (name, camera) in enumerate(cameras.cameras.items()):
        entry = node.at(i)
        assert entry.getNode("photo").string() == name
        K, R, t, P = (entry.getNode(key).mat() for key in ("K", "R", "t", "P"))
        points = points_before(camera)
        homogeneous = np.column_stack([points, np.ones(len(points))]) @ P.T
        by_P = homogeneous[:, :2] / homogeneous[:, 2:]
        error = np.abs(by_P - camera.project(points)).max()
        assert error < 1e-6, error
        # projectPoints knows no skew: it is laid aside for both.
        K[0, 1] = 0.0
        pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, K, np.zeros(5))
        square = dataclasses.replace(camera, K=K)
        error = np.abs(pixels[:, 0] - square.project(points)).max()
        assert error < 1e-6, error
    storage.release()


@pytest.mark.parametrize("line", ["rows: 3", "cols: 3", "cols: 1"])
def test_a_matrix_without_its_size_is_refused(tmp_path, photo_folder, line):
    path, _ = write(tmp_path, "opencv", camera_set(photo_folder))
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(line, f"x{line}"), encoding="utf-8")
    assert "should be a matrix" in refused(path)
    path.write_text(text.replace(line, line[:-1] + "90000"), encoding="utf-8")
    assert "numbers, but there are" in refused(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("%YAML:1.0\n%\n---\ncameras: [ ]\n", "directive name at line 2"),
        ("%YAML:1.0\n---\na: \x01\n", "characters that text does not have"),
        ("cameras: " + "[" * 90_000, "exceeded maximum nesting depth"),
        ("cameras: " + "[" * 900 + "]" * 900, "nested too deep"),
        ("a: &a [ ]\ncameras: [ *a ]\n", "repeats parts by aliases"),
        ("[ a ]: 1\n", "found unhashable key"),
        ("cameras: [ ]\n" * 400_000, "up to 5 MB"),
    ],
)
def test_what_is_not_plain_yaml_is_refused_with_its_place(tmp_path, content, words):
    path = tmp_path / "a.yml"
    path.write_text(content, encoding="utf-8")
    assert words in refused(path)


@pytest.mark.parametrize(
    "name", ['it\'s "a" <b>.png', "1.png", "-a.jpg", "~", "写真, #1"]
)
def test_any_name_that_opencv_writes_is_read(tmp_path, name):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0.1, 1], 150.0, 160, 97)
    write_cameras(tmp_path / "a.yml", CameraSet({name: camera}))
    assert list(read_cameras(tmp_path / "a.yml").cameras) == [name]
