"""Samples lie on the surface, by area; patches follow it."""

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface, surface_patches
from tests.scenes import small_scene


def plate() -> Mesh:
    """A 3 x 1 plate of two unequal triangles and one that has no area."""
    vertices = np.array([[0, 0, 0], [3, 0, 0], [3, 1, 0], [0, 1, 0.0]])
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 1, 1]]))


def test_samples_lie_on_their_faces():
    mesh = small_scene().mesh
    samples = sample_surface(mesh, 400, 5)
    corners = mesh.vertices[mesh.faces[samples.face_index]]
    normal = mesh.face_normals[samples.face_index]
    off = np.abs(np.einsum("nd,nd->n", samples.points - corners[:, 0], normal)).max()
    assert off < 1e-9 * mesh.diagonal, off
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], -1)
    weights = np.einsum(
        "nij,nj->ni", np.linalg.pinv(edges), samples.points - corners[:, 0]
    )
    assert weights.min() > -1e-6, weights.min()
    assert weights.sum(axis=1).max() < 1 + 1e-6


def test_each_part_of_the_surface_gets_its_share():
    mesh = small_scene().mesh
    n = 20_000
    counts = np.bincount(
        sample_surface(mesh, n, 1).face_index, minlength=len(mesh.faces)
    )
    expected = n * mesh.face_areas / mesh.area
    # Stratified: no run of faces is ever off by more than its two ends.
    worst = np.abs(np.cumsum(counts) - np.cumsum(expected)).max()
    assert worst <= 1.0 + 1e-6, worst


def test_samples_are_even_within_a_face():
    points = sample_surface(plate(), 20_000, 2).points
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=(6, 2))
    # 1,667 are expected in each cell, with a deviation of 39 at most.
    worst = np.abs(counts - 20_000 / 12).max()
    assert worst < 5 * 39, worst


def test_normals_are_unit_and_outward():
    mesh = small_scene().mesh
    samples = sample_surface(mesh, 500, 5)
    np.testing.assert_allclose(np.linalg.norm(samples.normals, axis=1), 1.0)
    outward = np.einsum(
        "nd,nd->n", samples.normals, mesh.face_normals[samples.face_index]
    )
    assert outward.min() > 0.5, outward.min()


def test_samples_are_a_function_of_their_seed():
    mesh = small_scene().mesh
    first, same, other = (sample_surface(mesh, 50, seed).points for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)


def test_fewer_than_one_sample_is_refused():
    with pytest.raises(InputError, match="is 0; give at least 1"):
        sample_surface(plate(), 0, 0)


def test_patches_lie_on_the_surface_around_their_middles():
    mesh = small_scene().mesh
    samples = sample_surface(mesh, 60, 5)
    step = np.full(60, 0.004 * mesh.diagonal)
    patches = surface_patches(mesh, samples, step, 3)
    assert patches.shape == (60, 9, 3)
    # The middle is the sample itself, to embree's float32.
    apart = np.linalg.norm(patches[:, 4] - samples.points, axis=1).max()
    assert apart < 1e-5 * mesh.diagonal, apart
    reach = np.linalg.norm(patches - samples.points[:, None], axis=2).max()
    assert step[0] < reach < 3 * step[0], reach
    _, distance = mesh.first_hits(
        (patches + 0.01 * samples.normals[:, None]).reshape(-1, 3),
        np.repeat(-samples.normals, 9, axis=0),
    )
    off = np.median(np.abs(distance - 0.01))
    assert off < 1e-5 * mesh.diagonal, off


@pytest.mark.parametrize("side", [1, 4])
def test_patches_without_a_middle_are_refused(side):
    mesh = plate()
    with pytest.raises(InputError, match="give an odd number >= 3"):
        surface_patches(mesh, sample_surface(mesh, 3, 0), np.ones(3), side)
