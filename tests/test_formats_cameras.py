"""Camera files of every format: out and in, what is lost, and what is told."""

import dataclasses
import json
import struct
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from photoreg.camera import Camera
from photoreg.errors import InputError, OutputError
from photoreg.formats.camera_set import CameraSet, Saved, largest_shift_px
from photoreg.formats.cameras import (
    CAMERA_FORMATS,
    FormatName,
    format_to_read,
    format_to_write,
    read_cameras,
    write_cameras,
)
from tests.camera_files import (
    NAMES,
    camera_set,
    general_cameras,
    largest_error_px,
    points_before,
)

PLACES = {
    "photoreg": "out.json",
    "colmap": "model",
    "colmap-text": "model",
    "nerfstudio": "transforms.json",
    "meshlab": "out.mlp",
    "texrecon": "scene",
    "opencv": "out.yml",
    "bundler": "bundle.out",
    "blender": "setup.py",
}
READABLE = [name for name, f in CAMERA_FORMATS.items() if f.load is not None]
EXACT = [name for name in READABLE if name not in ("meshlab", "bundler")]


@pytest.fixture
def photos(tmp_path) -> Path:
    folder = tmp_path / "my photos"
    folder.mkdir()
    return folder


def write(tmp_path: Path, name: str, cameras: CameraSet) -> tuple[Path, Saved]:
    path = tmp_path / PLACES[name]
    return path, write_cameras(path, cameras, name)


def test_the_names_of_formats_are_those_of_the_registry():
    assert list(get_args(FormatName)) == list(CAMERA_FORMATS) == list(PLACES)


# Round trips.


@pytest.mark.parametrize("name", EXACT)
def test_projections_survive_a_round_trip(tmp_path, photos, name):
    cameras = camera_set(photos)
    path, saved = write(tmp_path, name, cameras)
    # COLMAP itself cuts names at spaces in text; photoreg does not.
    assert len(saved.losses) == (3 if name == "colmap-text" else 0), saved.losses
    read = read_cameras(path, photos=cameras.photos)
    assert set(read.cameras) == set(NAMES)
    for photo, camera in cameras.cameras.items():
        back = read.cameras[photo]
        assert (back.width, back.height) == (camera.width, camera.height)
        error = largest_error_px(camera, back)
        assert error < 1e-6, (photo, error)


@pytest.mark.parametrize("name", EXACT)
def test_skew_is_kept_or_its_loss_is_told(tmp_path, photos, name):
    cameras = camera_set(photos, skew=2.5)
    path, saved = write(tmp_path, name, cameras)
    read = read_cameras(path, photos=cameras.photos)
    moved = max(
        largest_shift_px(camera, read.cameras[photo])
        for photo, camera in cameras.cameras.items()
    )
    if name in ("photoreg", "opencv"):
        assert saved.losses == []
        assert moved < 1e-6, moved
    else:
        losses = [loss for loss in saved.losses if "skew" in loss]
        assert len(losses) == 3
        assert "skew of 2.5 px, which cannot be folded" in losses[0]
        told = max(float(loss.split(" px.")[0].split()[-1]) for loss in losses)
        assert told == pytest.approx(moved, rel=0.05)


def test_meshlab_keeps_all_but_a_hundredth_of_a_pixel(tmp_path, photos):
    cameras = camera_set(photos)
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


def test_meshlab_sees_each_photo_around_its_principal_point(tmp_path, photos):
    cameras = camera_set(photos)
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


def test_a_wide_photo_s_rest_of_a_pixel_is_told(tmp_path, photos):
    cameras = camera_set(photos)
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


def test_bundler_keeps_a_plain_camera_and_tells_what_another_loses(tmp_path, photos):
    cameras = camera_set(photos)
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


# Each format's own words: independent readings of what it defines.


def test_colmap_binary_and_text_tell_the_same(tmp_path, photos):
    cameras = camera_set(photos)
    write_cameras(tmp_path / "a", cameras, "colmap")
    write_cameras(tmp_path / "b", cameras, "colmap-text")
    binary, text = (read_cameras(tmp_path / f).cameras for f in "ab")
    for name in NAMES:
        np.testing.assert_array_equal(binary[name].P, text[name].P)


def test_colmap_s_first_pixel_has_its_centre_at_one_half(tmp_path, photos):
    cameras = camera_set(photos)
    write_cameras(tmp_path / "a", cameras, "colmap-text")
    line = (tmp_path / "a" / "cameras.txt").read_text().splitlines()[2].split()
    K = cameras.cameras[NAMES[0]].K
    assert line[:4] == ["1", "PINHOLE", "160", "97"]
    expected = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5]
    np.testing.assert_array_equal(np.array(line[4:], dtype=float), expected)


def test_nerfstudio_looks_along_minus_z(tmp_path, photos):
    cameras = camera_set(photos)
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


def test_texrecon_divides_by_the_longer_side_as_mve_does(tmp_path, photos):
    cameras = camera_set(photos)
    folder, saved = write(tmp_path, "texrecon", cameras)
    for name, camera in cameras.cameras.items():
        rows = (folder / f"{Path(name).stem}.cam").read_text().splitlines()
        t, R = np.split(np.array(rows[0].split(), dtype=float), [3])
        f, _, _, aspect, ppx, ppy = map(float, rows[1].split())
        # CameraInfo::fill_calibration, TextureView::get_pixel_coords.
        width, height = camera.width, camera.height
        if width / height * aspect < 1.0:
            ax, ay = f * height / aspect, f * height
        else:
            ax, ay = f * width, f * width * aspect
        points = points_before(camera)
        x, y, z = (points @ R.reshape(3, 3).T + t).T
        pixels = np.column_stack(
            [ax * x / z + width * ppx - 0.5, ay * y / z + height * ppy - 0.5]
        )
        error = np.abs(pixels - camera.project(points)).max()
        assert error < 1e-6, error
        assert (folder / name).read_bytes() == cameras.photos[name].read_bytes()
    assert len(saved.files) == 6


def test_opencv_reads_and_projects_what_is_written(tmp_path, photos):
    cameras = camera_set(photos, skew=1.0)
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


def test_bundler_s_middle_is_that_of_the_photo(tmp_path, photos):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0.1, 1], 150.0, 160, 97)
    cameras = CameraSet({NAMES[0]: camera}, camera_set(photos).photos)
    path, saved = write(tmp_path, "bundler", cameras)
    assert saved.losses == []
    rows = [list(map(float, r.split())) for r in path.read_text().splitlines()[2:]]
    points = points_before(camera)
    P = points @ np.array(rows[1:4]).T + rows[4]
    p = -P[:, :2] / P[:, 2:] * rows[0][0]
    pixels = np.column_stack([79.5 + p[:, 0], 48.0 - p[:, 1]])
    error = np.abs(pixels - camera.project(points)).max()
    assert error < 1e-6, error


def test_blender_s_script_is_python_whatever_the_names(tmp_path, photos):
    cameras = camera_set(photos)
    name = 'a """ quote \\n.png'
    more = {**cameras.cameras, 'q\'""" x.png': cameras.cameras[NAMES[0]]}
    path, saved = write(tmp_path, "blender", CameraSet(more, cameras.photos))
    compile(path.read_text(encoding="utf-8"), str(path), "exec")
    assert saved.losses == []
    assert name not in more


# Projects begun in other programs.


def test_a_colmap_project_is_found_in_sparse_0(tmp_path, photos):
    cameras = camera_set(photos)
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


def test_a_meshlab_matrix_is_undone(tmp_path, photos):
    cameras = camera_set(photos)
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


def test_nerfstudio_s_field_of_view_and_the_photo_s_size_are_enough(tmp_path, photos):
    cameras = camera_set(photos)
    path = photos / "transforms.json"
    pose = np.eye(4).tolist()
    frames = [{"file_path": f"./{NAMES[0]}", "transform_matrix": pose}]
    path.write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))
    camera = read_cameras(path, photos=cameras.photos).cameras[NAMES[0]]
    f = 80.0 / np.tan(0.5)
    np.testing.assert_allclose(camera.K, [[f, 0, 79.5], [0, f, 48.0], [0, 0, 1]])


# What is refused, in one sentence.

BAD_TEXT: list[tuple[str, str, str]] = [
    ("transforms.json", '{"frames": [', "is not a JSON file"),
    ("transforms.json", '{"frames": [1]}', "frame 1 should be an object"),
    ("transforms.json", '{"frames": []}', "has no cameras"),
    (
        "transforms.json",
        '{"w": 9, "h": 9, "fl_x": 9, "frames": [{"file_path": "a.jpg", '
        f'"transform_matrix": [[1{"0" * 400}]]}}]}}',
        "could not be read as numbers",
    ),
    (
        "transforms.json",
        f'{{"w": 1{"0" * 400}, "h": 9, "fl_x": 9, "frames": [{{"file_path": "a.jpg"}}]}}',
        "width should be a number",
    ),
    ("a.mlp", "<MeshLabDocument>", "is not XML"),
    ("a.mlp", "<html/>", "is not a MeshLab project"),
    (
        "a.mlp",
        '<MeshLabDocument><MLRaster><Plane fileName="a.png"/></MLRaster>'
        "</MeshLabDocument>",
        "has no VCGCamera",
    ),
    ("a.mlp", '<!DOCTYPE a [<!ENTITY b "c">]><a/>', "defines entities"),
    ("a.yml", "hello: [", "is not a YAML file that OpenCV reads"),
    ("a.yml", "%YAML:1.0\n---\ncameras: 3\n", "list"),
    ("a.yml", "%YAML:1.0\n---\ncameras: [ 3 ]\n", "should be a map"),
    ("a.yml", "%YAML:1.0\n---\ncameras:\n  - {photo: a.jpg, width: 3}\n", "lacks"),
    ("a.out", "1 0\n", "should begin with"),
    ("a.out", "# Bundle file v0.3\n99999999999 0\n", "photos"),
    ("a.cam", "1 2 3\n", "first line"),
    ("a.cam", "0 0 0 1 0 0 0 1 0 0 0 nan\n1\n", "finite"),
    ("a.cam", "0 0 0 1 0 0 0 1 0 0 0 1\n1 0.1 0\n", "lens distortion"),
    ("a.txt", "x", "is a part of a COLMAP model"),
    ("a.xyz", "x", "is not a camera file"),
    ("a.py", "x", "is not a camera file"),
    ("a.json", "\xff", "is not a JSON file"),
]


def refused(path: Path, name: str | None = None, **more: Any) -> str:
    with pytest.raises(InputError) as caught:
        read_cameras(path, name, **more)
    message = str(caught.value)
    assert "\n" not in message.strip(), message
    return message


@pytest.mark.parametrize(("name", "content", "words"), BAD_TEXT)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path, name, content, words):
    (tmp_path / name).write_text(content, encoding="utf-8")
    assert words in refused(tmp_path / name)


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ("OPENCV 100 80 120 120 50 40 0.1 0 0 0", "undistort the photos"),
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
def test_binary_cut_anywhere_is_refused(tmp_path, photos, file):
    folder = tmp_path / "m"
    write_cameras(folder, camera_set(photos), "colmap")
    whole = (folder / file).read_bytes()
    for length in range(1, len(whole), 3):
        (folder / file).write_bytes(whole[:length])
        assert "truncated" in refused(folder, "colmap")


def test_absurd_counts_need_no_memory(tmp_path, photos):
    folder = tmp_path / "m"
    write_cameras(folder, camera_set(photos), "colmap")
    images = (folder / "images.bin").read_bytes()
    (folder / "images.bin").write_bytes(struct.pack("<Q", 2**62) + images[8:])
    assert "truncated" in refused(folder)
    # As many points in the first photo.
    end = images.index(b"\0", 8 + 64) + 1
    many = images[:end] + struct.pack("<Q", 2**60) + images[end + 8 :]
    (folder / "images.bin").write_bytes(many)
    assert "truncated" in refused(folder)


@pytest.mark.parametrize("name", [n for n in READABLE if n != "photoreg"])
def test_noise_is_refused_and_never_crashes(tmp_path, photos, name):
    """Bytes of a good file changed at random: cameras, or one sentence."""
    cameras = camera_set(photos)
    path, saved = write(tmp_path, name, cameras)
    kinds = (".bin", ".txt", ".json", ".mlp", ".cam", ".yml", ".out")
    file = next(f for f in saved.files if f.suffix in kinds)
    good = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    rng = np.random.default_rng(3)
    for _ in range(60):
        bad = good.copy()
        where = rng.integers(0, len(bad), rng.integers(1, 4))
        bad[where] = rng.integers(0, 256, len(where))
        file.write_bytes(bad.tobytes())
        try:
            read = read_cameras(path, name, cameras.photos).cameras
        except InputError as error:
            told = str(error)
        else:
            told = "A camera."
            assert all(np.isfinite(camera.K).all() for camera in read.values())
        assert told.endswith("."), told


@pytest.mark.parametrize("line", ["rows: 3", "cols: 3", "cols: 1"])
def test_a_matrix_without_its_size_does_not_reach_opencv(tmp_path, photos, line):
    # cv2.FileNode.mat() corrupts memory on it (seen with OpenCV 5.0).
    path, _ = write(tmp_path, "opencv", camera_set(photos))
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(line, f"x{line}"), encoding="utf-8")
    assert "should be a matrix" in refused(path)
    path.write_text(text.replace(line, line[:-1] + "90000"), encoding="utf-8")
    assert "numbers, but has" in refused(path)


def test_lens_distortion_of_meshlab_and_nerfstudio_is_refused(tmp_path, photos):
    cameras = camera_set(photos)
    path, _ = write(tmp_path, "meshlab", cameras)
    text = path.read_text(encoding="utf-8")
    path.write_text(
        text.replace('LensDistortion="0 0"', 'LensDistortion="0.1 0"'), encoding="utf-8"
    )
    assert "undistort the photos" in refused(path)
    path, _ = write(tmp_path, "nerfstudio", cameras)
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**document, "k1": -0.02}))
    assert "undistort the photos" in refused(path)


def test_a_missing_photo_is_asked_for(tmp_path, photos):
    cameras = camera_set(photos)
    alone = CameraSet(cameras.cameras)
    with pytest.raises(InputError, match="Give the photos too"):
        write(tmp_path, "meshlab", alone)
    for name in ("bundler", "texrecon"):
        path, _ = write(tmp_path, name, alone)
        assert "Give the photos too" in refused(path)
    assert not (tmp_path / "out.mlp").exists()


def test_a_name_that_leads_elsewhere_is_not_written():
    camera = general_cameras()[NAMES[0]]
    for name in ("../a.png", "a\\b.png", "a\nb.png", ""):
        with pytest.raises(InputError, match="not a plain file name"):
            CameraSet({name: camera})
    with pytest.raises(InputError, match="no cameras"):
        CameraSet({})


def test_an_output_whose_format_is_not_told_is_asked_for(tmp_path):
    for path in (tmp_path / "model", tmp_path, tmp_path / "a.cam"):
        with pytest.raises(OutputError, match=r"name it, one of photoreg, colmap"):
            format_to_write(path)
    assert format_to_write(tmp_path / "transforms.json").name == "nerfstudio"
    assert format_to_write(tmp_path / "a.json").name == "photoreg"
    assert format_to_write(tmp_path / "a.YAML").name == "opencv"


def test_photos_of_one_stem_are_refused_for_texrecon(tmp_path):
    camera = general_cameras()[NAMES[0]]
    with pytest.raises(OutputError, match="without suffix"):
        write(tmp_path, "texrecon", CameraSet({"a.png": camera, "a.jpg": camera}))


def test_a_photo_that_exif_turns_is_told_or_written_upright(tmp_path, photos):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0.1, 1], 150.0, 97, 160)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Image.new("RGB", (160, 97), (200, 0, 0)).save(photos / "t.jpg", exif=exif)
    cameras = CameraSet({"t.jpg": camera}, {"t.jpg": photos / "t.jpg"})
    _, saved = write(tmp_path, "colmap", cameras)
    assert "upright copy" in saved.losses[0]
    path, saved = write(tmp_path, "meshlab", cameras)
    assert saved.losses == []
    with Image.open(saved.files[1]) as picture:
        assert picture.size == (97, 160)
    assert read_cameras(path).cameras["t.jpg"].height == 160


def test_a_centred_photo_is_used_as_it_is(tmp_path, photos):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0.1, 1], 150.0, 160, 97)
    cameras = CameraSet({NAMES[0]: camera}, camera_set(photos).photos)
    path, saved = write(tmp_path, "meshlab", cameras)
    assert saved.files == [path]
    assert f'fileName="my photos/{NAMES[0]}"' in path.read_text(encoding="utf-8")
    assert largest_error_px(camera, read_cameras(path).cameras[NAMES[0]]) < 1e-6
