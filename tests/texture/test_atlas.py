"""Layouts of texture charts: every face somewhere, no two at one place."""

import dataclasses

import numpy as np
import pytest
import trimesh

from photoreg.geometry.mesh import Mesh
from photoreg.texture.atlas import make_atlas
from photoreg.texture.charts import face_neighbours
from tests.painted import ball_and_moon


def helix() -> Mesh:
    """A ramp of three turns, seen from above one over the other."""
    turn = np.linspace(0, 6 * np.pi, 240)
    rail = np.column_stack([np.cos(turn), np.sin(turn), 0.08 * turn])
    vertices = np.vstack([rail * [0.5, 0.5, 1.0], rail])
    i = np.arange(239)
    faces = np.vstack(
        [np.column_stack([i, i + 240, i + 241]), np.column_stack([i, i + 241, i + 1])]
    )
    return Mesh(vertices, faces)


def areas(corner_uv: np.ndarray) -> np.ndarray:
    ab, ac = corner_uv[:, 1] - corner_uv[:, 0], corner_uv[:, 2] - corner_uv[:, 0]
    return 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def overlap(atlas) -> float:
    """Share of the charts' area that lies on other charts."""
    covered = (atlas.faces_at_texels(2048, 2048) >= 0).mean()
    return areas(atlas.uv[atlas.uv_faces]).sum() / covered - 1.0


@pytest.mark.parametrize("shape", [ball_and_moon, helix])
def test_charts_do_not_lie_on_each_other(shape):
    atlas = make_atlas(shape())
    assert atlas.uv.min() >= 0.0
    assert atlas.uv.max() <= 1.0
    assert abs(overlap(atlas)) < 0.01, overlap(atlas)


def test_charts_stretch_no_face_by_much():
    mesh = ball_and_moon()
    atlas = make_atlas(mesh)
    density = areas(atlas.uv[atlas.uv_faces]) / mesh.face_areas
    density /= density.max()
    # A face projected along the nearest of six axes keeps 0.58 of its area or more;
    # its neighbours' axis is kept down to 0.25.
    assert density.min() > 0.2, density.min()
    assert np.median(density) > 0.6, np.median(density)


def test_coordinates_belong_to_the_vertices_of_their_faces():
    mesh = ball_and_moon(3)
    atlas = make_atlas(mesh)
    vertex = atlas.uv_vertex[atlas.uv_faces]
    np.testing.assert_array_equal(mesh.vertices[vertex], mesh.vertices[mesh.faces])


def test_a_face_without_area_is_not_drawn_across_the_charts():
    ball = trimesh.creation.icosphere(subdivisions=3)
    # Slivers between far vertices: all on a line, and twice the same vertex.
    middle = 0.5 * (ball.vertices[0] + ball.vertices[100])
    vertices = np.vstack([ball.vertices, middle])
    slivers = [[0, 100, len(ball.vertices)], [5, 5, 200], [7, 300, 300]]
    mesh = Mesh(vertices, np.vstack([ball.faces, slivers]))
    atlas = make_atlas(mesh)
    assert areas(atlas.uv[atlas.uv_faces])[-3:].max() < 1e-6
    assert abs(overlap(atlas)) < 0.01, overlap(atlas)


def test_neighbours_are_across_each_edge_and_mutual():
    #  0---1    Face 0 and 1 share edge 1-2; three faces share edge 0-1.
    #  | / |
    #  2---3
    faces = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 0, 5]])
    expected = [[-1, 1, -1], [0, -1, -1], [-1, -1, -1], [-1, -1, -1]]
    np.testing.assert_array_equal(face_neighbours(faces), expected)


def test_vertices_that_share_a_place_have_coordinates_of_their_own():
    mesh = ball_and_moon(2)
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    soup = Mesh(corners, np.arange(len(corners)).reshape(-1, 3))
    atlas = make_atlas(soup)
    np.testing.assert_array_equal(atlas.uv_vertex[atlas.uv_faces], soup.faces)
    assert abs(overlap(atlas)) < 0.01, overlap(atlas)


@pytest.mark.parametrize("lost", [1, 400])
def test_a_layout_without_a_place_for_some_faces_is_made_anew_and_named(lost):
    mesh = ball_and_moon(2)
    plain = make_atlas(mesh)
    uv = plain.uv[plain.uv_faces].copy()
    assert make_atlas(dataclasses.replace(mesh, corner_uv=uv)).is_own
    uv[:lost] = 0.0
    atlas = make_atlas(dataclasses.replace(mesh, corner_uv=uv))
    assert not atlas.is_own
    assert atlas.why_anew == f"has no place for {lost} of its {len(mesh.faces)} faces"
    assert areas(atlas.uv[atlas.uv_faces]).min() > 0.0


def test_a_face_without_area_needs_no_place_in_a_layout():
    mesh = ball_and_moon(2)
    plain = make_atlas(mesh)
    uv = plain.uv[plain.uv_faces]
    sliver = Mesh(
        mesh.vertices,
        np.vstack([mesh.faces, [[5, 5, 9]]]),
        np.concatenate([uv, np.zeros((1, 3, 2))]),
    )
    assert make_atlas(sliver).is_own
