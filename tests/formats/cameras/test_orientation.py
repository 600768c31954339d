"""Cameras of other programs and photos that EXIF turns: a point stays on its picture."""

import dataclasses
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from app.model.camera_moves import first_camera
from app.model.scene_files import with_cameras_of_file
from app.model.state import Document, PhotoEntry
from photoreg.cli.commands import run
from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.cameras_json import CameraFile
from photoreg.formats.cameras.download import cameras_download
from photoreg.formats.cameras.registry import (
    WRITTEN_FORMATS,
    read_cameras,
    write_cameras,
)
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera
from photoreg.imaging.photo import Photo
from tests.formats.camera_files import PLACES

READABLE = [name for name, f in WRITTEN_FORMATS.items() if f.load is not None]
STORED = [name for name in READABLE if WRITTEN_FORMATS[name].is_of_stored_pixels]
RAN = np.random.default_rng(3).uniform(-1, 1, (6, 3)) * [0.5, 0.5, 0.2]
"""Points of the world, each a spot of its own colour in the photo."""

COLOURS = [
    (255, 0, 0),
    (0, 255, 0),
    (0, 0, 255),
    (255, 255, 0),
    (255, 0, 255),
    (0, 255, 255),
]


def stored_camera(width: int = 160, height: int = 120) -> Camera:
    """A camera as another program has it, of the pixels that a file stores.

    Square pixels and the principal point in the middle: all formats can hold it.
    """
    return Camera.look_at(
        [0.3, -0.2, -4.0], [0.05, 0.1, 0], [0.2, -1, 0.1], 210.0, width, height
    )


def spots(camera: Camera) -> np.ndarray:
    """What the camera sees of the points, found by projection alone."""
    pixels = np.zeros((camera.height, camera.width, 3), np.uint8)
    for (x, y), colour in zip(camera.project(RAN), COLOURS, strict=True):
        pixels[round(y) - 3 : round(y) + 4, round(x) - 3 : round(x) + 4] = colour
    return pixels


def write_photo(path: Path, pixels: np.ndarray, orientation: int) -> Path:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(pixels).save(path, exif=exif)
    return path


def lands(camera: Camera, photo: Photo) -> bool:
    """Whether every point projects onto its own spot of the photo as displayed."""
    assert (camera.width, camera.height) == (photo.width, photo.height)
    at = np.rint(camera.project(RAN)).astype(int)
    return all(
        tuple(photo.pixels[y, x]) == colour
        for (x, y), colour in zip(at, COLOURS, strict=True)
    )


@pytest.mark.parametrize("size", [(160, 120), (130, 130)])
@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", STORED)
def test_cameras_of_stored_pixels_are_turned_with_the_photo(
    tmp_path, name, orientation, size
):
    # As the other program does it: an upright file, whose EXIF is then another.
    camera = stored_camera(*size)
    photo = write_photo(tmp_path / "p.png", spots(camera), 1)
    path = tmp_path / PLACES[name]
    write_cameras(path, CameraSet({"p.png": camera}, {"p.png": photo}), name)
    for copy in tmp_path.rglob("p.png"):
        write_photo(copy, spots(camera), orientation)
    if orientation in (2, 4, 5, 7):
        with pytest.raises(InputError, match="mirrored by its EXIF orientation"):
            read_cameras(path, photos=[photo])
        return
    file = read_cameras(path, photos=[photo])
    assert lands(file.cameras["p.png"], load_photo(photo))
    cannot_be_known = orientation == 3 or (orientation != 1 and size[0] == size[1])
    assert len(file.notes) == int(cannot_be_known)
    assert all("EXIF" in note and "p.png" in note for note in file.notes)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", READABLE)
def test_what_is_written_is_read_back_whatever_exif_says(tmp_path, name, orientation):
    shown = stored_camera(*((120, 160) if orientation >= 5 else (160, 120)))
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = {6: 8, 8: 6}.get(orientation, orientation)
    undone = np.asarray(upright(spots(shown), exif))
    photo = write_photo(tmp_path / "p.png", undone, orientation)
    assert lands(shown, load_photo(photo))
    path = tmp_path / PLACES[name]
    cameras = CameraSet({"p.png": shown}, {"p.png": photo})
    saved = write_cameras(path, cameras, name)
    is_told = orientation in (2, 4, 5, 7) and name in STORED and name != "meshlab"
    assert any("mirrors" in loss for loss in saved.losses) == is_told
    if is_told or (orientation in (2, 4) and name == "meshlab"):
        return
    back = read_cameras(path, photos=[photo]).cameras["p.png"]
    assert lands(back, load_photo(photo))


def upright(pixels: np.ndarray, exif: Image.Exif) -> Image.Image:
    from PIL import ImageOps

    picture = Image.fromarray(pixels)
    picture.getexif()[ExifTags.Base.Orientation] = exif[ExifTags.Base.Orientation]
    return ImageOps.exif_transpose(picture)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("name", ["colmap-text", "nerfstudio", "bundler", "texrecon"])
def test_other_programs_are_given_cameras_of_what_the_file_stores(
    tmp_path, name, orientation
):
    """Read without the photo's EXIF, as they do, the points land on stored pixels."""
    stored = stored_camera()
    photo = write_photo(tmp_path / "p.png", spots(stored), orientation)
    path = tmp_path / PLACES[name]
    write_cameras(path, CameraSet({"p.png": stored}), name)
    shown = read_cameras(path, photos=[photo]).cameras["p.png"]
    write_cameras(path, CameraSet({"p.png": shown}, {"p.png": photo}), name)
    for copy in tmp_path.rglob("p.png"):
        write_photo(copy, spots(stored), 1)
    assert lands(read_cameras(path, photos=[photo]).cameras["p.png"], load_photo(photo))


@pytest.mark.parametrize("name", ["colmap-text", "nerfstudio"])
def test_cameras_made_of_upright_copies_are_left_as_they_are(tmp_path, name):
    """The size shows that the program has heeded EXIF, or had an upright copy."""
    stored = stored_camera()
    photo = write_photo(tmp_path / "p.png", spots(stored), 6)
    shown = stored_camera(120, 160)
    path = tmp_path / PLACES[name]
    write_cameras(path, CameraSet({"p.png": shown}), name)
    file = read_cameras(path, photos=[photo])
    np.testing.assert_allclose(file.cameras["p.png"].P, shown.P, atol=1e-9)
    assert file.notes == ()


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_skew_and_two_focal_lengths_are_turned_too(tmp_path, orientation):
    K = np.array([[210.0, 3.0, 85.0], [0.0, 190.0, 52.0], [0.0, 0.0, 1.0]])
    shown = dataclasses.replace(stored_camera(), K=K)
    from photoreg.formats.cameras.orientation import _turned

    there = _turned("p", shown, orientation)
    back = _turned("p", there, {3: 3, 6: 8, 8: 6}[orientation])
    np.testing.assert_allclose(back.project(RAN), shown.project(RAN), atol=1e-9)
    x, y = shown.project(RAN).T
    expected = {3: (159 - x, 119 - y), 6: (119 - y, x), 8: (y, 159 - x)}[orientation]
    np.testing.assert_allclose(there.project(RAN).T, expected, atol=1e-9)


def test_a_download_without_photos_is_for_the_photos_that_people_have(tmp_path):
    stored = stored_camera()
    photo = load_photo(write_photo(tmp_path / "p.png", spots(stored), 6))
    write_cameras(tmp_path / "m", CameraSet({"p.png": stored}), "colmap-text")
    assert photo.source is not None
    shown = read_cameras(tmp_path / "m", photos=[photo.source.path]).cameras
    made = cameras_download("nerfstudio", shown, [photo], with_photos=False)
    assert made.losses == []
    (tmp_path / "m" / made.name).write_bytes(made.content)
    back = read_cameras(tmp_path / "m" / made.name).cameras["p.png"]
    np.testing.assert_allclose(back.project(RAN), stored.project(RAN), atol=1e-6)


def test_the_command_line_and_the_page_say_what_was_assumed(tmp_path, capsys):
    stored = stored_camera()
    photo = write_photo(tmp_path / "p.png", spots(stored), 3)
    write_cameras(tmp_path / "m", CameraSet({"p.png": stored}), "colmap")
    words = ["convert", str(tmp_path / "m"), "--out", str(tmp_path / "a.json")]
    assert run([*words, "--photos", str(photo)]) == 0
    assert "Note: p.png: EXIF turns" in capsys.readouterr().err
    assert run(words) == 0
    assert "Note: The photos were not given" in capsys.readouterr().err


# Names.


def test_names_are_compared_in_one_unicode_form(tmp_path):
    name = "Käse é.png"
    camera = stored_camera()
    decomposed = unicodedata.normalize("NFD", name)
    assert decomposed != name
    photo = write_photo(tmp_path / decomposed, spots(camera), 1)
    write_cameras(tmp_path / "m", CameraSet({name: camera}), "colmap-text")
    text = (tmp_path / "m" / "images.txt").read_text(encoding="utf-8")
    for form in ("NFC", "NFD"):
        (tmp_path / "m" / "images.txt").write_text(
            unicodedata.normalize(form, text), encoding="utf-8"
        )
        file = read_cameras(tmp_path / "m", photos=[photo])
        assert file.of_photos([load_photo(photo)])[0].width == 160


def test_case_is_passed_over_where_that_leaves_no_doubt():
    camera = stored_camera()
    photo = Photo("IMG_1.JPG", spots(camera))
    assert CameraFile({"img_1.jpg": camera}).of_photos([photo]) == [camera]
    both = CameraFile({"img_1.jpg": camera, "Img_1.jpg": camera})
    with pytest.raises(InputError, match=r"no camera for IMG_1\.JPG"):
        both.of_photos([photo])
    entry = PhotoEntry(photo, first_camera(None, photo, (0, -1, 0)))
    found = with_cameras_of_file(
        Document(photos=(entry,)), CameraFile({"img_1.jpg": camera}), "c"
    )
    assert found.photos[0].camera.focal_px == camera.focal_px
