"""Colours of photos come out in sRGB, whatever they are coded in, or are refused."""

import io
import struct
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms
from skimage.color import deltaE_ciede2000, rgb2lab

from photoreg.errors import InputError
from photoreg.formats.photos.read import load_photo
from tests.formats.photo_files import (
    ADOBE_RGB,
    D50,
    D65,
    DISPLAY_P3,
    PROPHOTO,
    REC2020,
    SRGB,
    bradford,
    chrm,
    coded,
    details_of,
    gama,
    icc_profile,
    png_16,
    png_chunk,
    png_with,
    rgb_to_xyz,
    srgb_to_light,
)


def chart() -> np.ndarray:
    """Colours inside sRGB, (h, w, 3) from 0 to 1, all of its cube."""
    steps = np.linspace(0.0, 1.0, 8)
    cube = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    return np.kron(cube.reshape(16, 32, 3), np.ones((2, 2, 1)))


def grey_chart() -> np.ndarray:
    ramp = np.tile(np.linspace(0.0, 1.0, 64), (32, 1))
    return np.repeat(ramp[:, :, None], 3, axis=2)


def eight_bits(values: np.ndarray) -> np.ndarray:
    return np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)


def sixteen_bits(values: np.ndarray) -> np.ndarray:
    return np.rint(65535 * np.clip(values, 0, 1)).astype(np.uint16)


def colour_error(pixels: np.ndarray, srgb: np.ndarray) -> float:
    """Mean CIEDE2000."""
    difference = deltaE_ciede2000(rgb2lab(pixels / 255.0), rgb2lab(srgb))
    return float(np.mean(difference))


def read(path: Path) -> np.ndarray:
    return load_photo(path).pixels


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_photo(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


SPACES = {
    "sRGB": (SRGB, None),
    "Display P3": (DISPLAY_P3, None),
    "Adobe RGB": (ADOBE_RGB, 563 / 256),
    "ProPhoto": (PROPHOTO, 1.8),
    "Rec. 2020": (REC2020, 2.4),
}


@pytest.mark.parametrize("version", [2, 4])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp", ".16.png", ".16.tif"])
@pytest.mark.parametrize("space", SPACES)
def test_a_profile_is_converted_to_srgb(tmp_path, space, suffix, version):
    primaries, gamma = SPACES[space]
    path = tmp_path / f"p{suffix}"
    profile = icc_profile(primaries, gamma, version, space)
    values = coded(chart(), primaries, gamma)
    if suffix == ".16.tif":
        tifffile.imwrite(
            path, sixteen_bits(values), photometric="rgb", iccprofile=profile
        )
    elif suffix == ".16.png":
        content = io.BytesIO()
        Image.new("RGB", (1, 1)).save(content, "PNG", icc_profile=profile)
        at = content.getvalue().index(b"iCCP") - 4
        length = struct.unpack(">I", content.getvalue()[at : at + 4])[0]
        chunk = content.getvalue()[at : at + 12 + length]
        path.write_bytes(png_16(sixteen_bits(values), chunk))
    else:
        is_webp = suffix == ".webp"
        picture = Image.fromarray(eight_bits(values))
        picture.save(path, icc_profile=profile, lossless=is_webp)
    error = colour_error(read(path), chart())
    assert error <= (0.5 if space == "sRGB" else 1.0), error


@pytest.mark.parametrize("suffix", [".jpg", ".heic", ".avif", ".jxl"])
def test_display_p3_is_converted_in_every_lossy_format(tmp_path, suffix):
    import pillow_heif
    import pillow_jxl

    pillow_heif.register_heif_opener()
    assert pillow_jxl
    # Soft colours in larger blocks: the codec is not what is measured.
    soft = np.kron(0.2 + 0.6 * chart()[::4, ::4], np.ones((16, 16, 1)))
    path = tmp_path / f"p{suffix}"
    first = path.with_suffix(".jpg") if suffix == ".jxl" else path
    profile = icc_profile(DISPLAY_P3, None, name="Display P3")
    Image.fromarray(eight_bits(coded(soft, DISPLAY_P3, None))).save(
        first, icc_profile=profile, quality=98, subsampling="4:4:4"
    )
    if suffix == ".jxl":  # Its plugin writes no profile but that of a JPEG.
        Image.open(first).save(path, lossless_jpeg=True)
    error = colour_error(read(path), soft)
    assert error <= 1.0, error


def test_a_profile_of_srgb_leaves_every_bit(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    made = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for profile in (made, icc_profile(SRGB, None, 2), icc_profile(SRGB, None, 4)):
        Image.fromarray(pixels).save(tmp_path / "p.png", icc_profile=profile)
        assert np.array_equal(read(tmp_path / "p.png"), pixels)


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2])
@pytest.mark.parametrize("mode", ["L", "LA"])
def test_a_grey_profile_is_converted(tmp_path, gamma, mode):
    values = eight_bits(coded(grey_chart(), SRGB, gamma)[:, :, 0])
    picture = Image.fromarray(values).convert(mode)
    picture.save(tmp_path / "p.png", icc_profile=icc_profile(None, gamma, 2))
    error = colour_error(read(tmp_path / "p.png"), grey_chart())
    # Eight bits of light itself are coarse in the dark.
    assert error <= (2.0 if gamma == 1.0 else 1.0), error


def test_a_grey_picture_with_a_profile_of_colours_is_converted(tmp_path):
    values = eight_bits(coded(grey_chart(), ADOBE_RGB, 1.8)[:, :, 0])
    profile = icc_profile(ADOBE_RGB, 1.8)
    Image.fromarray(values).save(tmp_path / "p.png", icc_profile=profile)
    assert colour_error(read(tmp_path / "p.png"), grey_chart()) <= 1.0


def cmyk_profile() -> bytes:
    """A CMYK profile of inks that are 1 minus sRGB, and black that dims all.

    One lut16Type table to Lab, of 17 steps a channel.
    """
    n = 17
    steps = np.linspace(0.0, 1.0, n)
    c, m, y, k = np.meshgrid(steps, steps, steps, steps, indexing="ij")
    rgb = np.stack([(1 - ink) * (1 - k) for ink in (c, m, y)], axis=-1)
    xyz = srgb_to_light(rgb.reshape(-1, 3)) @ (bradford(D65, D50) @ rgb_to_xyz(SRGB)).T
    t = xyz / [0.9642, 1.0, 0.8249]
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    lab = np.stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], -1
    )
    coded_lab = np.stack(
        [lab[:, 0] / 100 * 65280, (lab[:, 1] + 128) * 256, (lab[:, 2] + 128) * 256],
        axis=-1,
    )
    ramp = np.array([0, 65535], ">u2").tobytes()
    identity = struct.pack(">9i", *(65536 if i % 4 == 0 else 0 for i in range(9)))
    table = (
        b"mft2\0\0\0\0"
        + bytes([4, 3, n, 0])
        + identity
        + struct.pack(">HH", 2, 2)
        + ramp * 4
        + np.clip(np.rint(coded_lab), 0, 65535).astype(">u2").tobytes()
        + ramp * 3
    )
    base = bytearray(icc_profile(None, 2.2, 2))
    n_tags = int.from_bytes(base[128:132], "big")
    entries = []
    for i in range(n_tags):
        tag, at, size = struct.unpack(">4sII", base[132 + 12 * i : 144 + 12 * i])
        if tag != b"kTRC":
            entries.append((tag, bytes(base[at : at + size])))
    entries.append((b"A2B0", table))
    head = bytearray(base[:128])
    head[12:24] = b"prtrCMYKLab "
    body, index = b"", struct.pack(">I", len(entries))
    for tag, content in entries:
        at = 132 + 12 * len(entries) + len(body)
        index += struct.pack(">4sII", tag, at, len(content))
        body += content + bytes(-len(content) % 4)
    head[:4] = struct.pack(">I", 128 + len(index) + len(body))
    return bytes(head) + index + body


@pytest.mark.parametrize("suffix", [".tif", ".jpg"])
def test_a_cmyk_profile_is_converted(tmp_path, suffix):
    path = tmp_path / f"p{suffix}"
    inks = np.dstack([eight_bits(1.0 - chart()), np.zeros((32, 64), np.uint8)])
    picture = Image.frombytes("CMYK", inks.shape[1::-1], inks.tobytes())
    more = {} if suffix == ".tif" else {"quality": 100, "subsampling": 0}
    picture.save(path, None, icc_profile=cmyk_profile(), **more)
    error = colour_error(read(path), chart())
    assert error <= 1.0, error


def test_a_camera_s_mark_of_adobe_rgb_counts_where_there_is_no_profile(tmp_path):
    exif = Image.Exif()
    details_of(exif)[0xA001] = 65535
    details_of(exif)[0xA005] = {1: "R03\0"}
    soft = np.kron(0.2 + 0.6 * chart()[::4, ::4], np.ones((16, 16, 1)))
    Image.fromarray(eight_bits(coded(soft, ADOBE_RGB, 563 / 256))).save(
        tmp_path / "p.jpg", exif=exif, quality=98, subsampling=0
    )
    error = colour_error(read(tmp_path / "p.jpg"), soft)
    assert error <= 1.0, error


# PNG's own chunks.


@pytest.mark.parametrize(
    ("primaries", "gamma"),
    [(SRGB, 1.8), (ADOBE_RGB, 2.2), (DISPLAY_P3, 2.2), (SRGB, 2.2), (REC2020, 1.5)],
)
@pytest.mark.parametrize("deep", [False, True])
def test_a_png_s_gamma_and_primaries_are_converted(tmp_path, primaries, gamma, deep):
    values = coded(chart(), primaries, gamma)
    chunks = (gama(gamma), chrm(primaries))
    content = (
        png_16(sixteen_bits(values), *chunks)
        if deep
        else png_with(eight_bits(values), *chunks)
    )
    (tmp_path / "p.png").write_bytes(content)
    error = colour_error(read(tmp_path / "p.png"), chart())
    assert error <= 1.0, error


def test_linear_light_of_16_bits_is_converted(tmp_path):
    values = sixteen_bits(coded(chart(), REC2020, 1.0))
    (tmp_path / "p.png").write_bytes(png_16(values, gama(1.0), chrm(REC2020)))
    assert colour_error(read(tmp_path / "p.png"), chart()) <= 1.0


def cicp(*codes: int) -> bytes:
    return png_chunk(b"cICP", bytes(codes))


@pytest.mark.parametrize(
    ("codes", "primaries", "gamma"),
    [((12, 13, 0, 1), DISPLAY_P3, None), ((9, 4, 0, 1), REC2020, 2.2)],
)
def test_a_png_s_cicp_stands_above_all_else(tmp_path, codes, primaries, gamma):
    values = eight_bits(coded(chart(), primaries, gamma))
    srgb = png_chunk(b"sRGB", b"\0")
    (tmp_path / "p.png").write_bytes(png_with(values, cicp(*codes), srgb, gama(1.0)))
    assert colour_error(read(tmp_path / "p.png"), chart()) <= 1.0


def test_a_png_s_srgb_stands_above_its_gamma(tmp_path):
    pixels = eight_bits(chart())
    content = png_with(pixels, png_chunk(b"sRGB", b"\0"), gama(1.0))
    (tmp_path / "p.png").write_bytes(content)
    assert np.array_equal(read(tmp_path / "p.png"), pixels)


@pytest.mark.parametrize(("code", "curve"), [(16, "PQ"), (18, "HLG")])
def test_hdr_curves_are_named_and_refused(tmp_path, code, curve):
    pixels = eight_bits(chart())
    path = tmp_path / "p.png"
    path.write_bytes(png_with(pixels, cicp(9, code, 0, 1)))
    assert f"HDR displays ({curve})" in refused(path)
    for profile in (
        icc_profile(REC2020, 2.4, cicp=(9, code)),
        icc_profile(REC2020, 2.4, name=f"Rec2100 {curve}"),
        icc_profile(REC2020, 2.4, 2, name=f"ITU-R BT.2100 {curve}"),
    ):
        Image.fromarray(pixels).save(path, icc_profile=profile)
        assert f"HDR displays ({curve})" in refused(path)


@pytest.mark.parametrize(("code", "curve"), [(16, "PQ"), (18, "HLG")])
def test_hdr_curves_of_heif_are_named_and_refused(tmp_path, code, curve):
    import pillow_heif

    made = pillow_heif.from_bytes("RGB", (64, 32), eight_bits(chart()).tobytes())
    made.save(
        tmp_path / "p.heic",
        color_primaries=9,
        transfer_characteristics=code,
        matrix_coefficients=9,
        full_range_flag=1,
    )
    assert f"HDR displays ({curve})" in refused(tmp_path / "p.heic")


def test_colours_of_heif_told_by_codes_are_converted(tmp_path):
    import pillow_heif

    soft = np.kron(0.2 + 0.6 * chart()[::4, ::4], np.ones((16, 16, 1)))
    values = eight_bits(coded(soft, DISPLAY_P3, None))
    size = (soft.shape[1], soft.shape[0])
    made = pillow_heif.from_bytes("RGB", size, values.tobytes())
    made.save(
        tmp_path / "p.heic",
        quality=98,
        chroma="444",
        color_primaries=12,
        transfer_characteristics=13,
        matrix_coefficients=6,
        full_range_flag=1,
    )
    assert colour_error(read(tmp_path / "p.heic"), soft) <= 1.0


@pytest.mark.parametrize(
    ("chunks", "words"),
    [
        ((cicp(22, 3, 0, 1),), "does not know"),
        ((cicp(1, 13, 6, 0),), "for video"),
        ((png_chunk(b"gAMA", bytes(4)),), "gamma of 0"),
        ((png_chunk(b"cHRM", bytes(32)),), "cannot be"),
    ],
)
def test_colours_that_cannot_be_are_refused(tmp_path, chunks, words):
    (tmp_path / "p.png").write_bytes(png_with(eight_bits(chart()), *chunks))
    assert words in refused(tmp_path / "p.png")


def test_a_profile_that_is_damaged_or_of_other_pixels_is_refused(tmp_path):
    path = tmp_path / "p.png"
    picture = Image.fromarray(eight_bits(chart()))
    picture.save(path, icc_profile=b"no profile" * 30)
    assert "profile that cannot be read" in refused(path)
    picture.save(path, icc_profile=icc_profile(None, 2.2))
    assert "profile for GRAY pixels, but its pixels are RGB" in refused(path)


# More than 8 bits.


def test_16_bits_are_rounded_and_not_cut(tmp_path):
    values = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    expected = np.rint(values / 257.0).astype(np.uint8)
    colours = np.dstack([values, values[::-1], values.T])
    (tmp_path / "g.png").write_bytes(png_16(values))
    (tmp_path / "c.png").write_bytes(png_16(colours))
    tifffile.imwrite(tmp_path / "g.tif", values, photometric="minisblack")
    tifffile.imwrite(tmp_path / "c.tif", colours, photometric="rgb")
    for suffix in ("png", "tif"):
        assert np.array_equal(read(tmp_path / f"g.{suffix}")[:, :, 1], expected)
        assert np.array_equal(read(tmp_path / f"c.{suffix}")[:, :, 0], expected)


@pytest.mark.parametrize("bits", [10, 12, 14])
@pytest.mark.parametrize("n_channels", [1, 3])
def test_12_bits_in_16_are_scaled_as_the_file_says_or_refused(
    tmp_path, bits, n_channels
):
    values = np.rint((2**bits - 1) * chart()).astype(np.uint16)
    expected = eight_bits(chart())
    if n_channels == 1:
        values, expected = values[:, :, 0], np.repeat(expected[:, :, :1], 3, axis=2)
    told = png_chunk(b"sBIT", bytes([bits] * n_channels))
    (tmp_path / "p.png").write_bytes(png_16(values, told))
    assert np.abs(read(tmp_path / "p.png").astype(int) - expected).max() <= 1
    (tmp_path / "p.png").write_bytes(png_16(values))
    assert f"no value above {2**bits - 1}" in refused(tmp_path / "p.png")
    kind = "rgb" if n_channels == 3 else "minisblack"
    tops = (2**bits - 1,) * n_channels
    for tag, extra in ((281, True), (341, True), (0, False)):
        tags = [(tag, "H", n_channels, tops, False)] if extra else []
        tifffile.imwrite(tmp_path / "p.tif", values, photometric=kind, extratags=tags)
        if extra:
            pixels = read(tmp_path / "p.tif").astype(int)
            assert np.abs(pixels - expected).max() <= 1
        else:
            assert "which value is white" in refused(tmp_path / "p.tif")


def test_bits_that_were_scaled_as_the_standard_wants_are_not_scaled_again(tmp_path):
    values = np.rint(4095 * chart()).astype(np.uint16)
    scaled = (values << 4) | (values >> 8)
    told = png_chunk(b"sBIT", bytes([12, 12, 12]))
    (tmp_path / "p.png").write_bytes(png_16(scaled, told))
    difference = read(tmp_path / "p.png").astype(int) - eight_bits(chart())
    assert np.abs(difference).max() <= 1


def test_a_dark_photo_of_8_bits_written_in_16_is_read(tmp_path):
    dark = eight_bits(0.2 * chart())
    (tmp_path / "p.png").write_bytes(png_16(dark.astype(np.uint16) * 257))
    assert np.array_equal(read(tmp_path / "p.png"), dark)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_16_bits_are_turned_as_8_are(tmp_path, orientation, suffix):
    rng = np.random.default_rng(2)
    values = rng.integers(0, 65536, (20, 30, 3)).astype(np.uint16)
    path = tmp_path / f"p{suffix}"
    if suffix == ".png":
        exif = Image.Exif()
        exif[0x0112] = orientation
        path.write_bytes(
            png_16(values, png_chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0")))
        )
    else:
        tifffile.imwrite(
            path,
            values,
            photometric="rgb",
            metadata=None,
            extratags=[(274, "H", 1, orientation, True)],
        )
    eight = np.rint(values / 257.0).astype(np.uint8)
    turns = {
        1: eight,
        2: eight[:, ::-1],
        3: eight[::-1, ::-1],
        4: eight[::-1],
        5: eight.transpose(1, 0, 2),
        6: np.rot90(eight, -1),
        7: eight[::-1, ::-1].transpose(1, 0, 2),
        8: np.rot90(eight),
    }
    assert np.array_equal(read(path), turns[orientation])
