"""Lens terms are refused by name in every format; zeros and other keys are not."""

import json
from typing import Any

import pytest

from photoreg.errors import InputError
from photoreg.formats.cameras.lens_terms import refuse_lens_terms
from photoreg.formats.cameras.registry import read_cameras
from tests.formats.camera_files import camera_set, refused, write

TERMS: list[tuple[str, Any]] = [
    ("k1", -0.02),
    ("k5", 1e-4),
    ("p2", "0.001"),
    ("s1", 0.1),
    ("b1", 2.5),
    ("tauX", 0.01),
    ("distortion", [0.1, 0, 0, 0, 0]),
    ("distortion_params", [0.1, 0.0, 0.0, 0.0]),
    ("distortion_coefficients", {"rows": 1, "cols": 5, "data": [0, 0.1, 0, 0, 0]}),
    ("distCoeffs", [[0.1, 0.0]]),
    ("dist", [0.1]),
    ("D", [0.0, 0.0, 0.3]),
    ("radial_distortion", {"k1": 0.1}),
    ("is_fisheye", True),
    ("ftheta_p0", 1.0),
    ("rolling_shutter", [0.0, 0.0, 0.1]),
    ("distortion_model", "equidistant"),
    ("model", "OPENCV_FISHEYE"),
    ("projection", "equirectangular"),
]
HARMLESS: list[tuple[str, Any]] = [
    ("k1", 0.0),
    ("distortion", [0, 0.0, "0"]),
    ("distortion_coefficients", {"rows": 1, "cols": 5, "data": ["0.", 0, 0, 0, 0]}),
    ("is_fisheye", False),
    ("distortion_model", "plumb_bob"),
    ("distance", 4.2),
    ("description", "k1 of the kitchen"),
    ("k1", None),
]


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        (name, *term)
        for name in ("photoreg", "nerfstudio")
        for term in TERMS
        # nerfstudio's own terms are photoreg's.
        if name == "photoreg" or term[0] not in ("k1", "p2")
    ],
)
def test_a_lens_term_is_refused_by_its_name(tmp_path, photo_folder, name, key, value):
    path, _ = write(tmp_path, name, camera_set(photo_folder))
    document = json.loads(path.read_text(encoding="utf-8"))
    of_camera = document["frames" if name == "nerfstudio" else "cameras"][1]
    path.write_text(json.dumps({**document, key: value}), encoding="utf-8")
    assert key in refused(path)
    assert "undistort" in refused(path)
    of_camera[key] = value
    path.write_text(json.dumps(document), encoding="utf-8")
    assert key in refused(path)


@pytest.mark.parametrize(("key", "value"), HARMLESS)
def test_zeros_and_other_keys_are_no_lens_terms(tmp_path, photo_folder, key, value):
    path, _ = write(tmp_path, "photoreg", camera_set(photo_folder))
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**document, key: value}), encoding="utf-8")
    assert len(read_cameras(path).cameras) == 3


def test_opencv_s_own_name_is_refused(tmp_path, photo_folder):
    path, _ = write(tmp_path, "opencv", camera_set(photo_folder))
    matrix = "!!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 0.1, 0. ]"
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}distortion_coefficients: {matrix}\n", encoding="utf-8")
    assert "distortion_coefficients" in refused(path)


def test_the_sentence_says_where():
    with pytest.raises(InputError, match=r"^a\.json, camera 3 .*\(K_1\)"):
        refuse_lens_terms({"K_1": 1}, "a.json, camera 3")
