import numpy as np
import pytest
from PIL import Image

from photoreg.errors import InputError
from photoreg.formats.photos.read import load_photo
from photoreg.imaging.photo import Photo
from tests.formats.photo_files import details_of


def gradient(width=48, height=32) -> np.ndarray:
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return np.dstack([x * 5, y * 7, (x + y) * 3]).astype(np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_lossless_pixels_survive(tmp_path, suffix):
    path = tmp_path / f"photo{suffix}"
    Image.fromarray(gradient()).save(path)
    photo = load_photo(path)
    assert np.array_equal(photo.pixels, gradient())
    assert (photo.name, photo.width, photo.height) == (path.name, 48, 32)
    assert photo.mask is None


@pytest.mark.parametrize(("orientation", "turns"), [(3, 2), (6, 3), (8, 1)])
def test_exif_orientation_is_applied(tmp_path, orientation, turns):
    path = tmp_path / "turned.png"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(gradient()).save(path, exif=exif)
    assert np.array_equal(load_photo(path).pixels, np.rot90(gradient(), turns))


def test_focal_length_comes_from_the_35_mm_equivalent(tmp_path):
    path = tmp_path / "lens.jpg"
    exif = Image.Exif()
    details_of(exif)[0xA405] = 50
    Image.fromarray(gradient(360, 240)).save(path, exif=exif)
    # 3:2 like the film: 36 mm are 360 px, so 50 mm are 500 px.
    assert load_photo(path).exif_focal_px == pytest.approx(500.0)


def test_alpha_becomes_the_mask(tmp_path):
    path = tmp_path / "cut-out.png"
    alpha = np.full((32, 48), 255, np.uint8)
    alpha[:, :10] = 0
    Image.fromarray(np.dstack([gradient(), alpha])).save(path)
    photo = load_photo(path)
    assert photo.mask is not None
    assert np.array_equal(photo.mask, alpha > 0)


@pytest.mark.parametrize("mode", ["L", "CMYK", "LA", "I;16"])
def test_other_colour_modes_become_srgb(tmp_path, mode):
    path = tmp_path / "mode.tiff"
    grey = np.repeat(gradient()[:, :, :1], 3, axis=2)
    if mode == "I;16":
        Image.fromarray(grey[:, :, 0].astype(np.uint16) * 257).save(path)
    else:
        Image.fromarray(grey).convert(mode).save(path)
    pixels = load_photo(path).pixels
    assert pixels.shape == (32, 48, 3)
    assert np.abs(pixels.astype(int) - grey).max() <= 2


def test_a_palette_and_black_and_white_become_srgb(tmp_path):
    blocks = np.kron([[0, 1], [1, 0]], np.ones((16, 24))) > 0
    picture = Image.fromarray(blocks)
    picture.save(tmp_path / "bits.png")
    picture.convert("P").save(tmp_path / "palette.png")
    expected = np.repeat(np.where(blocks, 255, 0)[:, :, None], 3, axis=2)
    assert np.array_equal(load_photo(tmp_path / "bits.png").pixels, expected)
    assert np.array_equal(load_photo(tmp_path / "palette.png").pixels, expected)


def test_resized_keeps_shape_mask_and_focal_length():
    mask = np.zeros((32, 48), bool)
    mask[:, 24:] = True
    photo = Photo("a.png", gradient(), mask, exif_focal_px=60.0).resized(24)
    assert photo.pixels.shape == (16, 24, 3)
    assert photo.exif_focal_px == pytest.approx(30.0)
    assert photo.mask is not None
    assert photo.mask[:, 12:].all()
    assert not photo.mask[:, :12].any()


def test_a_text_file_named_jpg_is_refused(tmp_path):
    path = tmp_path / "notes.jpg"
    path.write_text("not a picture")
    with pytest.raises(InputError, match=r"notes\.jpg could not be read"):
        load_photo(path)


def test_a_truncated_photo_is_refused(tmp_path):
    path = tmp_path / "cut.jpg"
    Image.fromarray(np.kron(gradient(), np.ones((8, 8, 1), np.uint8))).save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match="complete"):
        load_photo(path)


def test_a_photo_of_one_pixel_is_refused(tmp_path):
    path = tmp_path / "dot.png"
    Image.fromarray(gradient()[:1, :1]).save(path)
    with pytest.raises(InputError, match="1x1 px"):
        load_photo(path)
