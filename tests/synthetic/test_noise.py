"""Solid noise: its slow twin, its statistics, its smoothness."""

import numpy as np

from photoreg.synthetic.noise import SolidNoise
from tests.synthetic.naive_noise import solid_noise


def points(n, spread=3.0):
    return np.random.default_rng(5).normal(size=(n, 3)) * spread


def test_the_kernel_agrees_with_its_slow_twin():
    noise = SolidNoise(3)
    fast = noise(points(200), 1.7, octaves=5, gain=0.6)
    slow = solid_noise(noise, points(200), 1.7, 5, 0.6)
    # Single precision weights and sums.
    assert np.abs(fast - slow).max() < 1e-5, np.abs(fast - slow).max()


def test_the_noise_is_a_function_of_its_seed():
    first, again, other = (SolidNoise(seed)(points(50), 2.0, 3) for seed in (8, 8, 9))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


def test_mean_and_amplitude_do_not_depend_on_the_number_of_octaves():
    for octaves in (1, 3, 7):
        values = SolidNoise(1)(points(40_000, spread=20.0), 1.3, octaves)
        assert np.abs(values.mean(axis=0)).max() < 0.05, values.mean(axis=0)
        assert 0.6 < values.std() < 0.85, (octaves, values.std())


def test_the_channels_are_independent():
    values = SolidNoise(1)(points(40_000, spread=20.0), 1.3, 4)
    correlations = np.corrcoef(values.T) - np.eye(3)
    assert np.abs(correlations).max() < 0.05, correlations


def test_small_steps_change_the_noise_little_also_across_cells():
    line = np.linspace(-4.0, 4.0, 80_001)[:, None] * np.array([1.0, 0.37, -0.61])
    values = SolidNoise(2)(line, 1.0).astype(np.float64)
    # Cells are crossed every 10,000 steps or so; the slope is at most 2 * 1.8 * 15/8
    # per cell and axis.
    assert np.abs(np.diff(values, axis=0)).max() < 2e-3
