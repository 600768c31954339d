"""Reducers against sorting, for any values and any trimming."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photoreg.search.trimmed_mean import N_BUCKETS, sort_in_place, trimmed_mean
from tests.search import naive_trimmed_mean

VALUES = st.lists(
    st.one_of(
        st.floats(0.0, 2.0**100, width=32, allow_subnormal=False),
        # Ties, and many values in one bucket, are where selection goes wrong.
        st.sampled_from([0.0, 1.0, 1.0000001, 1.5, 100.0]),
    ),
    min_size=1,
    max_size=200,
)


def trimmed(values: np.ndarray, n_low: int, n_high: int) -> float:
    counts = np.zeros(N_BUCKETS, dtype=np.int32)
    border = np.zeros(len(values) + 1, dtype=np.float32)
    return trimmed_mean(values, len(values), n_low, n_high, counts, border)


@given(values=VALUES, low=st.floats(0.0, 0.6), high=st.floats(0.0, 0.6))
@settings(max_examples=300, deadline=None)
def test_trimmed_mean_is_the_mean_of_the_middle_ranks(values, low, high):
    array = np.array(values, dtype=np.float32)
    n_low, n_high = int(low * len(array)), int(high * len(array))
    expected = naive_trimmed_mean.trimmed_mean(array, n_low, n_high)
    found = trimmed(array, n_low, n_high)
    assert found == pytest.approx(expected, rel=1e-6), (found, expected)


@pytest.mark.parametrize("n", [2, 47, 48, 49, 1000, 20_000])
def test_trimmed_mean_holds_when_all_values_share_one_bucket(n):
    values = np.random.default_rng(n).uniform(1.0, 1.1, n).astype(np.float32)
    n_trim = n // 5
    expected = naive_trimmed_mean.trimmed_mean(values, n_trim, n_trim)
    found = trimmed(values, n_trim, n_trim)
    assert found == pytest.approx(expected, rel=1e-7), (found, expected)


def test_trimmed_mean_of_nothing_is_infinite():
    assert trimmed(np.ones(4, dtype=np.float32), 2, 2) == np.inf


def test_trimmed_mean_drops_infinite_values_like_any_large_ones():
    values = np.array([np.inf, 1.0, 2.0, 3.0, np.inf], dtype=np.float32)
    assert trimmed(values, 1, 2) == 2.5


def test_trimmed_mean_leaves_the_values_as_they_were():
    values = np.random.default_rng(3).random(500).astype(np.float32)
    before = values.copy()
    trimmed(values, 100, 100)
    np.testing.assert_array_equal(values, before)


@given(values=VALUES)
@settings(max_examples=100, deadline=None)
def test_sort_in_place_sorts_what_it_is_told_to(values):
    array = np.array([*values, 0.5], dtype=np.float32)
    sort_in_place(array, len(values))
    np.testing.assert_array_equal(array[:-1], np.sort(np.float32(values)))
    assert array[-1] == 0.5
