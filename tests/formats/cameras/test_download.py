"""Cameras as one file to take home, and found again among files and in zips."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from photoreg.errors import InputError
from photoreg.formats.archives import unzipped
from photoreg.formats.cameras.camera_set import largest_shift_px
from photoreg.formats.cameras.download import PLACES, cameras_download
from photoreg.formats.cameras.find import find_cameras
from photoreg.formats.cameras.registry import CAMERA_FORMATS, read_cameras
from photoreg.formats.photos.read import load_photo
from photoreg.imaging.photo import Photo
from tests.formats.camera_files import camera_set, general_cameras

READABLE = [name for name, f in CAMERA_FORMATS.items() if f.load is not None]


def unpack(content: bytes, folder: Path) -> list[str]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
        return sorted(archive.namelist())


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "my photos"
    folder.mkdir()
    cameras = camera_set(folder)
    return cameras, [load_photo(path) for path in cameras.photos.values()]


@pytest.mark.parametrize("name", READABLE)
def test_what_is_downloaded_is_found_and_read_again(tmp_path, scene, name):
    cameras, photos = scene
    made = cameras_download(name, cameras.cameras, photos)
    home = tmp_path / "home"
    home.mkdir()
    if made.name.endswith(".zip"):
        (home / "all.zip").write_bytes(made.content)
        unzipped(home / "all.zip", home, lambda _: True)
        (home / "all.zip").unlink()
        assert len(list(home.rglob("*.jpg"))) == 2, "the photos are there"
    else:
        (home / made.name).write_bytes(made.content)
    read = read_cameras(find_cameras(home)).cameras
    assert set(read) == set(cameras.cameras)
    # Bundler loses principal points, MeshLab a rest of a pixel; both are tested apart.
    allowed = {"bundler": 8.0, "meshlab": 0.05}.get(name, 1e-6)
    for photo, camera in cameras.cameras.items():
        assert largest_shift_px(camera, read[photo]) < allowed


def test_every_format_has_its_place_in_a_download():
    assert list(PLACES) == list(CAMERA_FORMATS)


def test_photos_go_along_only_where_wanted(scene):
    cameras, photos = scene
    made = cameras_download("nerfstudio", cameras.cameras, photos, with_photos=False)
    assert made.name == "transforms.json"
    made = cameras_download("texrecon", cameras.cameras, photos, with_photos=False)
    with zipfile.ZipFile(io.BytesIO(made.content)) as archive:
        assert all(name.endswith(".cam") for name in archive.namelist())


def test_a_photo_that_exif_turns_is_given_upright_or_its_camera_is_turned(tmp_path):
    (name, camera), *_ = general_cameras().items()
    stored = np.random.default_rng(1).integers(
        0, 256, (camera.width, camera.height, 3), dtype=np.uint8
    )
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Image.fromarray(stored).save(tmp_path / name, exif=exif)
    photo = load_photo(tmp_path / name)
    made = cameras_download("colmap", {name: camera}, [photo])
    assert made.losses == []
    assert f"images/{name}" in unpack(made.content, tmp_path / "out")
    with Image.open(tmp_path / "out" / "images" / name) as picture:
        assert picture.getexif().get(ExifTags.Base.Orientation, 1) == 1
        np.testing.assert_array_equal(np.array(picture), np.rot90(stored, -1))
    made = cameras_download("colmap", {name: camera}, [photo], with_photos=False)
    assert made.losses == []
    unpack(made.content, tmp_path / "alone")
    turned = read_cameras(find_cameras(tmp_path / "alone")).cameras[name]
    assert (turned.width, turned.height) == (camera.height, camera.width)


def test_a_photo_that_is_nowhere_a_file_is_written_from_its_pixels(tmp_path):
    camera = next(iter(general_cameras().values()))
    pixels = np.full((camera.height, camera.width, 3), 77, np.uint8)
    renamed = Photo("new name.png", pixels)
    made = cameras_download("meshlab", {renamed.name: camera}, [renamed])
    files = unpack(made.content, tmp_path)
    assert len(files) == 3
    assert renamed.name in files


def test_two_sets_of_cameras_are_told_apart_by_the_user(tmp_path, scene):
    cameras, photos = scene
    for folder in ("0", "1"):
        made = cameras_download("colmap", cameras.cameras, photos, with_photos=False)
        unpack(made.content, tmp_path / "work" / folder)
    with pytest.raises(InputError, match=r"2 sets of cameras: 0/sparse/0, 1/sparse/0"):
        find_cameras(tmp_path / "work")


def test_other_json_beside_a_project_is_not_mistaken_for_cameras(tmp_path, scene):
    cameras, photos = scene
    (tmp_path / "settings.json").write_text('{"frames_a_second": 30}')
    assert find_cameras(tmp_path).name == "settings.json", "the only one: its own error"
    made = cameras_download("opencv", cameras.cameras, photos)
    (tmp_path / made.name).write_bytes(made.content)
    assert find_cameras(tmp_path).name == made.name


def test_a_renamed_photo_of_texrecon_is_found_by_its_name_here(tmp_path, scene):
    cameras, photos = scene
    made = cameras_download("texrecon", cameras.cameras, photos, with_photos=False)
    unpack(made.content, tmp_path / "cams")
    elsewhere = {}
    for i, (name, path) in enumerate(cameras.photos.items()):
        elsewhere[name] = path.rename(tmp_path / f"upload-{i}{path.suffix}")
    read = read_cameras(tmp_path / "cams", photos=elsewhere)
    assert set(read.cameras) == set(cameras.cameras)
