"""A photo reduced: once, the same for everybody, and never in a process's luggage."""

import pickle

import cv2
import numpy as np

from photoreg.imaging.photo import MAX_KEPT, MAX_KEPT_PIXELS, Photo


def made(width: int = 150, height: int = 101) -> Photo:
    rng = np.random.default_rng(3)
    pixels = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
    return Photo("noise.png", pixels)


def test_a_reduction_is_the_mean_by_area_and_made_once():
    photo = made()
    small = photo.pixels_at((50, 34))
    expected = cv2.resize(photo.pixels, (50, 34), interpolation=cv2.INTER_AREA)
    assert np.array_equal(small, expected)
    assert photo.pixels_at((50, 34)) is small
    assert photo.resized(50).pixels is small
    assert photo.pixels_at((150, 101)) is photo.pixels


def test_few_reductions_are_kept_none_large_and_none_goes_to_another_process():
    photo = made(1500, 1100)
    assert photo.pixels_at((1400, 1000)) is not photo.pixels_at((1400, 1000))
    assert MAX_KEPT_PIXELS < 1400 * 1000
    first = photo.pixels_at((30, 22))
    for side in range(40, 40 + MAX_KEPT):
        photo.pixels_at((side, side))
    assert photo.pixels_at((30, 22)) is not first, "the oldest made room"
    assert len(pickle.dumps(photo)) < photo.pixels.nbytes + 1000
    assert np.array_equal(pickle.loads(pickle.dumps(photo)).pixels, photo.pixels)
