"""Surfaces that can move along themselves."""

import numpy as np
import trimesh

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.slippage import slippable_motions, slippage_words
from tests.polish_scene import bumpy_ball


def turned_on_a_lathe():
    """A vase, open at the top, its axis neither through the origin nor along an axis."""
    angles = np.linspace(0.0, 2.0 * np.pi, 97)[:-1]
    heights = np.linspace(0.0, 2.0, 60)
    radii = 0.6 + 0.2 * np.sin(3.0 * heights)
    x = radii[:, None] * np.cos(angles)
    y = radii[:, None] * np.sin(angles)
    z = np.broadcast_to(heights[:, None], x.shape)
    n = len(angles)
    row, column = np.meshgrid(np.arange(59), np.arange(n), indexing="ij")
    a, b = row * n + column, row * n + (column + 1) % n
    faces = np.concatenate(
        [
            np.stack([a, b, a + n], -1).reshape(-1, 3),
            np.stack([b, b + n, a + n], -1).reshape(-1, 3),
        ]
    )
    R = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, -1.0])[:3, :3]
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    return Mesh(40.0 * points @ R.T + [3.0, -70.0, 11.0], faces), R[:, 2]


def test_a_vase_turns_about_its_axis_and_no_other():
    vase, axis = turned_on_a_lathe()
    (motion,) = slippable_motions(vase)
    turn = motion[:3] / np.linalg.norm(motion[:3])
    assert abs(turn @ axis) > 0.999, turn
    (sentence,) = slippage_words(vase)
    assert "turned about its axis" in sentence


def test_a_bumpy_ball_is_not_round_and_a_smooth_one_is():
    assert slippage_words(bumpy_ball()) == ()
    ball = trimesh.creation.icosphere(subdivisions=4)
    smooth = Mesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    assert len(slippable_motions(smooth)) == 3
    assert "more than one axis" in slippage_words(smooth)[0]
