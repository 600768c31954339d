"""Colours spread over a mesh, against the exact solution."""

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
import trimesh

from photoreg.texture.fill_unseen import spread


@pytest.fixture(scope="module")
def ball():
    return trimesh.creation.icosphere(subdivisions=5)


def painted(ball) -> tuple[np.ndarray, np.ndarray]:
    """Colours at a third of the vertices, which lie together."""
    x, y, z = ball.vertices.T
    red, green, blue = np.sin(6.0 * y), np.cos(9.0 * z), np.sin(4.0 * x + 5.0 * z)
    return 128.0 + 100.0 * np.column_stack([red, green, blue]), x > 0.3


def solved(faces, colours, known) -> np.ndarray:
    """Each unknown vertex the mean of its neighbours, by elimination."""
    n = len(colours)
    rows = np.concatenate([faces[:, 0], faces[:, 1], faces[:, 2]])
    columns = np.concatenate([faces[:, 1], faces[:, 2], faces[:, 0]])
    # On a closed surface each edge runs once in either direction.
    graph = scipy.sparse.csr_array((np.ones(len(rows)), (rows, columns)), (n, n))
    laplacian = scipy.sparse.csr_array(
        scipy.sparse.diags_array(graph.sum(axis=1)) - graph
    )
    inner = scipy.sparse.csc_array(laplacian[~known][:, ~known])
    pull = graph[~known][:, known] @ colours[known]
    exact = colours.copy()
    exact[~known] = scipy.sparse.linalg.splu(inner).solve(pull)
    return exact


def test_what_is_unknown_becomes_the_mean_of_its_neighbours(ball):
    colours, known = painted(ball)
    found = spread(ball.vertices, ball.faces, colours, known)
    error = np.abs(found - solved(ball.faces, colours, known))
    # Of 255 levels; the known colours differ by 200. Observed 1.2 and 4.3.
    assert error.mean() < 2.5, error.mean()
    assert error.max() < 9.0, error.max()
    np.testing.assert_array_equal(found[known], colours[known])


def test_no_colour_appears_that_is_not_between_the_known(ball):
    colours, known = painted(ball)
    colours[~known] = 1e6
    found = spread(ball.vertices, ball.faces, colours, known)
    assert (found.min(axis=0) >= colours[known].min(axis=0) - 1e-9).all()
    assert (found.max(axis=0) <= colours[known].max(axis=0) + 1e-9).all()


def test_a_part_without_known_vertices_takes_the_colours_beside_it(ball):
    n = len(ball.vertices)
    vertices = np.vstack([ball.vertices, 0.1 * ball.vertices + [0.0, 1.2, 0.0]])
    faces = np.vstack([ball.faces, ball.faces + n])
    colours, known = painted(ball)
    found = spread(
        vertices,
        faces,
        np.vstack([colours, np.zeros_like(colours)]),
        np.r_[known, np.zeros(n, bool)],
    )
    near = np.linalg.norm(ball.vertices - [0.0, 1.0, 0.0], axis=1) < 0.3
    assert (found[n:] >= found[:n][near].min(axis=0)).all()
    assert (found[n:] <= found[:n][near].max(axis=0)).all()


def test_vertices_of_no_face_and_all_known_are_no_trouble(ball):
    vertices = np.vstack([ball.vertices, [[9.0, 9.0, 9.0]]])
    colours = np.full((len(vertices), 3), 7.0)
    for known in (np.ones(len(vertices), bool), np.arange(len(vertices)) == 5):
        found = spread(vertices, ball.faces, colours, known)
        np.testing.assert_allclose(found, 7.0)
