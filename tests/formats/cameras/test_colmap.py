"""COLMAP models, text and binary."""

import struct
from pathlib import Path

import numpy as np
import pytest

from photoreg.formats.cameras.registry import (
    format_to_read,
    read_cameras,
    write_cameras,
)
from tests.formats.camera_files import NAMES, camera_set, refused


def test_colmap_binary_and_text_tell_the_same(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    write_cameras(tmp_path / "a", cameras, "colmap")
    write_cameras(tmp_path / "b", cameras, "colmap-text")
    binary, text = (read_cameras(tmp_path / f).cameras for f in "ab")
    for name in NAMES:
        np.testing.assert_array_equal(binary[name].P, text[name].P)


def test_colmap_s_first_pixel_has_its_centre_at_one_half(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    write_cameras(tmp_path / "a", cameras, "colmap-text")
    line = (tmp_path / "a" / "cameras.txt").read_text().splitlines()[2].split()
    K = cameras.cameras[NAMES[0]].K
    assert line[:4] == ["1", "PINHOLE", "160", "97"]
    expected = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5]
    np.testing.assert_array_equal(np.array(line[4:], dtype=float), expected)


def test_a_colmap_project_is_found_in_sparse_0(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    (tmp_path / "sparse").mkdir()
    write_cameras(tmp_path / "sparse" / "0", cameras, "colmap")
    assert format_to_read(tmp_path).name == "colmap"
    assert set(read_cameras(tmp_path).cameras) == set(NAMES)


def colmap_text(folder: Path, camera: str, name: str = "a/b/one photo.jpg") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text(f"# comment\n7 {camera}\n")
    (folder / "images.txt").write_text(
        f"# comment\n3 1 0 0 0 0.5 0.25 2 7 {name}\n10.5 20.5 -1 30 40 12\n"
        f"4 0 1 0 0 0.5 0.25 2 7 two.jpg\n\n"
    )
    return folder


def test_two_cameras_of_one_number_are_refused(tmp_path):
    folder = colmap_text(tmp_path / "m", "PINHOLE 100 80 120 120 49.5 41.5")
    with (folder / "cameras.txt").open("a") as file:
        file.write("7 PINHOLE 100 80 900 900 49.5 41.5\n")
    assert "line 3 is a second camera 7" in refused(folder)


@pytest.mark.parametrize("name", ["a.jpg", "a photo of it.jpg", "7 8"])
def test_images_without_lines_of_points_do_not_swallow_each_other(tmp_path, name):
    folder = colmap_text(tmp_path / "m", "PINHOLE 100 80 120 120 49.5 41.5", "z.jpg")
    text = (folder / "images.txt").read_text()
    text = text.replace("10.5 20.5 -1 30 40 12\n", "").replace("two.jpg", name)
    (folder / "images.txt").write_text(text)
    said = refused(folder)
    assert "should be the points of z.jpg" in said
    assert "two lines an image" in said


@pytest.mark.parametrize(
    "camera",
    [
        "SIMPLE_PINHOLE 100 80 120 49.5 41.5",
        "SIMPLE_RADIAL 100 80 120 49.5 41.5 0",
        "OPENCV 100 80 120 120 49.5 41.5 0 0 0 0",
    ],
)
def test_colmap_cameras_without_distortion_are_read(tmp_path, camera):
    read = read_cameras(colmap_text(tmp_path / "m", camera)).cameras
    assert list(read) == ["one photo.jpg", "two.jpg"]
    expected = [[120, 0, 49], [0, 120, 41], [0, 0, 1]]
    np.testing.assert_allclose(read["two.jpg"].K, expected)
    np.testing.assert_allclose(read["two.jpg"].R_cam_world, np.diag([1, -1, -1]))


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        (
            "FULL_OPENCV 100 80 120 120 50 40 0 0 0 0 0 -40 0 0",
            "undistort the photos",
        ),
        ("OPENCV_FISHEYE 100 80 120 120 50 40 0 0 0 0", "undistort the photos"),
        ("SOMETHING 100 80 120", "undistort the photos"),
        ("PINHOLE 100 80 120 50 40", "should have 4 parameters"),
        ("PINHOLE 100 0 120 120 50 40", "cannot be"),
        ("PINHOLE 1e12 80 120 120 50 40", "cannot be"),
        ("PINHOLE 100 80 120 nan 50 40", "finite"),
        ("PINHOLE 100 80 120 x 50 40", "should be a number"),
        ("PINHOLE 100 80 -120 120 50 40", "positive"),
        ("PINHOLE", "should be CAMERA_ID MODEL"),
    ],
)
def test_a_bad_colmap_camera_is_refused(tmp_path, camera, words):
    assert words in refused(colmap_text(tmp_path / "m", camera))


def test_photos_of_one_name_in_two_folders_are_refused(tmp_path):
    folder = colmap_text(tmp_path / "m", "SIMPLE_PINHOLE 100 80 120 50 40", "x/two.jpg")
    assert "two cameras for two.jpg" in refused(folder)


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin"])
def test_binary_cut_anywhere_is_refused(tmp_path, photo_folder, file):
    folder = tmp_path / "m"
    write_cameras(folder, camera_set(photo_folder), "colmap")
    whole = (folder / file).read_bytes()
    for length in range(1, len(whole), 3):
        (folder / file).write_bytes(whole[:length])
        assert "truncated" in refused(folder, "colmap")


def test_absurd_counts_need_no_memory(tmp_path, photo_folder):
    folder = tmp_path / "m"
    write_cameras(folder, camera_set(photo_folder), "colmap")
    images = (folder / "images.bin").read_bytes()
    (folder / "images.bin").write_bytes(struct.pack("<Q", 2**62) + images[8:])
    assert "truncated" in refused(folder)
    # As many points in the first photo.
    end = images.index(b"\0", 8 + 64) + 1
    many = images[:end] + struct.pack("<Q", 2**60) + images[end + 8 :]
    (folder / "images.bin").write_bytes(many)
    assert "truncated" in refused(folder)
