"""Cameras as one file to take home, and found again among files and in zips."""

import dataclasses
import io
import zipfile
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
from PIL import ExifTags, Image

from photoreg.errors import InputError
from photoreg.formats.archives import unzipped
from photoreg.formats.cameras.camera_set import largest_shift_px
from photoreg.formats.cameras.download import PLACES, cameras_download
from photoreg.formats.cameras.find import find_camera_file
from photoreg.formats.cameras.registry import WRITTEN_FORMATS, read_cameras
from photoreg.formats.meshes.packed import pack
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.lens import Lens
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo
from tests.formats.camera_files import camera_set, general_cameras

READABLE = [name for name, f in WRITTEN_FORMATS.items() if f.load is not None]


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
    read = read_cameras(find_camera_file(home)).cameras
    assert set(read) == set(cameras.cameras)
    # Bundler loses principal points, MeshLab a rest of a pixel; both are tested apart.
    allowed = {"bundler": 8.0, "meshlab": 0.05}.get(name, 1e-6)
    for photo, camera in cameras.cameras.items():
        assert largest_shift_px(camera, read[photo]) < allowed


def test_every_format_has_its_place_in_a_download():
    assert list(PLACES) == list(WRITTEN_FORMATS)


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
    turned = read_cameras(find_camera_file(tmp_path / "alone")).cameras[name]
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
        find_camera_file(tmp_path / "work")


def test_other_json_beside_a_project_is_not_mistaken_for_cameras(tmp_path, scene):
    cameras, photos = scene
    (tmp_path / "settings.json").write_text('{"frames_a_second": 30}')
    assert find_camera_file(tmp_path).name == "settings.json", (
        "the only one: its own error"
    )
    made = cameras_download("opencv", cameras.cameras, photos)
    (tmp_path / made.name).write_bytes(made.content)
    assert find_camera_file(tmp_path).name == made.name


def test_a_renamed_photo_of_texrecon_is_found_by_its_name_here(tmp_path, scene):
    cameras, photos = scene
    made = cameras_download("texrecon", cameras.cameras, photos, with_photos=False)
    unpack(made.content, tmp_path / "cams")
    elsewhere = {}
    for i, (name, path) in enumerate(cameras.photos.items()):
        elsewhere[name] = path.rename(tmp_path / f"upload-{i}{path.suffix}")
    read = read_cameras(tmp_path / "cams", photos=elsewhere)
    assert set(read.cameras) == set(cameras.cameras)


def test_photos_that_few_programs_read_are_given_as_jpeg(tmp_path, scene):
    pillow_heif.register_heif_opener()
    cameras, photos = scene
    heic = tmp_path / "my photos" / "Left.HEIC"
    Image.fromarray(photos[0].pixels).save(heic, quality=90)
    first, camera = load_photo(heic), cameras.cameras[photos[0].name]
    taken = Photo("left.jpg", photos[1].pixels)
    made = cameras_download(
        "nerfstudio",
        {first.name: camera, taken.name: cameras.cameras[photos[1].name]},
        [first, taken],
    )
    names = unpack(made.content, tmp_path / "home")
    assert names == ["Left.HEIC.jpg", "left.jpg", "transforms.json"]
    read = read_cameras(tmp_path / "home" / "transforms.json").cameras
    assert largest_shift_px(camera, read["Left.HEIC.jpg"]) < 1e-6
    given = load_photo(tmp_path / "home" / "Left.HEIC.jpg")
    assert np.abs(given.pixels.astype(int) - first.pixels).mean() < 4.0
    assert made.losses[0].startswith("Left.HEIC is given as Left.HEIC.jpg")


def test_a_mesh_that_came_with_its_files_is_given_with_them(tmp_path, scene):
    cameras, photos = scene
    obj, mtl = tmp_path / "m.obj", tmp_path / "m.mtl"
    obj.write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    mtl.write_text("newmtl a\n")
    pack(obj, [mtl], tmp_path / "m.obj.meshzip")
    mesh = load_mesh(tmp_path / "m.obj.meshzip")
    made = cameras_download("meshlab", cameras.cameras, photos, mesh)
    names = unpack(made.content, tmp_path / "home")
    assert {"m.obj", "m.mtl", "cameras.mlp"} <= set(names)
    assert 'filename="m.obj"' in (tmp_path / "home" / "cameras.mlp").read_text()


@pytest.mark.parametrize("name", ["colmap", "photoreg"])
def test_photos_without_lenses_go_with_pinhole_cameras(tmp_path, scene, name):
    cameras, photos = scene
    first, *others = cameras.cameras
    bent = {**cameras.cameras}
    bent[first] = bent[first].with_lens(Lens(-0.2, 0.03))
    made = cameras_download(name, bent, photos, with_photos=False, undistorted=True)
    home = tmp_path / "home"
    unpack(made.content, home)
    read = read_cameras(find_camera_file(home)).cameras
    new = Path(first).with_suffix(".png").name
    assert set(read) == {new, *others}
    assert all(camera.lens.is_ideal for camera in read.values())
    np.testing.assert_allclose(read[new].P, bent[first].P, atol=1e-6)
    (path,) = home.rglob(new)
    flat, wanted = load_photo(path), undistorted_photo(photos[0], bent[first])
    np.testing.assert_array_equal(flat.pixels, wanted.pixels)
    np.testing.assert_array_equal(
        flat.mask is None or flat.mask, wanted.mask is None or wanted.mask
    )
    # Photos with ideal lenses are the files they were.
    for photo in photos[1:]:
        (path,) = home.rglob(photo.name)
        assert path.read_bytes() == photo.source.path.read_bytes()


def test_two_photos_are_not_made_one_by_undistorting(scene):
    cameras, (photo, *_) = scene
    camera = cameras.cameras[photo.name].with_lens(Lens(k1=-0.1))
    names = ("a.jpg", "a.tif")
    photos = [dataclasses.replace(photo, name=n, source=None) for n in names]
    with pytest.raises(InputError, match=r"Two photos would become a\.png"):
        cameras_download(
            "colmap", dict.fromkeys(names, camera), photos, undistorted=True
        )
