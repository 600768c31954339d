"""Lenses by lensfun's database: the terms bend as lensfun itself does."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from photoreg.formats.photos.lens_database import WORST_FIT, known_lens
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera, centred_intrinsics

pytestmark = pytest.mark.slow

NIKON = ("NIKON CORPORATION", "NIKON D850", "AF-S NIKKOR 24-120mm f/4G ED VR")
FOCAL_MM, WIDTH, HEIGHT = 24.0, 600, 400
FOCAL_PX = FOCAL_MM / 36.0 * WIDTH


def test_the_terms_bend_as_lensfun_does() -> None:
    found = known_lens(*NIKON, FOCAL_MM, FOCAL_PX, (WIDTH, HEIGHT))
    assert found is not None
    assert "24-120mm f/4G" in found.name
    lensfunpy = importlib.import_module("lensfunpy")
    database = lensfunpy.Database()
    camera = database.find_cameras(*NIKON[:2])[0]
    lens = database.find_lenses(camera, None, NIKON[2])[0]
    modifier = lensfunpy.Modifier(lens, camera.crop_factor, WIDTH, HEIGHT)
    modifier.initialize(
        FOCAL_MM, 4.0, scale=1.0, flags=lensfunpy.ModifyFlags.DISTORTION
    )
    by_lensfun = modifier.apply_geometry_distortion().reshape(-1, 2)
    K = centred_intrinsics(FOCAL_PX, WIDTH, HEIGHT)
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    ideal = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    rays = ideal @ np.linalg.inv(K).T
    ours = Camera(K, np.eye(3), np.zeros(3), WIDTH, HEIGHT, lens=found.lens).project(
        rays
    )
    centre = K[:2, 2]
    # lensfun's models also enlarge the middle, which is a matter of the focal length.
    scale = np.linalg.norm(by_lensfun - centre) / np.linalg.norm(ours - centre)
    off = np.linalg.norm(centre + scale * (ours - centre) - by_lensfun, axis=1)
    undone = np.linalg.norm(ideal[:, :2] - by_lensfun, axis=1).max()
    assert off.max() < 2.0 * WORST_FIT * WIDTH
    assert undone > 5.0 * off.max(), "the lens does bend"


@pytest.mark.parametrize(
    ("make", "model", "lens"),
    [
        ("Nobody", "Nothing", "No lens"),
        (*NIKON[:2], ""),
        (*NIKON[:2], "A lens that does not exist 17 mm"),
        ("Canon", "Canon EOS 5D Mark II", "EF8-15mm f/4L FISHEYE USM"),
        ("", "", ""),
        ("Nikon\0", "%s%n <b>", "\\x00" * 4_000),
    ],
)
def test_a_lens_that_is_not_known_is_none(make: str, model: str, lens: str) -> None:
    assert known_lens(make, model, lens, 15.0, FOCAL_PX, (WIDTH, HEIGHT)) is None


@pytest.mark.parametrize("is_cropped", [False, True])
def test_a_photo_is_read_with_its_lens_unless_it_is_cropped(
    tmp_path: Path, is_cropped: bool
) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = NIKON[:2]
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.LensModel] = NIKON[2]
    details[ExifTags.Base.FocalLength] = FOCAL_MM
    details[ExifTags.Base.FocalLengthIn35mmFilm] = int(FOCAL_MM)
    details[ExifTags.Base.ExifImageWidth] = WIDTH * (2 if is_cropped else 1)
    details[ExifTags.Base.ExifImageHeight] = HEIGHT
    Image.new("RGB", (WIDTH, HEIGHT), "gray").save(tmp_path / "a.jpg", exif=exif)
    photo = load_photo(tmp_path / "a.jpg")
    assert photo.is_cropped == is_cropped
    if is_cropped:
        assert photo.known_lens is None
    else:
        assert photo.known_lens is not None
        assert photo.known_lens.lens.k1 < -0.05
        assert "24-120mm" in photo.known_lens.name
