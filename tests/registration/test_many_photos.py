"""Refinements of more photos than are compared all with all."""

import dataclasses

import numpy as np
import pytest

from photoreg.geometry.projection_error import projection_error
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom, Held
from photoreg.polish.config import PolishConfig
from photoreg.registration import refinement
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.refinement import polish_side_px, refine
from photoreg.search.genetic import GeneticConfig
from tests.scenes import small_scene

N = 5
QUICK = dataclasses.replace(
    RegistrationConfig.preset("default"),
    samples=150,
    genetic=GeneticConfig(
        population=60, generations=16, restarts=1, mutations="each_gene"
    ),
    polish=PolishConfig(
        blurs_px=(4.0, 1.0),
        points=(2_000, 4_000),
        rounds=(2, 1),
        extra_rounds=1,
        rim_reaches_px=(25.0, 6.0),
        patches=1_000,
        correspondence_rounds=1,
    ),
    distortion="k1",
)
ALL_HELD = Held(True, True, True, True)


def scene_around():
    return small_scene(n_photos=N, width=160, height=120, error_px=(3.0, 4.0))


def same_camera(a, b) -> bool:
    return np.array_equal(a.P, b.P) and a.lens == b.lens


def test_one_that_is_added_is_registered_and_the_others_stay_to_the_last_bit():
    scene = scene_around()
    added = 3
    cameras = [*scene.cameras]
    cameras[added] = scene.rough_cameras[added]
    held = [ALL_HELD] * N
    held[added] = Held()
    *_, last = refine(scene.mesh, scene.photos, cameras, QUICK, Freedom(tuple(held)))
    assert isinstance(last, Finished)
    for i in range(N):
        assert same_camera(last.cameras[i], cameras[i]) == (i != added), i
    assert len(last.pairs) >= 3
    assert all(added in pair for pair in last.pairs), last.pairs
    error = projection_error(scene.mesh, scene.cameras, last.cameras)
    # A tenth of a pixel at this size; the start is 3 to 4 px off.
    assert error.cameras[added].mean < 0.3, error.cameras[added].mean
    known = [error_px is not None for error_px in last.expected_errors_px]
    assert known == [i == added for i in range(N)]


@pytest.mark.slow
def test_a_photo_of_another_object_is_named_and_the_others_are_right_without_it():
    scene = scene_around()
    stranger = small_scene(seed=7, width=160, height=120, background="clutter").photos[
        0
    ]
    odd = 2
    photos = [*scene.photos]
    photos[odd] = dataclasses.replace(photos[odd], pixels=stranger.pixels[::-1].copy())
    *events, last = refine(scene.mesh, photos, scene.rough_cameras, QUICK)
    assert isinstance(last, Finished)
    (said,) = [one for one in last.warnings if "was left out" in one]
    assert said.startswith(photos[odd].name), said
    assert same_camera(last.cameras[odd], scene.rough_cameras[odd])
    assert not any(odd in pair for pair in last.pairs)
    assert last.verdict is not None
    assert last.verdict.is_credible, last.verdict
    fractions = [e.fraction for e in events if isinstance(e, Progress)]
    assert (np.diff(fractions) >= 0.0).all()
    rest = [i for i in range(N) if i != odd]
    error = projection_error(
        scene.mesh,
        [scene.cameras[i] for i in rest],
        [last.cameras[i] for i in rest],
    )
    *_, without = refine(
        scene.mesh,
        [photos[i] for i in rest],
        [scene.rough_cameras[i] for i in rest],
        QUICK,
    )
    assert isinstance(without, Finished)
    for i, camera in zip(rest, without.cameras, strict=True):
        assert same_camera(last.cameras[i], camera)
    assert error.mean < 0.3, error.mean


@pytest.mark.parametrize("n", [1, 12, 13, 50, 100])
def test_photos_of_any_number_have_no_more_pixels_in_the_polish_than_stated(
    n, monkeypatch
):
    monkeypatch.setattr(refinement, "MOST_PIXELS", 12 * 64 * 48)
    whole = Photo("a.png", np.zeros((96, 128, 3), np.uint8))
    flat = Photo("b.png", np.zeros((48, 128, 3), np.uint8))
    side = polish_side_px([whole] * n, 64)
    assert (side == 64) == (n <= 12)
    pixels = n * np.prod(whole.resized(side).pixels.shape[:2])
    assert pixels <= 12 * 64 * 48
    if side < 64:
        assert pixels > 0.8 * 12 * 64 * 48
    assert polish_side_px([whole, flat], 64) == 64
