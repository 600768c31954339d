"""Scans as they come, and photos as they come: each error is as large as it says."""

from typing import Any

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scan_errors import scanned
from photoreg.synthetic.sensor import behind_leaves, hazy
from tests.scenes import small_scene

MESH = small_scene().true_mesh


def off_along_normal(**settings: Any) -> np.ndarray:
    """How far each vertex of the scan is off, as a share of the diagonal."""
    mesh = scanned(MESH, SceneOptions(kind="clean", **settings).settings(), seed=4)
    apart = mesh.vertices - MESH.vertices
    return np.einsum("nd,nd->n", apart, MESH.vertex_normals) / MESH.diagonal


def test_a_scan_without_errors_is_the_surface():
    assert scanned(MESH, SceneOptions(kind="clean").settings(), seed=4) is MESH


@pytest.mark.parametrize("length", [0.03, 0.1])
def test_bumps_are_as_high_and_as_long_as_said(length):
    errors = off_along_normal(mesh_noise=0.002, mesh_noise_length=length)
    # A field that is alike over a tenth of the object has few independent places.
    assert np.sqrt((errors**2).mean()) == pytest.approx(0.002, rel=0.3)
    rng = np.random.default_rng(0)
    first = rng.integers(0, len(errors), 200_000)
    second = rng.integers(0, len(errors), 200_000)
    apart = np.linalg.norm(MESH.vertices[first] - MESH.vertices[second], axis=1)
    apart /= MESH.diagonal * length
    products = errors[first] * errors[second] / (errors**2).mean()
    near = np.abs(apart - 1.0) < 0.2
    assert products[near].mean() == pytest.approx(np.exp(-0.5), abs=0.15)
    assert abs(products[(apart > 4.0) & (apart < 8.0)].mean()) < 0.3


def test_smoothing_takes_off_what_stands_out_and_fat_edges_add_to_it():
    rounded = off_along_normal(mesh_smoothing=0.02)
    fat = off_along_normal(mesh_fat_edges=0.003)
    assert fat.min() >= -1e-6
    assert fat.max() == pytest.approx(0.003, rel=0.01)
    assert (fat > 0.0015).mean() < 0.5
    # What smoothing takes off most is what is made fat.
    assert rounded[fat > 0.0025].mean() < 4.0 * min(0.0, rounded[fat < 1e-6].mean())


def test_holes_take_the_share_of_the_area_and_leave_the_rest():
    settings = SceneOptions(kind="clean", mesh_holes=0.1).settings()
    mesh = scanned(MESH, settings, seed=4)
    assert mesh.area / MESH.area == pytest.approx(0.9, abs=0.005)
    faces = {tuple(face) for face in MESH.faces.tolist()}
    assert {tuple(face) for face in mesh.faces.tolist()} <= faces


def test_leaves_hide_their_share_and_haze_changes_slowly():
    grey = np.full((240, 320, 3), 0.4, dtype=np.float32)
    leaves = behind_leaves(grey, 0.1, seed=3)
    hidden = (leaves != grey).any(axis=2)
    assert 0.1 <= hidden.mean() < 0.11
    # Many small ones: no quarter of the picture is hidden whole, most have some.
    assert not hidden[:120, :160].all()
    assert (grey == np.float32(0.4)).all()
    veiled = hazy(grey, 0.3, [3, 0])
    other = hazy(grey, 0.3, [3, 1])
    assert np.abs(veiled - other).max() > 0.01
    assert np.abs(np.diff(veiled, axis=0)).max() < 0.005
    assert np.abs(veiled - grey).max() <= 0.3 * 0.27


def test_a_highlight_only_adds_light_and_moves_with_the_camera():
    dull, glossy = (small_scene(gloss=gloss, light="same") for gloss in (0.0, 0.5))
    added = [
        bright.pixels.astype(int) - plain.pixels
        for plain, bright in zip(dull.photos, glossy.photos, strict=True)
    ]
    for light in added:
        assert light.min() >= -1
        assert 0.01 < (light.max(axis=2) > 40).mean() < 0.5


@pytest.mark.parametrize(
    "name", ["haze", "mesh_holes", "foliage_share", "mesh_noise_length"]
)
def test_what_is_no_share_is_refused_by_name(name):
    setting: dict[str, Any] = {name: -0.1}
    with pytest.raises(InputError, match=name):
        SceneOptions(kind="clean", **setting)
