"""The scan's error as a field: size and length from what the cameras leave of it."""

import numpy as np
import pytest

from photoreg.polish.mesh_field import MeshField, fit_mesh_field

N = 144
PLACES = np.array([(i % 12, i // 12, 0.0) for i in range(N)])
NOISE = 0.1

DESIGN = np.column_stack(
    [
        np.ones(N),
        PLACES[:, 0] - 5.5,
        PLACES[:, 1] - 5.5,
        (PLACES[:, 0] - 5.5) * (PLACES[:, 1] - 5.5),
        (PLACES[:, 0] - 5.5) ** 2,
        (PLACES[:, 1] - 5.5) ** 2,
    ]
)
"""Cameras follow anything as slow as a quadric, as turns and zooms do."""


def drawn(field: MeshField, seed: int) -> np.ndarray:
    """The errors that cameras leave of a field, with the matches' noise."""
    rng = np.random.default_rng(seed)
    # With a share of its variance, so that all smooth fields can be drawn.
    covariance = field.covariance(PLACES) + 1e-9 * np.eye(N)
    errors = np.linalg.cholesky(covariance) @ rng.standard_normal(N)
    errors += NOISE * rng.standard_normal(N)
    followed, *_ = np.linalg.lstsq(DESIGN, errors)
    return errors - DESIGN @ followed


@pytest.mark.parametrize(("sigma", "length"), [(0.5, 0.0), (1.0, 1.0), (2.0, 2.0)])
def test_size_and_length_are_found_though_cameras_followed(sigma, length):
    found = [
        fit_mesh_field(
            drawn(MeshField(sigma, length), seed), np.full(N, NOISE**2), DESIGN, PLACES
        )
        for seed in range(10)
    ]
    assert np.median([field.length for field in found]) == length
    assert np.median([field.sigma for field in found]) == pytest.approx(sigma, rel=0.3)


def test_where_the_cameras_follow_the_field_is_larger_than_what_is_left():
    truth = MeshField(2.0, 4.0)
    fits, left = [], []
    for seed in range(10):
        errors = drawn(truth, seed)
        fits.append(fit_mesh_field(errors, np.full(N, NOISE**2), DESIGN, PLACES).sigma)
        left.append(errors.std())
    assert np.median(left) < 0.5 * truth.sigma
    assert 0.5 * truth.sigma < np.median(fits) < 2.0 * truth.sigma


def test_noise_alone_is_no_field():
    for seed in range(10):
        errors = drawn(MeshField(0.0, 0.0), seed)
        found = fit_mesh_field(errors, np.full(N, NOISE**2), DESIGN, PLACES)
        assert found.sigma <= NOISE


def test_a_few_wild_cells_do_not_make_a_field():
    errors = drawn(MeshField(0.0, 0.0), 3)
    errors[[5, 60, 100]] = 50.0
    found = fit_mesh_field(errors, np.full(N, NOISE**2), DESIGN, PLACES)
    assert found.sigma <= NOISE
