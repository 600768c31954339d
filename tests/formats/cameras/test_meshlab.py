"""MeshLab projects: padded photos, matrices, and what MeshLab itself saves."""

import dataclasses

import numpy as np
from PIL import Image

from photoreg.formats.cameras.camera_set import CameraSet, largest_shift_px
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from photoreg.geometry.camera import Camera
from tests.formats.camera_files import (
    NAMES,
    camera_set,
    largest_error_px,
    points_before,
    refused,
    write,
)


def test_meshlab_keeps_all_but_a_hundredth_of_a_pixel(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    path, saved = write(tmp_path, "meshlab", cameras)
    read = read_cameras(path)
    for photo, camera in cameras.cameras.items():
        back = read.cameras[photo]
        np.testing.assert_allclose(back.center, camera.center, atol=1e-9)
        assert np.abs(back.K - camera.K)[:2, 2].max() <= 0.25 + 1e-9
        np.testing.assert_allclose(back.K[:2, :2], camera.K[:2, :2], rtol=1e-12)
        # A quarter of a pixel, at an angle of up to atan(0.4).
        error = largest_shift_px(camera, back)
        assert error < 0.05, error
    assert saved.losses == []
    # What has been read is kept wholly: its rest of a pixel is gone.
    again = tmp_path / "again.mlp"
    write_cameras(again, CameraSet(read.cameras, cameras.photos))
    for photo, camera in read.cameras.items():
        error = largest_error_px(camera, read_cameras(again).cameras[photo])
        assert error < 1e-6, error


def test_meshlab_sees_each_photo_around_its_principal_point(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    path, saved = write(tmp_path, "meshlab", cameras)
    text = path.read_text()
    for (name, camera), file in zip(
        cameras.cameras.items(), saved.files[1:], strict=True
    ):
        with Image.open(file) as picture:
            padded = np.array(picture)
        height, width = padded.shape[:2]
        assert f'ViewportPx="{width} {height}" ' in text
        assert f'CenterPx="{width / 2} {height / 2}"' in text
        rows, columns = np.nonzero(padded[:, :, 3])
        x, y = columns.min(), rows.min()
        inside = padded[y : y + camera.height, x : x + camera.width]
        assert (inside[:, :, 3] == 255).all()
        assert len(rows) == camera.width * camera.height
        with Image.open(cameras.photos[name]) as picture:
            np.testing.assert_array_equal(inside[:, :, :3], picture.convert("RGB"))
        off = camera.K[:2, 2] + (x, y) - (0.5 * (width - 1), 0.5 * (height - 1))
        assert np.abs(off).max() <= 0.25 + 1e-9, off


def test_a_wide_photo_s_rest_of_a_pixel_is_told(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    wide = {}
    for name, camera in cameras.cameras.items():
        K = np.diag([0.3, 0.3, 1.0]) @ camera.K
        K[:2, 2] = camera.K[:2, 2]
        wide[name] = dataclasses.replace(camera, K=K)
    path, saved = write(tmp_path, "meshlab", CameraSet(wide, cameras.photos))
    read = read_cameras(path).cameras
    moved = [largest_shift_px(wide[name], read[name]) for name in wide]
    assert len(saved.losses) == sum(shift > 0.05 for shift in moved) > 0
    assert "to the pixel only" in saved.losses[0]


def test_a_meshlab_matrix_is_undone(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    mesh = tmp_path / "mesh.ply"
    path = tmp_path / "p.mlp"
    write_cameras(path, CameraSet(cameras.cameras, cameras.photos, mesh))
    before = read_cameras(path).cameras
    # Twice the size, a quarter turn about z, and moved.
    rows = "0 -2 0 5\n2 0 0 -1\n0 0 2 3\n0 0 0 1\n"
    text = path.read_text(encoding="utf-8")
    head, tail = text.split("<MLMatrix44>")
    tail = tail.split("</MLMatrix44>")[1]
    path.write_text(f"{head}<MLMatrix44>{rows}</MLMatrix44>{tail}", encoding="utf-8")
    after = read_cameras(path).cameras
    for name, camera in before.items():
        shown = points_before(camera)
        M = np.array([row.split() for row in rows.splitlines()], dtype=float)
        in_file = (shown - M[:3, 3]) @ np.linalg.inv(M[:3, :3]).T
        error = np.abs(after[name].project(in_file) - camera.project(shown)).max()
        assert error < 1e-6, error


def test_what_meshlab_saved_again_is_read(tmp_path):
    path = tmp_path / "again.mlp"
    path.write_text(
        "<!DOCTYPE MeshLabDocument>\n<MeshLabProject><MeshGroup/><RasterGroup>"
        '<MLRaster label="b.png"><VCGCamera CameraType="0" PixelSizeMm="0.01 0.02" '
        'TranslationVector="-3 -1 2 1" ViewportPx="400 300" RotationMatrix="1 0 0 0 0 '
        '1 0 0 0 0 1 0 0 0 0 1 " FocalMm="5" LensDistortion="0 0" CenterPx="210 140" '
        'BinaryData="0"/><Plane fileName="photos\\b.png" semantic="1"/></MLRaster>'
        "</RasterGroup></MeshLabProject>"
    )
    camera = read_cameras(path).cameras["b.png"]
    np.testing.assert_allclose(camera.K, [[500, 0, 209.5], [0, 250, 159.5], [0, 0, 1]])
    np.testing.assert_allclose(camera.center, [3, 1, -2])


def test_lens_distortion_of_meshlab_is_refused(tmp_path, photo_folder):
    path, _ = write(tmp_path, "meshlab", camera_set(photo_folder))
    text = path.read_text(encoding="utf-8")
    path.write_text(
        text.replace('LensDistortion="0 0"', 'LensDistortion="0.1 0"'), encoding="utf-8"
    )
    assert "undistort the photos" in refused(path)


def test_a_centred_photo_is_used_as_it_is(tmp_path, photo_folder):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0.1, 1], 150.0, 160, 97)
    cameras = CameraSet({NAMES[0]: camera}, camera_set(photo_folder).photos)
    path, saved = write(tmp_path, "meshlab", cameras)
    assert saved.files == [path]
    assert f'fileName="my photos/{NAMES[0]}"' in path.read_text(encoding="utf-8")
    assert largest_error_px(camera, read_cameras(path).cameras[NAMES[0]]) < 1e-6
