"""The search among many photos: in which order, against whom, and that it finds them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photoreg.geometry.sampling import sample_surface
from photoreg.imaging.pairs import choose_pairs, connecting_pairs, pair_scores
from photoreg.parameters.freedom import Freedom, Held
from photoreg.registration.config import REDUCED_PHOTOS, RegistrationConfig
from photoreg.registration.growing_search import MOST_HELD, GrowingSearch, stages_of
from photoreg.search.genetic import GeneticConfig
from photoreg.search.photo_consistency import PhotoConsistency
from tests.scenes import small_scene

QUICK = dataclasses.replace(
    RegistrationConfig.preset("default"),
    samples=200,
    genetic=GeneticConfig(
        population=80, generations=24, restarts=1, mutations="each_gene"
    ),
)


def random_scores(n, seed, share=1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.random((n, n)) * (rng.random((n, n)) < share), 1)
    return upper + upper.T


@settings(deadline=None, max_examples=60)
@given(
    n=st.integers(2, 20),
    seed=st.integers(0, 1000),
    share=st.floats(0.0, 1.0),
    n_held=st.integers(0, 2),
)
def test_each_photo_with_a_pair_is_searched_for_once_against_those_found_before(
    n, seed, share, n_held
):
    scores = random_scores(n, seed, share)
    pairs = connecting_pairs(scores)
    held = list(range(n_held))
    found = set(held)
    for stage in stages_of(pairs, scores, held):
        assert len(stage.searched) == (1 if stage.against else 2)
        assert len(stage.against) <= MOST_HELD
        assert found.issuperset(stage.against)
        assert found.isdisjoint(stage.searched)
        for photo in stage.searched:
            for other in stage.against:
                assert tuple(sorted((photo, other))) in pairs
        found.update(stage.searched)
    paired = {photo for pair in pairs for photo in pair}
    assert found == paired | set(held)


def grown(scene, freedom=None):
    pairs = choose_pairs(scene.mesh, scene.photos, scene.rough_cameras)
    scores = pair_scores(scene.mesh, scene.photos, scene.rough_cameras)
    search = GrowingSearch(
        scene.mesh,
        scene.photos,
        scene.rough_cameras,
        QUICK,
        freedom or Freedom(),
        pairs,
        scores,
    )
    return list(search.steps())


def test_every_photo_is_found_and_what_is_held_stays():
    scene = small_scene(n_photos=5, width=160, height=120, error_px=(3.0, 4.0))
    held = [Held(True, True, True), *[Held()] * 4]
    held[2] = Held(focal=True)
    steps = grown(scene, Freedom(tuple(held)))
    fractions = [step.fraction for step in steps]
    assert (np.diff(fractions) >= 0.0).all()
    assert fractions[-1] == pytest.approx(1.0)
    assert (np.diff([step.evaluations for step in steps]) >= 0).all()
    cameras = steps[-1].cameras
    assert cameras[0] is scene.rough_cameras[0]
    assert np.array_equal(cameras[2].K[:2, :2], scene.rough_cameras[2].K[:2, :2])
    moved = [a is not b for a, b in zip(cameras, scene.rough_cameras, strict=True)]
    assert moved == [False, True, True, True, True]


def test_the_photos_come_to_agree_all_with_all():
    scene = small_scene(n_photos=5, width=160, height=120, error_px=(3.0, 4.0))
    cameras = grown(scene)[-1].cameras
    both = PhotoConsistency(
        sample_surface(scene.mesh, 500, 0), scene.photos, REDUCED_PHOTOS
    )
    before, after, right = (
        both.cost(some) for some in (scene.rough_cameras, cameras, scene.cameras)
    )
    # What is left at the true cameras is the pixels' own.
    assert after - right < 0.4 * (before - right), (before, after, right)
