"""Masks as PNG: strokes of the brush against their definition, files, round trips."""

import dataclasses
import itertools

import numpy as np
import pytest
from PIL import Image

from app.engine.warm_up import toy_scene
from app.model.masks import decode_mask, encode_mask, mask_of, masks_stamp, painted_mask
from app.model.state import PhotoEntry
from photoreg.errors import InputError


def distance_to_path(width, height, path):
    """Of each pixel's centre to the nearest place of the path, by definition."""
    y, x = np.mgrid[:height, :width]
    pixels = np.stack([x, y], axis=-1).astype(float)
    best = np.full((height, width), np.inf)
    for a, b in itertools.pairwise(path):
        a, b = np.array(a, float), np.array(b, float)
        along = np.clip((pixels - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0, 1)
        near = a + along[..., None] * (b - a)
        best = np.minimum(best, np.linalg.norm(pixels - near, axis=-1))
    return best


def test_masks_are_told_apart_by_what_they_are_and_by_their_photo():
    left, right = (encode_mask(np.eye(8, dtype=bool)[::way]) for way in (1, -1))
    stamps = [
        masks_stamp(masks)
        for masks in ((left, None), (None, left), (left, right), (right, left))
    ]
    assert len(set(stamps)) == 4
    assert stamps[0] == masks_stamp((left, None))
    assert masks_stamp((None, None)) == masks_stamp(()) == ""


@pytest.mark.parametrize("counts", [False, True])
def test_a_stroke_covers_what_is_nearer_than_the_radius(counts):
    path, radius = [(12.0, 9.5), (40.25, 30.0), (30.0, 52.0)], 6.5
    before = encode_mask(np.zeros((60, 80), bool)) if counts else None
    after = painted_mask(before, 80, 60, path, radius, counts)
    assert after is not None
    touched = decode_mask(after) == counts
    distance = distance_to_path(80, 60, path)
    # OpenCV fills every pixel that the outline touches: up to 0.75 px more.
    assert touched[distance < radius - 0.1].all()
    assert not touched[distance > radius + 1.0].any()


def test_painting_the_same_stroke_back_leaves_no_mask():
    stroke = [(20.0, 20.0), (30.0, 25.0)]
    left_out = painted_mask(None, 80, 60, stroke, 5.0, counts=False)
    assert left_out is not None
    assert painted_mask(left_out, 80, 60, stroke, 5.0, counts=True) is None


def test_a_mask_survives_its_png_and_stays_small():
    rng = np.random.default_rng(5)
    mask = rng.random((61, 83)) > 0.3
    png = encode_mask(mask)
    assert png is not None
    assert np.array_equal(decode_mask(png), mask)
    large = np.ones((2000, 3000), bool)
    large[300:900, 400:1800] = False
    data = encode_mask(large)
    assert data is not None
    assert len(data) < 20_000, f"{len(data)} bytes"


def test_a_mask_file_is_white_where_the_photo_counts(tmp_path):
    mask = np.zeros((60, 80), bool)
    mask[10:30, 20:70] = True
    path = tmp_path / "mask.png"
    Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(path)
    png = mask_of(path.name, path.read_bytes(), 80, 60)
    assert png is not None
    assert np.array_equal(decode_mask(png), mask)
    twice = mask_of(path.name, path.read_bytes(), 160, 120)
    assert twice is not None
    assert np.array_equal(decode_mask(twice)[::2, ::2], mask)


def test_a_transparent_mask_file_counts_by_its_alpha(tmp_path):
    alpha = np.full((60, 80), 255, np.uint8)
    alpha[:, :20] = 0
    rgba = np.dstack([np.zeros((60, 80, 3), np.uint8), alpha])
    path = tmp_path / "cut-out.png"
    Image.fromarray(rgba).save(path)
    png = mask_of(path.name, path.read_bytes(), 80, 60)
    assert png is not None
    assert np.array_equal(decode_mask(png), alpha > 0)


def test_a_mask_file_of_another_shape_or_all_dark_is_refused(tmp_path):
    path = tmp_path / "mask.png"
    Image.fromarray(np.full((60, 60), 255, np.uint8)).save(path)
    with pytest.raises(InputError, match=r"60x60 px.*80x60 px"):
        mask_of(path.name, path.read_bytes(), 80, 60)
    Image.fromarray(np.zeros((60, 80), np.uint8)).save(path)
    with pytest.raises(InputError, match="dark all over"):
        mask_of(path.name, path.read_bytes(), 80, 60)


def test_a_photo_s_own_mask_moves_into_its_entry_and_back():
    _, photos, cameras = toy_scene()
    mask = np.ones(photos[0].pixels.shape[:2], bool)
    mask[:40] = False
    photo = dataclasses.replace(photos[0], mask=mask)
    entry = PhotoEntry(photo, cameras[0])
    assert entry.photo.mask is None
    assert entry.photo.pixels is photo.pixels
    restored = entry.masked_photo.mask
    assert restored is not None
    assert np.array_equal(restored, mask)
    again = dataclasses.replace(entry, camera=cameras[1])
    assert again.photo is entry.photo
    assert again.mask_png == entry.mask_png
