"""What stands before the object in one photo is not painted on it."""

import dataclasses

import numpy as np
import pytest

from photoreg.geometry.camera import Camera
from photoreg.texture.atlas import make_atlas
from photoreg.texture.bake import bake_texture
from photoreg.texture.config import TextureConfig
from photoreg.texture.strangers import find_strangers
from tests.scenes import small_scene

CAMERA = Camera.look_at(
    np.array([0.2, -5.0, 0.1]), np.zeros(3), np.array([0.0, 0.0, 1.0]), 260.0, 320, 240
)


def plane_and_colours(n_photos=4):
    """Places of a wall before one camera, and what photos see of it, apart by noise."""
    rng = np.random.default_rng(0)
    places = rng.uniform([-1.5, 0.0, -1.2], [1.5, 0.0, 1.2], (40_000, 3))
    wall = np.exp(rng.uniform(3.5, 5.2, (len(places), 3)))
    colours = [
        (wall * np.exp(rng.normal(0.0, 0.03, wall.shape))).astype(np.float32)
        for _ in range(n_photos)
    ]
    return places, colours


@pytest.mark.parametrize("bar", [2.0, 250.0, 90.0])
def test_a_bar_before_the_wall_in_one_photo_is_found_in_that_photo_alone(bar):
    places, colours = plane_and_colours()
    behind = np.abs(places[:, 0] - 0.4) < 0.25
    colours[2][behind] = bar
    strangers = find_strangers([CAMERA] * 4, places, colours, np.ones((4, 3)))
    assert [bool(one.area.any()) for one in strangers] == [False, False, True, False]
    found = strangers[2]
    assert found.share == pytest.approx(behind.mean(), abs=0.02)
    photo = dataclasses.replace(
        small_scene().photos[0], mask=np.ones((240, 320), dtype=bool)
    )
    mask = found.taken_from(photo).mask
    assert mask is not None
    columns, rows = np.rint(CAMERA.project(places)).astype(int).T
    kept = mask[np.clip(rows, 0, 239), np.clip(columns, 0, 319)]
    deep = np.abs(places[:, 0] - 0.4) < 0.2
    far = np.abs(places[:, 0] - 0.4) > 0.32
    assert not kept[deep].any()
    assert kept[far].all()


def test_where_two_photos_see_a_place_neither_is_left_out():
    places, colours = plane_and_colours(2)
    colours.append(np.full_like(colours[0], np.nan))
    colours[0][:20_000] = 9.0
    strangers = find_strangers([CAMERA] * 3, places, colours, np.ones((3, 3)))
    assert not any(one.area.any() for one in strangers)


def test_photos_of_which_no_two_agree_are_all_painted():
    places, colours = plane_and_colours(3)
    colours = [colours[0], 0.3 * colours[0], 3.0 * colours[0]]
    strangers = find_strangers([CAMERA] * 3, places, colours, np.ones((3, 3)))
    assert not any(one.area.any() for one in strangers)


def test_another_exposure_that_is_evened_out_is_no_stranger():
    places, colours = plane_and_colours(3)
    colours[1] = 0.5 * colours[1]
    gains = np.ones((3, 3))
    gains[1] = 2.0
    strangers = find_strangers([CAMERA] * 3, places, colours, gains)
    assert not any(one.area.any() for one in strangers)


def test_bars_before_each_photo_leave_no_trace_in_the_texture():
    scene = small_scene(n_photos=4, baseline_deg=12.0)
    photos = []
    for i, photo in enumerate(scene.photos):
        pixels = photo.pixels.copy()
        pixels[:, 100 + 30 * i : 114 + 30 * i] = (20, 60, 200)
        photos.append(dataclasses.replace(photo, pixels=pixels))
    atlas = make_atlas(scene.mesh, True)
    plain = TextureConfig(size=256)
    clean = bake_texture(scene.mesh, scene.photos, scene.cameras, plain, atlas)
    # Nothing stands before the object: texture and misfit alone leave nothing out.
    assert max(clean.left_out_share_by_photo) < 0.01, clean.left_out_share_by_photo
    painted = dataclasses.replace(plain, leave_out_strangers=False)
    with_bars = bake_texture(scene.mesh, photos, scene.cameras, painted, atlas)
    without = bake_texture(scene.mesh, photos, scene.cameras, plain, atlas)
    assert min(without.left_out_share_by_photo) > 0.03
    seen = clean.photo_index >= 0

    def rms(textured) -> float:
        off = textured.texture[seen].astype(float) - clean.texture[seen]
        return float(np.sqrt(np.mean(off**2)))

    assert rms(without) < 0.3 * rms(with_bars), (rms(without), rms(with_bars))
