"""Light that moves between photos, taken out by the surface's normals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photoreg.polish.lighting import fit_light, light_basis


@pytest.fixture
def normals():
    rng = np.random.default_rng(3)
    n = rng.normal(size=(6_000, 3)) + np.array([0.0, 0.0, 1.5])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


CELLS = np.arange(0, 6_001, 60)


def _lit(normals, lamp):
    """Light of one lamp on a matt surface, its dark side included."""
    return 80.0 * np.maximum(normals @ (np.array(lamp) / np.linalg.norm(lamp)), 0.0)


def test_lamps_that_moved_are_taken_out(normals):
    rng = np.random.default_rng(4)
    moved = _lit(normals, [1.0, 0.3, 1.0]) - _lit(normals, [-1.0, 0.2, 0.8])
    residual = np.column_stack([moved, 0.5 * moved, np.zeros(len(moved))])
    residual += rng.normal(0.0, 1.0, residual.shape)
    left = residual - fit_light(residual, normals[:, None], CELLS)
    # A quadratic takes one lamp's cut-off cosine to a few percent (Basri and Jacobs).
    assert left[:, 0].std() < 0.12 * residual[:, 0].std()
    assert left[:, 1].std() < 0.2 * residual[:, 1].std()
    assert left[:, 2].std() > 0.98, "noise is not light"


def test_things_in_front_do_not_spoil_the_fit(normals):
    light = light_basis(normals) @ np.array([20, -8, 5, 3, 0, -6, 2, 1.0])
    residual = light.copy()
    rng = np.random.default_rng(5)
    residual[rng.random(len(residual)) < 0.15] += 150.0
    found = fit_light(residual[:, None], normals[:, None], CELLS)[:, 0]
    assert np.abs(found - (light - light.mean())).mean() < 1.0


def test_a_cell_in_shadow_does_not_count(normals):
    light = light_basis(normals) @ np.array([20, -8, 5, 3, 0, -6, 2, 1.0])
    shadow = np.repeat(np.random.default_rng(6).normal(0.0, 60.0, 100), 60)
    found = fit_light((light + shadow)[:, None], normals[:, None], CELLS)[:, 0]
    assert np.abs(found - (light - light.mean())).max() < 0.1


def test_the_fit_does_not_depend_on_the_axes(normals):
    residual = (_lit(normals, [1, 0, 1]) - _lit(normals, [0, 1, 1]))[:, None]
    turned = normals @ Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix().T
    first, second = (fit_light(residual, n[:, None], CELLS) for n in (normals, turned))
    assert np.abs(first - second).max() < 0.05


def test_a_flat_surface_has_no_light_of_its_own():
    flat = np.tile([0.0, 0.0, 1.0], (600, 1))
    residual = np.random.default_rng(7).normal(size=(600, 2))
    light = fit_light(residual, flat[:, None], np.arange(0, 601, 60))
    assert np.abs(light).max() < 1e-9


def test_the_fit_finds_the_scale_at_which_light_meets_the_surface(normals):
    light = light_basis(normals) @ np.array([20, -8, 5, 3, 0, -6, 2, 1.0])
    rough = normals + np.random.default_rng(8).normal(0.0, 0.5, normals.shape)
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    both = np.stack([rough, normals], axis=1)
    found = fit_light(light[:, None], both, CELLS)[:, 0]
    assert np.abs(found - (light - light.mean())).max() < 0.1


def test_what_stands_in_front_is_not_taken_for_light(normals):
    rng = np.random.default_rng(10)
    residual = rng.normal(0.0, 2.0, len(normals))
    # A fifth is covered; there the colours differ, and they do so with the normal.
    covered = np.arange(len(normals)) < len(normals) // 5
    residual[covered] += 60.0 * normals[covered, 0]
    assert not fit_light(residual[:, None], normals[:, None], CELLS).any()
