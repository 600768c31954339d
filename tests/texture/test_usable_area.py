"""Where photos may be used: the background is told from the object along its outline."""

import numpy as np
import pytest

from photoreg.texture.usable_area import spilt_background

SIDE, RADIUS, FAT = 400, 130.0, 3.0


def scene(inside: int = 90, outside: int = 220, spread: float = 20.0):
    """A rough disc before a smooth background, and the mesh, which is fatter."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:SIDE, :SIDE]
    radius = np.hypot(x - 210.0, y - 190.0)
    pixels = np.full((SIDE, SIDE, 3), float(outside))
    pixels += rng.normal(0.0, 3.0, pixels.shape)
    on_object = radius < RADIUS
    pixels[on_object] = inside + spread * rng.standard_normal((on_object.sum(), 3))
    return np.clip(pixels, 0, 255).astype(np.uint8), radius


def test_background_within_the_mesh_s_outline_is_found():
    pixels, radius = scene()
    spilt = spilt_background(pixels, radius < RADIUS + FAT)
    ring = (radius > RADIUS) & (radius < RADIUS + FAT)
    assert spilt[ring].mean() > 0.99, spilt[ring].mean()
    # On the object itself, and beyond the mesh, nothing is taken for background.
    assert spilt[radius < RADIUS].mean() < 1e-3
    assert not spilt[radius >= RADIUS + FAT].any()


def test_a_photo_of_other_size_is_judged_alike():
    pixels, radius = scene()
    large = pixels.repeat(4, axis=0).repeat(4, axis=1)
    covered = (radius < RADIUS + FAT).repeat(4, axis=0).repeat(4, axis=1)
    ring = (
        ((radius > RADIUS + 1) & (radius < RADIUS + FAT - 1)).repeat(4, 0).repeat(4, 1)
    )
    assert spilt_background(large, covered)[ring].mean() > 0.98


def test_an_object_that_fills_its_outline_is_left_alone():
    pixels, radius = scene()
    assert not spilt_background(pixels, radius < RADIUS - 1.0).any()


def test_a_spot_on_the_object_is_no_background():
    pixels, radius = scene()
    spot = (radius > RADIUS - 4.0) & (radius < RADIUS - 1.5)
    spot &= np.arange(SIDE)[:, None] > 190
    pixels[spot] = 220
    assert not spilt_background(pixels, radius < RADIUS)[spot].any()


@pytest.mark.parametrize("covered", [True, False])
def test_a_photo_all_or_nothing_of_the_object_is_no_trouble(covered):
    pixels, _ = scene()
    assert not spilt_background(pixels, np.full((SIDE, SIDE), covered)).any()


def test_colours_that_are_alike_tell_nothing():
    pixels, radius = scene(inside=205)
    assert not spilt_background(pixels, radius < RADIUS + FAT).any()
