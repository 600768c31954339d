"""Photos of every format: as displayed, the photo and not its preview, or refused."""

import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from photoreg.errors import InputError
from photoreg.formats.photos.decoding import read_header
from photoreg.formats.photos.read import load_photo
from photoreg.formats.photos.registry import PHOTO_FORMATS, PHOTO_SUFFIXES
from photoreg.limits import Limits
from tests.formats.photo_files import details_of, write_dng

PILLOW_NAMES = {
    ".jpg": "JPEG",
    ".png": "PNG",
    ".tif": "TIFF",
    ".webp": "WEBP",
    ".heic": "HEIF",
    ".avif": "AVIF",
    ".jxl": "JXL",
}


def blocks(width: int = 96, height: int = 64) -> np.ndarray:
    """Colours in blocks of 16 pixels: nothing symmetric, and codecs keep it."""
    small = np.random.default_rng(4).integers(30, 226, (height // 16, width // 16, 3))
    return np.kron(small, np.ones((16, 16, 1))).astype(np.uint8)


def save(path: Path, pixels: np.ndarray, orientation: int = 1, **more: Any) -> Path:
    import pillow_heif
    import pillow_jxl

    pillow_heif.register_heif_opener()
    assert pillow_jxl
    exif = Image.Exif()
    exif[0x0112] = orientation
    quality = {} if path.suffix in (".png", ".tif") else {"quality": 95}
    Image.fromarray(pixels).save(
        path, PILLOW_NAMES[path.suffix], exif=exif.tobytes(), **quality, **more
    )
    return path


def displayed(pixels: np.ndarray, orientation: int) -> np.ndarray:
    exif = Image.Exif()
    exif[0x0112] = orientation
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG", exif=exif)
    return np.asarray(ImageOps.exif_transpose(Image.open(file)))


def differs(a: np.ndarray, b: np.ndarray) -> float:
    assert a.shape == b.shape
    # Inside the blocks: codecs blur their edges.
    inside = np.s_[4::16, 4::16]
    return float(np.abs(a[inside].astype(int) - b[inside]).max())


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_photo(path)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    assert len(message) < 400
    return message


# Formats.


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", PILLOW_NAMES)
def test_every_format_is_read_as_displayed(tmp_path, suffix, orientation):
    path = save(tmp_path / f"p{suffix}", blocks(), orientation)
    photo = load_photo(path)
    assert differs(photo.pixels, displayed(blocks(), orientation)) <= 12
    assert read_header(path).displayed_size == (photo.width, photo.height)
    assert photo.pixels.flags.c_contiguous


@pytest.mark.parametrize("orientation", [2, 3, 6])
def test_a_jpeg_packed_as_jpeg_xl_is_turned_once(tmp_path, orientation):
    first = save(tmp_path / "p.jpg", blocks(), orientation)
    Image.open(first).save(tmp_path / "p.jxl", lossless_jpeg=True)
    photo = load_photo(tmp_path / "p.jxl")
    assert differs(photo.pixels, displayed(blocks(), orientation)) <= 12
    size = read_header(tmp_path / "p.jxl").displayed_size
    assert size == (photo.width, photo.height)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_raw_is_developed_as_displayed_and_its_preview_is_not_taken(
    tmp_path, orientation
):
    path = tmp_path / "p.dng"
    write_dng(path, blocks() / 255.0, orientation)
    photo = load_photo(path)
    assert differs(photo.pixels, displayed(blocks(), orientation)) <= 2
    assert read_header(path).displayed_size == (photo.width, photo.height)
    assert read_header(path).orientation == 1


def test_raw_keeps_its_exposure(tmp_path):
    """A darker photo stays darker by what the shutter took, whatever is in it."""
    write_dng(tmp_path / "p.dng", np.full((64, 64, 3), 0.8), exposure=0.25)
    photo = load_photo(tmp_path / "p.dng")
    light = ((0.8 + 0.055) / 1.055) ** 2.4 / 4
    expected = 255 * (1.055 * light ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(photo.pixels, expected, atol=1.5)


def test_raw_by_the_name_of_a_tiff_is_read_as_raw(tmp_path):
    write_dng(tmp_path / "p.dng", blocks() / 255.0)
    (tmp_path / "p.dng").rename(tmp_path / "p.tif")
    assert differs(load_photo(tmp_path / "p.tif").pixels, blocks()) <= 2


@pytest.mark.parametrize(
    ("suffix", "by_name_of"),
    [(".heic", "p.jpg"), (".webp", "p.png"), (".png", "p.dng")],
)
def test_the_first_bytes_tell_the_format_and_not_the_name(tmp_path, suffix, by_name_of):
    path = save(tmp_path / f"p{suffix}", blocks()).rename(tmp_path / by_name_of)
    assert differs(load_photo(path).pixels, blocks()) <= 12


def test_heic_of_ten_bits_is_read(tmp_path):
    import pillow_heif

    deep = (blocks().astype(np.uint16) * 257).tobytes()
    pillow_heif.encode("RGB;16", (96, 64), deep, str(tmp_path / "p.heic"), quality=95)
    assert differs(load_photo(tmp_path / "p.heic").pixels, blocks()) <= 12


def test_the_picture_marked_as_the_main_one_of_a_heic_is_taken(tmp_path):
    import pillow_heif

    container = pillow_heif.from_bytes("RGB", (96, 64), blocks()[::-1].tobytes())
    container.add_frombytes("RGB", (96, 64), blocks().tobytes())
    container.save(tmp_path / "p.heic", quality=95, primary_index=1)
    assert differs(load_photo(tmp_path / "p.heic").pixels, blocks()) <= 12


def test_alpha_of_a_webp_becomes_the_mask(tmp_path):
    alpha = np.full((64, 96), 255, np.uint8)
    alpha[:, :40] = 0
    Image.fromarray(np.dstack([blocks(), alpha])).save(
        tmp_path / "p.webp", lossless=True
    )
    mask = load_photo(tmp_path / "p.webp").mask
    assert mask is not None
    assert np.array_equal(mask, alpha > 0)


@pytest.mark.parametrize("suffix", [".jpg", ".webp", ".heic", ".avif", ".jxl"])
def test_what_is_above_the_limit_is_refused_before_it_is_decoded(tmp_path, suffix):
    path = save(tmp_path / f"p{suffix}", np.zeros((400, 300, 3), np.uint8))
    with pytest.raises(InputError, match=r"300x400 pixels; the limit is 0\.1 megapix"):
        load_photo(path, Limits(photo_megapixels=0.1))


def test_raw_above_the_limit_is_refused(tmp_path):
    write_dng(tmp_path / "p.dng", np.zeros((400, 300, 3)))
    with pytest.raises(InputError, match="300x400 pixels; the limit"):
        load_photo(tmp_path / "p.dng", Limits(photo_megapixels=0.1))


@pytest.mark.parametrize("suffix", [*PILLOW_NAMES, ".dng"])
def test_a_cut_file_is_one_sentence(tmp_path, suffix):
    path = tmp_path / f"p{suffix}"
    noise = np.random.default_rng(0).integers(0, 256, (200, 300, 3), dtype=np.uint8)
    if suffix == ".dng":
        write_dng(path, noise / 255.0)
    else:
        save(path, noise)
    whole = path.read_bytes()
    for share in (0.02, 0.5):
        path.write_bytes(whole[: int(share * len(whole))])
        assert "could not be" in refused(path)


def test_jpeg_xl_without_its_package_says_how_to_get_it(tmp_path, monkeypatch):
    path = save(tmp_path / "p.jxl", blocks())
    monkeypatch.setitem(sys.modules, "pillow_jxl", None)
    assert "pip install pillow-jxl-plugin" in refused(path)


def test_decoders_are_imported_only_when_a_file_needs_them():
    code = (
        "import sys, photoreg, photoreg.cli.commands; "
        "print([m for m in ('rawpy', 'pillow_heif', 'pillow_jxl') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


# Which picture.


def pages(path: Path, *pictures: tuple[np.ndarray, int | None]) -> Path:
    with tifffile.TiffWriter(path) as file:
        for pixels, kind in pictures:
            file.write(pixels, photometric="rgb", subfiletype=kind or 0, metadata=None)
    return path


def test_of_a_tiff_with_a_thumbnail_first_the_photo_is_taken(tmp_path):
    path = pages(tmp_path / "p.tif", (blocks()[::4, ::4], 1), (blocks(), None))
    assert np.array_equal(load_photo(path).pixels, blocks())
    deep = blocks().astype(np.uint16) * 257
    path = pages(tmp_path / "p.tif", (deep[::4, ::4], 1), (deep, None))
    assert np.array_equal(load_photo(path).pixels, blocks())


def test_of_a_tiff_with_reduced_pages_the_photo_is_taken(tmp_path):
    small = [(blocks()[::n, ::n], None) for n in (2, 4)]
    path = pages(tmp_path / "p.tif", (blocks(), None), *small)
    assert np.array_equal(load_photo(path).pixels, blocks())


def test_a_tiff_of_several_photos_or_of_a_preview_is_refused(tmp_path):
    path = pages(tmp_path / "p.tif", (blocks(), None), (blocks()[::-1], None))
    assert "2 pages that may be the photo" in refused(path)
    assert "only a preview" in refused(pages(tmp_path / "p.tif", (blocks(), 1)))


def test_the_first_picture_of_an_mpo_is_the_photo(tmp_path):
    path = tmp_path / "p.jpg"
    Image.fromarray(blocks()).save(
        path,
        "MPO",
        save_all=True,
        quality=95,
        append_images=[Image.fromarray(blocks()[::-1])],
    )
    assert differs(load_photo(path).pixels, blocks()) <= 12


@pytest.mark.parametrize("suffix", [".png", ".webp", ".avif"])
def test_an_animation_is_refused(tmp_path, suffix):
    path = save(
        tmp_path / f"p{suffix}",
        blocks(),
        save_all=True,
        append_images=[Image.fromarray(blocks()[::-1])],
    )
    assert "is an animation of 2 pictures" in refused(path)


XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/'
    '02/22-rdf-syntax-ns#"><rdf:Description {}</rdf:RDF></x:xmpmeta>'
)


@pytest.mark.parametrize(
    ("mark", "words"),
    [
        ('GPano:ProjectionType="equirectangular"/>', "a panorama (equirectangular)"),
        (
            "><GPano:ProjectionType>cylindrical</GPano:ProjectionType>"
            "</rdf:Description>",
            "a panorama (cylindrical)",
        ),
        ('GPano:FullPanoWidthPixels="4000"/>', "a panorama"),
        ('GPano:ProjectionType="fisheye"/>', "a fisheye"),
        ('Camera:ModelType="fisheye"/>', "a fisheye"),
        ('Camera:ModelType="perspective"/>', ""),
    ],
)
@pytest.mark.parametrize("suffix", [".jpg", ".webp", ".heic", ".avif"])
def test_what_is_marked_as_no_pinhole_photo_is_refused(tmp_path, suffix, mark, words):
    path = save(tmp_path / f"p{suffix}", blocks(), xmp=XMP.format(mark).encode())
    if words:
        assert words in refused(path)
    else:
        load_photo(path)


def test_a_fisheye_lens_and_a_phone_s_panorama_are_refused(tmp_path):
    exif = Image.Exif()
    details_of(exif)[0xA434] = "EF8-15mm f/4L FISHEYE USM"
    Image.fromarray(blocks()).save(tmp_path / "p.jpg", exif=exif)
    assert "a fisheye (EF8-15mm" in refused(tmp_path / "p.jpg")
    exif = Image.Exif()
    details_of(exif)[0xA401] = 6
    Image.fromarray(blocks()).save(tmp_path / "p.jpg", exif=exif)
    assert "a panorama" in refused(tmp_path / "p.jpg")


# The registry.


def test_the_page_and_the_command_line_take_what_is_in_the_registry():
    from app.engine.file_kinds import KINDS, PHOTO
    from photoreg.cli.commands import commands

    assert KINDS[PHOTO] == PHOTO_SUFFIXES
    said = " ".join(str(c.__doc__) for c in commands([]).values())
    for known in PHOTO_FORMATS:
        assert known.name in said


def test_every_suffix_is_of_one_format():
    assert len(set(PHOTO_SUFFIXES)) == len(PHOTO_SUFFIXES)
    assert all(suffix == suffix.lower() for suffix in PHOTO_SUFFIXES)
