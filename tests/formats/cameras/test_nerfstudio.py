"""transforms.json of nerfstudio."""

import json

import numpy as np
import pytest

from photoreg.formats.cameras.registry import read_cameras
from photoreg.geometry.lens import Lens
from tests.formats.camera_files import NAMES, camera_set, points_before, refused, write
from tests.moved_cameras import write_moved


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


def test_a_fourth_radial_term_of_nerfstudio_is_refused(tmp_path, photo_folder):
    path, _ = write(tmp_path, "nerfstudio", camera_set(photo_folder))
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**document, "k4": -0.02}))
    assert "undistort the photos" in refused(path)


@pytest.mark.parametrize("of_frame", [False, True])
def test_lens_terms_in_one_list_are_read_in_nerfstudio_s_order(
    tmp_path, photo_folder, of_frame
):
    path, _ = write(tmp_path, "nerfstudio", camera_set(photo_folder))
    document = json.loads(path.read_text(encoding="utf-8"))
    holder = document["frames"][1] if of_frame else document
    holder["distortion_params"] = [-0.02, 0.01, 0.003, 0.0, 0.001, -0.002]
    path.write_text(json.dumps(document))
    lenses = [camera.lens for camera in read_cameras(path).cameras.values()]
    assert lenses[1] == Lens(k1=-0.02, k2=0.01, k3=0.003, p1=0.001, p2=-0.002)
    assert lenses[0].is_ideal is of_frame
    holder["distortion_params"][3] = 1e-3
    path.write_text(json.dumps(document))
    assert "(k4)" in refused(path)


def test_poses_moved_to_another_world_and_masks_are_named(tmp_path, photo_folder):
    path, _ = write(tmp_path, "nerfstudio", camera_set(photo_folder))
    assert read_cameras(path).notes == ()
    document = json.loads(path.read_text(encoding="utf-8"))
    same = np.eye(4)[:3].tolist()
    path.write_text(json.dumps({**document, "applied_transform": same}))
    assert read_cameras(path).notes == ()
    turn = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]
    document["frames"][0]["mask_path"] = "masks/1.png"
    path.write_text(json.dumps({**document, "applied_transform": turn}))
    file = read_cameras(path)
    assert file.moved is not None
    moved, masks = file.notes
    assert "applied_transform" in moved
    assert "COLMAP" in moved
    assert "mask_path" in masks


def test_how_poses_were_moved_can_be_undone(tmp_path, photo_folder):
    before = camera_set(photo_folder)
    path = tmp_path / "transforms.json"
    write_moved(path, before.cameras)
    file = read_cameras(path)
    assert file.moved is not None
    for name, camera in before.cameras.items():
        again = file.moved.undone(file.cameras[name])
        np.testing.assert_allclose(again.P, camera.P, atol=1e-9)
        assert np.abs(file.cameras[name].P - camera.P).max() > 0.1


@pytest.mark.parametrize("rows", [[[1, 0], [0, 1]], [[2, 0, 0, 0]] * 3, "turned"])
def test_a_move_that_is_no_turn_is_named_and_not_undone(tmp_path, photo_folder, rows):
    path, _ = write(tmp_path, "nerfstudio", camera_set(photo_folder))
    document = json.loads(path.read_text(encoding="utf-8"))
    document |= {"applied_transform": rows, "applied_scale": 2.0}
    path.write_text(json.dumps(document))
    file = read_cameras(path)
    assert file.moved is None
    assert "applied_transform" in file.notes[0]
