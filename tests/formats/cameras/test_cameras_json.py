import json

import numpy as np
import pytest

from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras, save_cameras
from photoreg.imaging.photo import Photo
from tests.geometry.test_camera import make_camera


def document() -> dict:
    camera = make_camera()
    return {
        "format": "photoreg-cameras",
        "version": 1,
        "scanner": "ours",
        "cameras": [
            {
                "photo": "löwe 1.jpg",
                "width": 640,
                "height": 480,
                "K": camera.K.tolist(),
                "R": camera.R_cam_world.tolist(),
                "t": camera.t_cam_world.tolist(),
                "lens": {"name": "50 mm"},
            }
        ],
    }


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(document()), encoding="utf-8")
    return path


def test_a_round_trip_keeps_every_number_and_unknown_key(path, tmp_path):
    again = tmp_path / "again.json"
    save_cameras(again, load_cameras(path))
    assert json.loads(again.read_text(encoding="utf-8")) == document()


def test_replaced_cameras_keep_the_unknown_keys(path, tmp_path):
    other = make_camera(8)
    file = load_cameras(path).with_cameras({"löwe 1.jpg": other})
    save_cameras(tmp_path / "out.json", file)
    entry = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["cameras"][
        0
    ]
    assert entry["lens"] == {"name": "50 mm"}
    assert entry["t"] == other.t_cam_world.tolist()


def test_photos_find_their_cameras_by_name(path):
    photo = Photo("löwe 1.jpg", np.zeros((480, 640, 3), np.uint8))
    (camera,) = load_cameras(path).of_photos([photo])
    assert np.array_equal(camera.K, make_camera().K)


def test_a_photo_without_a_camera_is_named(path):
    photo = Photo("other.jpg", np.zeros((480, 640, 3), np.uint8))
    with pytest.raises(InputError, match=r"no camera for other\.jpg; it has löwe"):
        load_cameras(path).of_photos([photo])


def test_a_photo_of_another_size_is_refused(path):
    photo = Photo("löwe 1.jpg", np.zeros((640, 480, 3), np.uint8))
    with pytest.raises(InputError, match="480x640 px, but its camera is for 640x480"):
        load_cameras(path).of_photos([photo])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(format="colmap"), "not a photoreg camera file"),
        (lambda d: d.update(version=3), "Update photoreg"),
        (lambda d: d.update(cameras={}), "list"),
        (lambda d: d["cameras"].append(d["cameras"][0]), "two cameras"),
        (lambda d: d["cameras"][0].pop("K"), "camera 1 lacks K"),
        (lambda d: d["cameras"][0].update(width="wide"), "whole numbers"),
        (lambda d: d["cameras"][0].update(width=10**9), "whole numbers"),
        (lambda d: d["cameras"][0].update(width=True), "whole numbers"),
        (lambda d: d["cameras"][0].update(photo=7), "file name"),
        (lambda d: d["cameras"][0].update(t=[1, 2]), r"löwe 1\.jpg.*shape"),
        (lambda d: d["cameras"][0].update(K=[[0, 0, 0]] * 3), "upper triangular"),
        (lambda d: d["cameras"][0].update(R=[[2, 0, 0], [0, 2, 0], [0, 0, 2]]), "rot"),
    ],
)
def test_a_wrong_file_is_refused_in_words(path, change, words):
    wrong = document()
    change(wrong)
    path.write_text(json.dumps(wrong), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_cameras(path)


@pytest.mark.parametrize("text", ["{", "\xff\xfe", "[" * 100_000])
def test_what_is_not_json_is_refused(tmp_path, text):
    path = tmp_path / "cameras.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match="not a JSON file"):
        load_cameras(path)


def test_saving_into_a_missing_folder_says_so(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        save_cameras(tmp_path / "nowhere" / "out.json", CameraFile({}))
