"""transforms.json of nerfstudio."""

import json

import numpy as np

from photoreg.formats.cameras.registry import read_cameras
from tests.formats.camera_files import NAMES, camera_set, points_before, refused, write


def test_nerfstudio_looks_along_minus_z(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    path, _ = write(tmp_path, "nerfstudio", cameras)
    document = json.loads(path.read_text(encoding="utf-8"))
    for frame, camera in zip(document["frames"], cameras.cameras.values(), strict=True):
        points = points_before(camera)
        to_camera = np.linalg.inv(frame["transform_matrix"])
        x, y, z = (points @ to_camera[:3, :3].T + to_camera[:3, 3]).T
        u = frame["cx"] + frame["fl_x"] * x / -z - 0.5
        v = frame["cy"] - frame["fl_y"] * y / -z - 0.5
        error = np.abs(np.column_stack([u, v]) - camera.project(points)).max()
        assert error < 1e-6, error
        assert (path.parent / frame["file_path"]).is_file()


def test_nerfstudio_s_field_of_view_and_the_photo_s_size_are_enough(
    tmp_path, photo_folder
):
    cameras = camera_set(photo_folder)
    path = photo_folder / "transforms.json"
    pose = np.eye(4).tolist()
    frames = [{"file_path": f"./{NAMES[0]}", "transform_matrix": pose}]
    path.write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))
    camera = read_cameras(path, photos=cameras.photos).cameras[NAMES[0]]
    f = 80.0 / np.tan(0.5)
    np.testing.assert_allclose(camera.K, [[f, 0, 79.5], [0, f, 48.0], [0, 0, 1]])


def test_lens_distortion_of_nerfstudio_is_refused(tmp_path, photo_folder):
    path, _ = write(tmp_path, "nerfstudio", camera_set(photo_folder))
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**document, "k1": -0.02}))
    assert "undistort the photos" in refused(path)
