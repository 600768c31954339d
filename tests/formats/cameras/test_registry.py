"""Camera files of every format: out and in, what is lost, and what is told."""

from typing import get_args

import numpy as np
import pytest
from PIL import ExifTags, Image

from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.camera_set import CameraSet, FormatName, largest_shift_px
from photoreg.formats.cameras.registry import (
    CAMERA_FORMATS,
    WRITTEN_FORMATS,
    format_to_write,
    read_cameras,
)
from photoreg.geometry.camera import Camera
from tests.formats.camera_files import (
    NAMES,
    PLACES,
    camera_set,
    general_cameras,
    largest_error_px,
    refused,
    write,
)

READABLE = [name for name, f in WRITTEN_FORMATS.items() if f.load is not None]
EXACT = [name for name in READABLE if name not in ("meshlab", "bundler")]


def test_the_names_of_formats_are_those_of_the_registry():
    assert list(get_args(FormatName)) == list(CAMERA_FORMATS)
    assert list(WRITTEN_FORMATS) == list(PLACES)


# Round trips.


@pytest.mark.parametrize("name", EXACT)
def test_projections_survive_a_round_trip(tmp_path, photo_folder, name):
    cameras = camera_set(photo_folder)
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
def test_skew_is_kept_or_its_loss_is_told(tmp_path, photo_folder, name):
    cameras = camera_set(photo_folder, skew=2.5)
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


# Each format's own words: independent readings of what it defines.


# Projects begun in other programs.


# What is refused, in one sentence.

BAD_TEXT: list[tuple[str, str, str]] = [
    ("transforms.json", '{"frames": [', "is not a JSON file"),
    ("transforms.json", '{"frames": [1]}', "frame 1 should be an object"),
    ("transforms.json", '{"frames": []}', "has no cameras"),
    (
        "transforms.json",
        '{"w": 9, "h": 9, "fl_x": 9, "frames": [{"file_path": "a.jpg", '
        f'"transform_matrix": [[1{"0" * 400}]]}}]}}',
        "not be read as numbers",
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
    ("a.yml", "hello: [", "is not a YAML file: did not find"),
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


@pytest.mark.parametrize(("name", "content", "words"), BAD_TEXT)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path, name, content, words):
    (tmp_path / name).write_text(content, encoding="utf-8")
    assert words in refused(tmp_path / name)


@pytest.mark.parametrize("name", [n for n in READABLE if n != "photoreg"])
def test_noise_is_refused_and_never_crashes(tmp_path, photo_folder, name):
    """Bytes of a good file changed at random: cameras, or one sentence."""
    cameras = camera_set(photo_folder)
    path, saved = write(tmp_path, name, cameras)
    file = next(f for f in saved.files if f.name not in cameras.cameras)
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


def test_a_missing_photo_is_asked_for(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    alone = CameraSet(cameras.cameras)
    with pytest.raises(InputError, match="Give the photos too"):
        write(tmp_path, "meshlab", alone)
    for name in ("bundler", "texrecon", "realityscan"):
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


def test_the_camera_of_a_photo_that_exif_turns_is_turned_or_it_is_written_upright(
    tmp_path, photo_folder
):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0.1, 1], 150.0, 97, 160)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Image.new("RGB", (160, 97), (200, 0, 0)).save(photo_folder / "t.jpg", exif=exif)
    cameras = CameraSet({"t.jpg": camera}, {"t.jpg": photo_folder / "t.jpg"})
    path, saved = write(tmp_path, "colmap", cameras)
    assert saved.losses == []
    stored = read_cameras(path).cameras["t.jpg"]
    assert (stored.width, stored.height) == (160, 97)
    path, saved = write(tmp_path, "meshlab", cameras)
    assert saved.losses == []
    with Image.open(saved.files[1]) as picture:
        assert picture.size == (97, 160)
    assert read_cameras(path).cameras["t.jpg"].height == 160
