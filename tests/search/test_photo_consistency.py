"""What binds samples and photos: settings, reduction, masks, reference."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.sampling import sample_surface
from photoreg.search.config import ConsistencyConfig
from photoreg.search.photo_consistency import PhotoConsistency, stack_photos
from tests.scenes import small_scene


def test_photos_are_reduced_and_their_cameras_with_them():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 2000, 3)
    blurred = ConsistencyConfig(blur_px=2.0)
    reduced = ConsistencyConfig(max_side_px=160, blur_px=1.0)
    costs = [
        PhotoConsistency(samples, scene.photos, config).cost(scene.rough_cameras)
        for config in (blurred, reduced)
    ]
    # The same blur on the surface: 2 px of 320 are 1 px of 160.
    assert costs[0] == pytest.approx(costs[1], rel=0.05), costs


def test_photos_lie_one_after_the_other_in_single_precision():
    scene = small_scene()
    stack = stack_photos(scene.photos, ConsistencyConfig(max_side_px=100))
    assert stack.pixels.dtype == np.float32
    assert stack.layouts.tolist() == [[0, 100, 75], [7500, 100, 75]]
    assert not stack.has_mask


def test_a_blur_takes_nothing_in_from_outside_the_mask():
    scene = small_scene()
    photo = scene.photos[0]
    mask = np.zeros((photo.height, photo.width), dtype=bool)
    mask[60:180, 80:240] = True
    pixels = np.where(mask[:, :, None], np.uint8(200), np.uint8(3))
    painted = dataclasses.replace(
        photo, pixels=np.repeat(pixels[:, :, :1], 3, axis=2), mask=mask
    )
    config = ConsistencyConfig(colour="rgb", blur_px=4.0)
    stack = stack_photos([painted, painted], config)
    inside = stack.pixels[: mask.size][mask.ravel()]
    worst = np.abs(inside[:, :3] - 200 / 2.55).max()
    assert worst < 1e-3, worst


def test_a_relative_cost_is_that_of_the_reference_at_the_reference():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 500, 3)
    costs = []
    for relative in (False, True):
        config = ConsistencyConfig(relative=relative)
        consistency = PhotoConsistency(samples, scene.photos, config)
        consistency.require(scene.rough_cameras)
        costs.append(consistency.cost(scene.rough_cameras))
    assert costs[0] == pytest.approx(costs[1], rel=1e-9), costs


def test_one_photo_cannot_be_compared():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 50, 3)
    with pytest.raises(InputError, match="compares photos, but there is 1"):
        PhotoConsistency(samples, scene.photos[:1])


def test_mncc_asks_for_its_patches():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 50, 3)
    with pytest.raises(InputError, match="compares patches"):
        PhotoConsistency(samples, scene.photos, ConsistencyConfig(cost="mncc"))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("alpha", 0.5),
        ("min_cosine", 1.0),
        ("min_share", 1.5),
        ("max_side_px", 8),
        ("blur_px", -1.0),
        ("patch_side", 4),
        ("patch_step_px", 0.0),
    ],
)
def test_an_impossible_setting_is_refused_by_name(name, value):
    with pytest.raises(InputError, match=f"^{name} is {value}; give"):
        ConsistencyConfig(**{name: value})
