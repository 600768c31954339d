"""The object in a photo, told from a plain background, by a mask, by a box."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo
from photoreg.placing.segmentation import segment
from tests.scenes import small_scene


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize(
    ("kind", "background"), [("clean", "dark"), ("hard", "dark"), ("mid", "plain")]
)
def test_an_object_before_a_plain_background_is_told_from_it(kind, background):
    scene = small_scene(seed=2, kind=kind, background=background)
    true = render_geometry(scene.true_mesh, scene.cameras[0]).covered
    found = segment(scene.photos[0])
    assert found is not None
    assert found.how == "plain"
    assert not found.touches_frame
    assert overlap(found.covered, true) > 0.97, overlap(found.covered, true)


def test_a_mask_is_taken_as_it_is_and_a_box_bounds_the_object():
    scene = small_scene(kind="clutter", seed=1)
    true = render_geometry(scene.true_mesh, scene.cameras[0]).covered
    photo = scene.photos[0]
    masked = segment(dataclasses.replace(photo, mask=true))
    assert masked is not None
    assert masked.how == "mask"
    assert overlap(masked.covered, true) > 0.99
    rows, columns = np.nonzero(true)
    box = (
        columns.min() - 4.0,
        rows.min() - 4.0,
        np.ptp(columns) + 9.0,
        np.ptp(rows) + 9.0,
    )
    boxed = segment(photo, box)
    assert boxed is not None
    assert boxed.how == "box"
    assert overlap(boxed.covered, true) > 0.85, overlap(boxed.covered, true)
    unaided = segment(photo)
    assert unaided is None or unaided.is_weak


def test_what_goes_on_beyond_the_photo_is_noticed_and_nothing_is_found_in_nothing():
    scene = small_scene()
    photo = scene.photos[0]
    cut = np.ascontiguousarray(photo.pixels[:, : photo.width // 2])
    found = segment(Photo("cut.png", cut))
    assert found is not None
    assert found.touches_frame
    assert segment(Photo("grey.png", np.full((120, 160, 3), 90, np.uint8))) is None


@pytest.mark.parametrize(
    "box", [(0.0, 0.0, 0.0, 10.0), (400.0, 0.0, 10.0, 10.0), (np.nan, 0.0, 9.0, 9.0)]
)
def test_a_box_that_is_none_is_refused(box):
    with pytest.raises(InputError, match="does not lie in the photo"):
        segment(small_scene().photos[0], box)


def test_the_same_photo_is_cut_the_same_twice():
    photo = small_scene(kind="clutter", seed=1).photos[0]
    first, second = segment(photo), segment(photo)
    assert (first is None) == (second is None)
    if first is not None and second is not None:
        np.testing.assert_array_equal(first.covered, second.covered)
