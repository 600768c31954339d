"""Focal lengths by EXIF: right where they can be, doubted or passed over where not."""

from typing import Any

import pytest
from PIL import Image

from photoreg.formats.photos.exif import PhotoFacts, facts_of
from tests.formats.photo_files import details_of

NAMES = {
    "mm": 0x920A,
    "film": 0xA405,
    "zoom": 0xA404,
    "x_res": 0xA20E,
    "unit": 0xA210,
    "w": 0xA002,
    "h": 0xA003,
}


def facts(size: tuple[int, int] = (3600, 2400), **tags: Any) -> PhotoFacts:
    exif = Image.Exif()
    for name, value in tags.items():
        details_of(exif)[NAMES[name]] = value
    return facts_of(exif, b"", *size)


@pytest.mark.parametrize(
    ("tags", "focal_px", "words"),
    [
        ({"film": 50}, 5000, "35 mm equivalent, ± 5 %"),
        # A sensor of 24 mm: 3600 pixels on 24 mm are 3810 an inch.
        ({"mm": 50, "x_res": 3810, "unit": 2}, 7500, "sensor resolution"),
        ({"mm": 50, "x_res": 1500, "unit": 3}, 7500, "sensor resolution"),
        # The equivalent is the lens's own: the sensor tells.
        ({"mm": 50, "film": 50, "x_res": 3810, "unit": 2}, 7500, "sensor"),
        ({"film": 50, "zoom": 2.0}, 5000, "unsure: digital zoom 2×"),
        ({"film": 50, "w": 7200, "h": 4800}, 5000, "resized"),
        ({"film": 50, "mm": 50, "w": 3600, "h": 2400}, 5000, "± 5 %"),
        ({"film": 75, "mm": 30, "x_res": 3810, "unit": 2}, 7500, "unsure: the sensor"),
    ],
)
def test_a_focal_length_says_where_it_is_from(tags, focal_px, words):
    focal = facts(**tags).focal
    assert focal is not None
    assert focal.px == pytest.approx(focal_px, rel=1e-3)
    assert words in focal.note


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {"film": 0},
        {"mm": 0},
        {"mm": 50},
        {"film": 4},
        {"film": 65535},
        {"mm": 50, "x_res": 3810, "unit": 5},
        {"mm": 50, "x_res": 0, "unit": 2},
        {"mm": 50, "x_res": 3810, "unit": 9},
    ],
)
def test_what_cannot_be_is_no_focal_length(tags):
    assert facts(**tags).focal is None


def test_a_cropped_photo_keeps_the_focal_length_and_is_marked():
    found = facts((1200, 1200), film=50, w=3600, h=2400)
    assert found.is_cropped
    assert found.focal is not None
    assert found.focal.px == pytest.approx(5000, rel=1e-3)
    assert "cropped" in found.focal.note
    enlarged = facts((5000, 5000), film=50, w=3600, h=2400)
    assert enlarged.is_cropped
    assert enlarged.focal is None
    assert not facts((2400, 3600), film=50, w=3600, h=2400).is_cropped
