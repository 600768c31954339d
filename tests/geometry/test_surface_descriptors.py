"""Normals, occlusion and curvature of surfaces whose shape is known."""

import dataclasses

import numpy as np
import trimesh

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_descriptors import surface_descriptors, vertex_colours
from tests.polish_scene import bumpy_ball


def pitted_ball():
    """A ball with one deep pit about +z; its radius, and how far each vertex is from there."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    directions = np.asarray(ball.vertices)
    angle = np.arccos(np.clip(directions[:, 2], -1.0, 1.0))
    radius = 1.0 - 0.5 * np.exp(-((angle / 0.25) ** 2))
    return Mesh(directions * radius[:, None], np.asarray(ball.faces)), angle


def test_a_pit_sees_little_of_the_sky_and_lies_low():
    mesh, angle = pitted_ball()
    found = surface_descriptors(mesh)
    assert found.mesh is mesh
    bottom, far = angle < 0.05, angle > 1.0
    assert found.occlusion[bottom].min() > 0.4, found.occlusion[bottom]
    # Nothing of a ball is above its own horizon but what its facets let through.
    assert found.occlusion[far].mean() < 0.02, found.occlusion[far].mean()
    rim = np.abs(angle - 0.42) < 0.05
    assert found.curvature[bottom].max() < 0.0 < found.curvature[rim].min()
    outwards = mesh.vertices[far]
    assert np.einsum("nd,nd->n", found.normals[far], outwards).min() > 0.99


def test_the_coarser_normals_are_evener():
    mesh = bumpy_ball(5)
    rough = dataclasses.replace(
        mesh,
        vertices=mesh.vertices
        + 0.003 * np.random.default_rng(0).normal(size=mesh.vertices.shape),
    )
    found = surface_descriptors(rough)
    errors = [
        np.linalg.norm(normals - mesh.vertex_normals, axis=1).mean()
        for normals in (rough.vertex_normals, found.normals, found.coarse_normals)
    ]
    assert errors[2] < errors[1] <= errors[0], errors


def test_descriptors_do_not_depend_on_units_and_place():
    mesh = bumpy_ball()
    R = trimesh.transformations.rotation_matrix(0.9, [1.0, -2.0, 0.5])[:3, :3]
    other = Mesh(1e-3 * mesh.vertices @ R.T + [5.0, 6.0, -7.0], mesh.faces)
    here, there = surface_descriptors(mesh), surface_descriptors(other)
    np.testing.assert_allclose(there.normals @ R, here.normals, atol=1e-6)
    np.testing.assert_allclose(there.curvature, here.curvature, atol=1e-5)
    # Rays are turned at random about another frame: sqrt(0.25 / 64) of noise at most.
    assert np.abs(there.occlusion - here.occlusion).mean() < 0.02


def test_colours_are_those_of_the_vertices_or_of_the_texture():
    ball = bumpy_ball(2)
    assert vertex_colours(ball) is None
    own = (
        np.random.default_rng(0).integers(0, 256, ball.vertices.shape).astype(np.uint8)
    )
    np.testing.assert_array_equal(
        vertex_colours(dataclasses.replace(ball, vertex_colours=own)), own
    )
    # The texture's left half is red and its right half green, its upper half brighter.
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:, :32, 0] = texture[:, 32:, 1] = 100
    texture[:32] *= 2
    right = ball.vertices[:, 0] > 0.0
    upper = ball.vertices[:, 2] > 0.0
    uv = np.column_stack([np.where(right, 0.75, 0.25), np.where(upper, 0.75, 0.25)])
    textured = dataclasses.replace(
        ball, own_texture=texture, corner_uv=uv[ball.faces].astype(np.float64)
    )
    found = vertex_colours(textured)
    assert found is not None
    level = np.where(upper, 200.0, 100.0)
    np.testing.assert_array_equal(found[:, 0], np.where(right, 0.0, level))
    np.testing.assert_array_equal(found[:, 1], np.where(right, level, 0.0))
