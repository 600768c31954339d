"""Colour spaces against OpenCV and scikit-image, and their properties."""

import cv2
import numpy as np
import pytest
from skimage.color.colorconv import rgb2lab, rgb2luv, rgb2xyz

from photoreg.errors import InputError
from photoreg.imaging.colour import convert


@pytest.fixture(scope="module")
def pixels() -> np.ndarray:
    # A grid over the whole cube, corners and greys included; 100 rows: more than one
    # strip of the conversion.
    levels = np.linspace(0, 255, 20).round().astype(np.uint8)
    cube = np.stack(np.meshgrid(levels, levels, levels), axis=-1)
    return cube.reshape(100, 80, 3)


@pytest.mark.parametrize(
    ("space", "code"), [("luv", cv2.COLOR_RGB2LUV), ("lab", cv2.COLOR_RGB2LAB)]
)
def test_luv_and_lab_agree_with_opencv(pixels, space, code):
    expected = cv2.cvtColor(pixels.astype(np.float32) / 255, code)
    worst = np.abs(convert(pixels, space) - expected).max()
    # OpenCV interpolates tables of the cube root and of sRGB; at dark blues, where
    # the exact spaces below agree, it is up to 0.39 off.
    assert worst < 0.5, worst


@pytest.mark.parametrize(
    ("space", "reference", "scale"),
    [
        ("luv", rgb2luv, 1.0),
        ("lab", rgb2lab, 1.0),
        ("xyz", rgb2xyz, 100.0),
    ],
)
def test_cie_spaces_agree_with_scikit_image(pixels, space, reference, scale):
    worst = np.abs(convert(pixels, space) - scale * reference(pixels)).max()
    # Their white and ours (the sum of the primaries) differ in the fourth digit.
    assert worst < 0.05, worst


@pytest.mark.parametrize("space", ["luv", "lab", "hsi"])
def test_greys_have_no_chroma(space):
    greys = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    chroma = np.abs(convert(greys, space)[..., 1:]).max()
    assert chroma < 1e-3, chroma


@pytest.mark.parametrize("space", ["rgb", "luv", "lab"])
def test_white_has_the_full_scale(space):
    white = np.full((1, 1, 3), 255, dtype=np.uint8)
    assert convert(white, space)[0, 0, 0] == pytest.approx(100.0, abs=1e-3)


def test_black_is_zero_in_every_space():
    black = np.zeros((1, 1, 3), dtype=np.uint8)
    for space in ("rgb", "xyz", "luv", "lab", "hsi"):
        assert np.abs(convert(black, space)).max() < 1e-5, space


def test_hsi_follows_the_textbook_formula(pixels):
    rgb = pixels.reshape(-1, 3) / 255.0
    R, G, B = rgb.T
    coloured = (rgb.max(axis=1) > rgb.min(axis=1)) & (rgb.min(axis=1) > 0)
    R, G, B = R[coloured], G[coloured], B[coloured]
    theta = np.arccos(
        np.clip(
            0.5 * (2 * R - G - B) / np.sqrt((R - G) ** 2 + (R - B) * (G - B)), -1, 1
        )
    )
    hue = np.where(B <= G, theta, 2 * np.pi - theta)
    saturation = 1 - 3 * np.minimum(np.minimum(R, G), B) / (R + G + B)
    expected = 100 * np.column_stack(
        [(R + G + B) / 3, saturation * np.cos(hue), saturation * np.sin(hue)]
    )
    worst = np.abs(convert(pixels, "hsi").reshape(-1, 3)[coloured] - expected).max()
    assert worst < 1e-3, worst


def test_hue_has_no_seam_at_red():
    either_side = np.array([[[200, 40, 41], [200, 41, 40]]], dtype=np.uint8)
    first, second = convert(either_side, "hsi")[0]
    apart = float(np.linalg.norm(first - second))
    assert apart < 1.5, apart


@pytest.mark.wrong_types
def test_an_unknown_space_is_refused_by_name(pixels):
    with pytest.raises(InputError, match="'cmyk' is not a colour space; choose rgb"):
        convert(pixels, "cmyk")  # pyright: ignore[reportArgumentType]
