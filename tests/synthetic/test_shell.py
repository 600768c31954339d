"""The sea shell: a closed surface, wound right, with a pattern known everywhere."""

import numpy as np
import pytest

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface
from photoreg.synthetic.isosurface import gradient, surface_net
from photoreg.synthetic.noise import SolidNoise
from photoreg.synthetic.shell import (
    INSIDE,
    OUTSIDE,
    RIM,
    ShellForm,
    shell_field,
    shell_places,
    shell_surface,
)
from photoreg.synthetic.shell_pattern import PATTERNS, shell_albedo


@pytest.fixture(scope="module")
def shell() -> Mesh:
    return Mesh(*shell_surface(ShellForm(), 4_000))


def assert_closed_and_outward(mesh: Mesh) -> None:
    edges = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    forward = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    backward = edges[:, 1] * len(mesh.vertices) + edges[:, 0]
    # Each edge is walked once in each direction: closed, and turned one way.
    assert len(np.unique(forward)) == len(forward)
    np.testing.assert_array_equal(np.sort(forward), np.sort(backward))
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    assert np.einsum("nd,nd->n", a, np.cross(b, c)).sum() / 6.0 > 0.0


def test_the_net_of_a_ball_is_closed_outward_and_on_the_ball():
    center = np.array([0.3, -0.2, 0.5])
    vertices, faces = surface_net(
        lambda points: np.linalg.norm(points - center, axis=1) - 1.0,
        center - 1.3,
        center + 1.25,
        0.17,
    )
    assert_closed_and_outward(Mesh(vertices, faces))
    off = np.abs(np.linalg.norm(vertices - center, axis=1) - 1.0).max()
    assert off < 1e-3, off


def test_the_shell_is_closed_and_turned_outward(shell):
    assert_closed_and_outward(shell)
    assert len(shell.faces) == pytest.approx(4_000, abs=10)


@pytest.mark.slow
def test_a_shell_whose_sheets_meet_in_many_grids_is_closed_too():
    # The form of seed 3, which the first 16 grids pinch.
    form = ShellForm(
        growth=1.6682684922742057,
        drop=3.095510091488854,
        below=1.5247647376978832,
        ribs=15.0,
        rib_height=0.05854015288375166,
        cord_height=0.008617899009288853,
        flare=0.1518901986393951,
    )
    assert_closed_and_outward(Mesh(*shell_surface(form, 20_480)))


def test_the_shell_lies_on_its_field_and_its_normals_point_up_the_field(shell):
    off = np.abs(shell_field(shell.vertices, ShellForm()))
    # In units of the aperture's half width; the reduction moves vertices at edges.
    assert np.percentile(off, 95) < 0.02, np.percentile(off, 95)
    slope = gradient(
        lambda points: shell_field(points, ShellForm()), shell.vertices, 0.01
    )
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    cosines = np.einsum("nd,nd->n", slope, shell.vertex_normals)
    assert np.median(cosines) > 0.98, np.median(cosines)


def test_the_shell_has_an_outside_an_inside_and_a_lip(shell):
    layer = shell_places(shell.vertices, ShellForm())[:, 4]
    for code in (OUTSIDE, INSIDE, RIM):
        assert np.mean(layer == code) > 0.02, (code, np.mean(layer == code))


def test_whorls_shrink_to_the_apex_by_the_growth_factor(shell):
    form = ShellForm()
    _, along, _, size, layer, _ = shell_places(shell.vertices, form).T
    outside = layer == OUTSIDE
    # The size is the growth to the turns; growth lines lean by less than 0.17.
    turns = np.log(size[outside]) / np.log(form.growth)
    assert np.abs(turns - along[outside] / (2.0 * np.pi)).max() < 0.17 / 6.28
    assert size.min() < 0.1
    assert size.max() == pytest.approx(1.0, abs=0.3)


def test_the_pattern_is_colourful_and_scaled_by_contrast(shell):
    points = sample_surface(shell, 5_000, seed=0).points
    noise = SolidNoise(1)
    for pattern in PATTERNS:
        full = shell_albedo(points, ShellForm(), pattern, noise)
        faint = shell_albedo(points, ShellForm(), pattern, noise, contrast=0.25)
        assert full.min() > 0.0
        assert full.max() <= 0.95
        assert full.std(axis=0).min() > 0.1, full.std(axis=0)
        assert faint.std(axis=0) == pytest.approx(0.25 * full.std(axis=0), rel=0.1)
