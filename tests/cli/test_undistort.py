"""`photoreg undistort`: what comes out is what an ideal lens would have taken."""

import cv2
import numpy as np

from photoreg.cli.commands import run
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras, save_cameras
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens


def _dots(camera: Camera, points: np.ndarray) -> np.ndarray:
    """A photo of soft dots where the camera sees points."""
    rows, columns = np.indices((camera.height, camera.width))
    picture = np.zeros((camera.height, camera.width))
    for u, v in camera.project(points):
        picture += np.exp(-0.5 * ((columns - u) ** 2 + (rows - v) ** 2) / 4.0)
    return np.repeat(np.rint(250.0 * picture)[:, :, None], 3, axis=2).astype(np.uint8)


def test_points_lie_where_the_pinhole_camera_sees_them(tmp_path):
    camera = Camera.look_at([0, 0, -4], [0, 0, 0], [0, -1, 0], 200.0, 256, 192)
    camera = camera.with_lens(Lens(-0.15, 0.02, 0.002, -0.001))
    grid = np.stack(np.meshgrid(*[np.linspace(-1.4, 1.4, 5)] * 2), axis=-1)
    points = np.column_stack([grid.reshape(-1, 2), np.zeros(25)])
    cv2.imwrite(str(tmp_path / "a.tiff"), _dots(camera, points))
    save_cameras(tmp_path / "cameras.json", CameraFile({"a.tiff": camera}))
    status = run(
        [
            *("undistort", str(tmp_path / "a.tiff")),
            *("--cameras", str(tmp_path / "cameras.json")),
            *("--out", str(tmp_path / "ideal")),
        ]
    )
    assert status == 0
    ideal = load_cameras(tmp_path / "ideal" / "cameras.json").cameras["a.png"]
    assert ideal.lens.is_ideal
    assert np.array_equal(ideal.P, camera.P)
    photo = load_photo(tmp_path / "ideal" / "a.png")
    expected = _dots(ideal, points).astype(float)
    off = np.abs(photo.pixels.astype(float) - expected)[photo.mask]
    # The lens shrank the dots near the corners by a few percent.
    assert off.mean() < 1.5
    bent = np.abs(_dots(camera, points).astype(float) - expected)
    assert bent.mean() > 3.0 * off.mean()
    # What no pixel showed is not there: the lens saw less than the pinhole would.
    assert photo.mask is None or photo.mask.mean() > 0.9


def test_two_photos_of_one_stem_are_refused(tmp_path, capsys):
    save = [str(tmp_path / "a.png"), str(tmp_path / "a.jpg")]
    argv = ["undistort", *save, "--cameras", "c.json", "--out", str(tmp_path / "o")]
    assert run(argv) == 2
    assert "suffix" in capsys.readouterr().err


def test_no_photo_is_refused(tmp_path):
    argv = ["undistort", "--cameras", "c.json", "--out", str(tmp_path / "o")]
    assert run(argv) == 2
