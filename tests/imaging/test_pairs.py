"""The pairs of photos: connected, few a photo, the same whatever the order."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photoreg.imaging.pairs import (
    ALL_UP_TO,
    LEAST,
    MOST,
    all_pairs,
    choose_pairs,
    connecting_pairs,
    hanging_in_words,
    in_order,
    pair_scores,
    pairs_in_words,
    points_of_pair,
    weight_of_pair,
)
from tests.scenes import small_scene


def components(n, pairs) -> int:
    tree = list(range(n))
    for i, k in pairs:
        tree = [tree[i] if t == tree[k] else t for t in tree]
    return len(set(tree))


def degrees(n, pairs) -> np.ndarray:
    return np.bincount(np.array(pairs, dtype=int).ravel(), minlength=n)


def random_scores(n, seed, share=1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.random((n, n)) * (rng.random((n, n)) < share), 1)
    return upper + upper.T


def around(n_photos=12, step_deg=25.0):
    """Photos around an object, the last far enough from the first."""
    return small_scene(
        n_photos=n_photos, baseline_deg=step_deg, n_faces=1_280, width=96, height=72
    )


@settings(deadline=None, max_examples=60)
@given(n=st.integers(5, 40), seed=st.integers(0, 1000))
def test_where_all_share_surface_all_are_connected_by_three_to_six_pairs_each(n, seed):
    pairs = connecting_pairs(random_scores(n, seed))
    assert components(n, pairs) == 1
    degree = degrees(n, pairs)
    assert degree.min() >= LEAST, degree
    assert degree.max() <= MOST, degree


@settings(deadline=None, max_examples=60)
@given(n=st.integers(2, 30), seed=st.integers(0, 1000), share=st.floats(0.0, 0.4))
def test_where_few_share_surface_no_pair_is_without_it_and_none_is_cut_off(
    n, seed, share
):
    scores = random_scores(n, seed, share)
    pairs = connecting_pairs(scores)
    assert all(scores[pair] > 0.0 for pair in pairs)
    possible = [pair for pair in all_pairs(n) if scores[pair] > 0.0]
    assert components(n, pairs) == components(n, possible)


@settings(deadline=None, max_examples=40)
@given(n=st.integers(2, 30), seed=st.integers(0, 1000))
def test_permuted_photos_have_the_same_pairs(n, seed):
    scores = random_scores(n, seed)
    order = np.random.default_rng(seed).permutation(n)
    permuted = connecting_pairs(scores[np.ix_(order, order)])
    back = {tuple(sorted((int(order[i]), int(order[k])))) for i, k in permuted}
    assert back == set(connecting_pairs(scores))


def test_photos_around_an_object_are_compared_with_their_neighbours():
    scene = around()
    pairs = choose_pairs(scene.mesh, scene.photos, scene.cameras)
    n = len(scene.photos)
    assert components(n, pairs) == 1
    degree = degrees(n, pairs)
    assert degree.min() >= LEAST, degree
    assert degree.max() <= MOST, degree
    middle = scene.mesh.bounds.mean(axis=0)
    rays = np.array([camera.center - middle for camera in scene.cameras])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    apart_deg = [np.degrees(np.arccos(rays[i] @ rays[k])) for i, k in pairs]
    assert max(apart_deg) < 90.0, apart_deg
    assert min(apart_deg) > 10.0, apart_deg
    for i in range(n - 1):
        assert (i, i + 1) in pairs


def test_the_scores_of_photos_do_not_know_their_order():
    scene = around()
    scores = pair_scores(scene.mesh, scene.photos, scene.cameras)
    order = np.random.default_rng(1).permutation(len(scene.photos))
    permuted = pair_scores(
        scene.mesh,
        [scene.photos[i] for i in order],
        [scene.cameras[i] for i in order],
    )
    np.testing.assert_array_equal(permuted, scores[np.ix_(order, order)])


def test_what_a_mask_takes_away_is_not_shared():
    scene = around(n_photos=5)
    first, second, *rest = scene.photos
    left, right = np.zeros((72, 96), bool), np.zeros((72, 96), bool)
    left[:, :48], right[:, 48:] = True, True
    whole = pair_scores(scene.mesh, scene.photos, scene.cameras)
    photos = [dataclasses.replace(first, mask=left), second, *rest]
    halved = pair_scores(scene.mesh, photos, scene.cameras)
    assert 0.2 * whole[0, 1] < halved[0, 1] < 0.8 * whole[0, 1]
    photos[1] = dataclasses.replace(second, mask=np.zeros((72, 96), bool))
    assert (pair_scores(scene.mesh, photos, scene.cameras)[1] == 0.0).all()


@pytest.mark.parametrize("n", range(ALL_UP_TO + 1))
def test_few_photos_are_compared_all_with_all(n):
    scene = around(n_photos=5)
    pairs = choose_pairs(scene.mesh, scene.photos[:n], scene.cameras[:n])
    assert pairs == all_pairs(n) == in_order(pairs)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_few_photos_keep_the_points_and_the_weights_of_all_pairs(n):
    n_pairs = len(all_pairs(n))
    assert points_of_pair(60_000, n_pairs, 500) == 60_000 // n_pairs
    for share in np.random.default_rng(0).random(20):
        assert weight_of_pair(share, n, n_pairs) == share * 2.0 / n


def test_points_of_many_photos_grow_with_the_number_of_pairs():
    assert points_of_pair(60_000, 20, 500) == points_of_pair(60_000, 200, 500)
    assert points_of_pair(600, 20, 500) == 500


def test_photos_that_hang_by_one_pair_or_none_are_named():
    names = ["a", "b", "c", "d", "e", "f"]
    pairs = ((0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (3, 4))
    alone, unpaired = hanging_in_words(names, pairs)
    assert alone.startswith("e is compared with d only"), alone
    assert unpaired.startswith("f is compared with no other photo"), unpaired
    assert hanging_in_words(names[:4], pairs[:3]) == ()
    assert pairs_in_words(names, pairs) == (
        "6 pairs of photos were compared: a with b and c; b with c and d; c with d; "
        "d with e."
    )
    assert pairs_in_words(names[:4], pairs[:3]) == ""
