"""AliceVision's .sfm: what its numbers mean in each version, and what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.find import find_camera_file
from photoreg.formats.cameras.registry import format_to_read, read_cameras
from photoreg.formats.mark import is_marked
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from tests.formats.camera_files import NAMES, camera_set, points_before, write

# AliceVision's own sample scene (sceneSample.cpp), and how its files of each version have it
# (compatibilityData): the pose turned by the vector (-1, -1, -1), seen from there.
SIZE, FX, FY = (4092, 2048), 1000.0, 2000.0
OFFSET, RADIAL = (-26.0, 16.0), (0.1, 0.05, -0.001)
ROTATION = Rotation.from_rotvec([-1.0, -1.0, -1.0]).as_matrix()
ROTATION_TEXTS = [
    *("0.22629564095020641", "-0.18300791965761709", "0.95671227870741093"),
    *("0.95671227870741093", "0.22629564095020641", "-0.18300791965761709"),
    *("-0.18300791965761709", "0.95671227870741093", "0.22629564095020641"),
]
OF_FX, OF_FY = "8.7976539589442808", "17.595307917888562"
SINCE_1_2_7 = {"type": "pinhole", "distortionType": "radialk3"}
BY_VERSION: dict[str, dict[str, Any]] = {
    "1.0.0": {"pxFocalLength": "1000", "principalPoint": ["2020", "1040"]},
    "1.2.0": {"pxFocalLength": ["1000", "2000"], "principalPoint": ["2020", "1040"]},
    "1.2.1": {"pxFocalLength": ["1000", "2000"]},
    "1.2.3": {"focalLength": OF_FX, "pixelRatio": "0.5"},
    "1.2.6": {"focalLength": OF_FX, "pixelRatio": "2"},
    "1.2.8": {"focalLength": OF_FX, "pixelRatio": "2", **SINCE_1_2_7},
    "1.2.11": {"focalLength": OF_FY, "pixelRatio": "2", **SINCE_1_2_7},
    "1.2.14": {"focalLength": OF_FY, "pixelRatio": "2", **SINCE_1_2_7},
}


def document(version: str = "1.2.14", **changes: Any) -> dict[str, Any]:
    intrinsics = {
        "intrinsicId": "1",
        "width": "4092",
        "height": "2048",
        "sensorWidth": "36",
        "sensorHeight": "24",
        "serialNumber": "",
        "type": "radial3",
        "initializationMode": "none",
        "principalPoint": ["-26", "16"],
        "distortionLocked": "true",
        "distortionInitializationMode": "calibrated",
        "distortionParams": ["0.10000000000000001", "0.050000000000000003", "-0.001"],
        "undistortionOffset": ["0", "0"],
        "undistortionParams": "",
        "locked": "false",
        **BY_VERSION.get(version, BY_VERSION["1.2.14"]),
        **changes,
    }
    transform = {"rotation": ROTATION_TEXTS, "center": ["-1", "-1", "-1"]}
    view = {"viewId": "5", "poseId": "0", "intrinsicId": "1", "path": "C:\\p\\a.jpg"}
    return {
        "version": version.split("."),
        "views": [view, {"viewId": "6", "poseId": "9", "path": "/x/b.jpg"}],
        "intrinsics": [intrinsics],
        "poses": [{"poseId": "0", "pose": {"transform": transform, "locked": "0"}}],
    }


def read(folder: Path, content: dict[str, Any]):
    path = folder / "cameras.sfm"
    path.write_text(json.dumps(content), encoding="utf-8")
    return read_cameras(path)


def as_alicevision_projects(points_world: np.ndarray) -> np.ndarray:
    """Pose3, DistortionRadialK3 and cam2ima, word by word."""
    x, y, z = ROTATION @ (points_world + 1.0).T
    p = np.stack([x / z, y / z])
    r2 = (p**2).sum(axis=0)
    k1, k2, k3 = RADIAL
    p = p * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3)
    offset = np.array(OFFSET) + np.array(SIZE) / 2
    return p.T * [FX, FY] + offset


@pytest.mark.parametrize("version", BY_VERSION)
def test_the_sample_scene_projects_as_in_alicevision(tmp_path, version):
    file = read(tmp_path, document(version))
    (camera,) = file.cameras.values()
    assert list(file.cameras) == ["a.jpg"]
    assert (camera.width, camera.height) == SIZE
    points = points_before(
        Camera(camera.K, camera.R_cam_world, camera.t_cam_world, *SIZE)
    )
    expected = as_alicevision_projects(points)
    if version == "1.0.0":  # Which had one focal length.
        expected[:, 1] += (expected[:, 1] - 1040) * (FX / FY - 1.0)
    np.testing.assert_allclose(
        camera.project(points), expected, atol=1e-6, equal_nan=False
    )
    assert "found no pose of 1 photos of cameras.sfm (b.jpg)" in file.notes[0]


def test_browns_terms_are_opencvs(tmp_path):
    terms = ["0.1", "0.02", "-0.01", "0.003", "-0.004"]
    for changes in (
        {"type": "brown", "distortionType": "none"},
        {"distortionType": "brown"},
    ):
        content = document(distortionParams=terms, **changes)
        (camera,) = read(tmp_path, content).cameras.values()
        # DistortionBrown: t1 goes with r^2 + 2 y^2 in y, as p1 does.
        assert camera.lens == Lens(0.1, 0.02, 0.003, -0.004, -0.01)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"distortionType": "radialk3pt"}, "distortionType: radialk3pt"),
        (
            {"distortionType": "fisheye"},
            r"distortionType: fisheye.*undistort the photos",
        ),
        ({"type": "fisheye4"}, r"type: fisheye4.*undistort the photos"),
        ({"type": "equidistant"}, "type: equidistant"),
        ({"undistortionType": "3deanamorphic4"}, "undistortionType"),
        ({"undistortionParams": ["0.1"]}, "undistortionParams"),
        ({"distortionParams": ["0.1"]}, "3 numbers"),
        ({"principalPoint": "1"}, "2 numbers"),
        ({"focalLength": "nan"}, "finite"),
        ({"focalLength": None}, "focalLength"),
        ({"sensorWidth": "0"}, "positive"),
        ({"intrinsicId": "7"}, "intrinsics are not in the file"),
    ],
)
def test_what_is_not_known_is_refused_by_name(tmp_path, changes, named):
    with pytest.raises(InputError, match=named):
        read(tmp_path, document(**changes))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"version": ["1", "3", "0"]}, r"version 1\.3\.0"),
        ({"version": "1"}, "three numbers"),
        ({"version": ["1", "2", "10"]}, "pixelRatio of 2"),
        ({"poses": []}, "has no poses"),
        ({"views": [3]}, "list of objects"),
        ({"poses": [{"poseId": "0"}]}, "its pose should be an object"),
    ],
)
def test_a_file_that_is_not_understood_is_refused(tmp_path, change, named):
    with pytest.raises(InputError, match=named):
        read(tmp_path, document() | change)


def test_a_rig_is_refused_and_a_new_version_named(tmp_path):
    content = document()
    content["views"][0]["rigId"] = "3"
    with pytest.raises(InputError, match="rig"):
        read(tmp_path, content)
    content = document() | {"version": ["1", "2", "99"]}
    assert "newer than those that photoreg knows" in read(tmp_path, content).notes[1]


def test_it_is_recognised_by_suffix_and_by_contents(tmp_path):
    for name in ("a.sfm", "a.json"):
        (tmp_path / name).write_text(json.dumps(document()))
        assert format_to_read(tmp_path / name).name == "alicevision"
    (tmp_path / "a.json").unlink()
    # Meshroom's other nodes leave files without poses beside.
    (tmp_path / "cameraInit.sfm").write_text('{"views": [], "intrinsics": []}')
    assert find_camera_file(tmp_path) == tmp_path / "a.sfm"


def test_a_written_file_names_photos_where_they_are(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    path, saved = write(tmp_path, "alicevision", cameras)
    assert saved.files == [path]
    assert is_marked(path)
    views = json.loads(path.read_text())["views"]
    assert [view["path"] for view in views] == [
        cameras.photos[name].resolve().as_posix() for name in NAMES
    ]
    _, _ = write(photo_folder, "alicevision", cameras)
    views = json.loads((photo_folder / path.name).read_text())["views"]
    assert [view["path"] for view in views] == list(NAMES)


def test_a_written_file_has_the_fields_of_its_version(tmp_path):
    lens = Lens(-0.1, 0.02, 1e-3, -2e-3, 0.005)
    camera = Camera.look_at([1.0, -2.0, 4.0], [0, 0, 0], [0, 0, 1], 90.0, 64, 48)
    cameras = CameraSet({"a.png": camera.with_lens(lens)})
    path, _ = write(tmp_path, "alicevision", cameras)
    content = json.loads(path.read_text())
    assert content["version"] == ["1", "2", "6"]
    given = content["intrinsics"][0]
    assert given["type"] == "brown"
    assert [float(v) for v in given["distortionParams"]] == [
        *(-0.1, 0.02, 0.005, 1e-3, -2e-3)
    ]
    assert float(given["focalLength"]) == pytest.approx(90.0 / 64 * 36.0)
    rotation = content["poses"][0]["pose"]["transform"]["rotation"]
    np.testing.assert_allclose(
        np.array(rotation, dtype=float), camera.R_cam_world.T.ravel()
    )
