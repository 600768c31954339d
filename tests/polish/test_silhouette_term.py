"""The rim of a mesh and the photo's edges."""

import dataclasses

import numpy as np
import pytest

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import surface_view
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.increments import Increments
from photoreg.polish.mesh_field import MeshField
from photoreg.polish.silhouette_term import (
    SEGMENT_POINTS,
    RimTerm,
    find_edges,
    find_rim,
)
from tests.polish_scene import make_polish_scene


@pytest.fixture(scope="module")
def scene():
    return make_polish_scene()


def test_the_rim_is_where_the_surface_turns_away(scene):
    view = surface_view(scene.mesh, scene.cameras[0])
    rim = find_rim(scene.mesh, view, 400)
    assert len(rim.points) > 200
    gap = np.abs(scene.cameras[0].project(rim.points) - rim.pixels).max()
    assert gap < 0.1, gap
    # A ray just inside meets the mesh, one just outside does not.
    for shift, expected in ((-0.1, True), (0.1, False)):
        origin, rays = scene.cameras[0].rays(rim.pixels + shift * rim.normals)
        faces, _ = scene.mesh.first_hits(np.broadcast_to(origin, rays.shape), rays)
        share = np.mean((faces >= 0) == expected)
        assert share > 0.97, (shift, share)


def test_a_rim_that_is_longer_by_a_pixel_has_the_same_points_elsewhere(scene):
    view = surface_view(scene.mesh, scene.cameras[0])
    rim = find_rim(scene.mesh, view, 400)
    assert rim.stride_px > 1
    # The first pixel of the outline, from which it is followed.
    row, column = np.argwhere(view.covered)[0]
    covered = view.covered.copy()
    covered[row - 1, column] = True
    other = find_rim(scene.mesh, dataclasses.replace(view, covered=covered), 400)
    gaps = np.abs(rim.pixels[:, None] - other.pixels[None]).max(axis=2).min(axis=1)
    changed = rim.pixels[gaps > 0.0]
    # As far as the outline is blurred for its normals.
    assert np.abs(changed - (column, row)).max() < 10.0
    assert len(changed) < 0.1 * len(rim.pixels)


def test_a_border_of_the_mesh_is_no_rim():
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), -1).reshape(-1, 2)
    a = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate(
        [np.column_stack([a, a + 1, a + 9]), np.column_stack([a + 1, a + 10, a + 9])]
    )
    sheet = Mesh(np.column_stack([grid, np.zeros(81)]), faces)
    camera = Camera.look_at([4, 4, -20], [4, 4, 0], [0, -1, 0], 300, 200, 200)
    view = surface_view(sheet, camera)
    assert view.covered.sum() > 1000
    assert len(find_rim(sheet, view, 200).points) == 0


def test_edges_of_the_true_camera_are_on_the_rim(scene):
    view = surface_view(scene.mesh, scene.cameras[0])
    rim = find_rim(scene.mesh, view, 400)
    offset = find_edges(scene.photos[0], view, rim, 6.0).offset_px
    assert np.isfinite(offset).mean() > 0.8
    assert abs(np.nanmedian(offset)) < 0.1, np.nanmedian(offset)


def test_edges_of_a_shifted_camera_show_the_shift(scene):
    camera = scene.cameras[0]
    K = camera.K.copy()
    K[0, 2] += 4.0
    view = surface_view(scene.mesh, dataclasses.replace(camera, K=K))
    rim = find_rim(scene.mesh, view, 400)
    offset = find_edges(scene.photos[0], view, rim, 10.0).offset_px
    gap = np.nanmedian(np.abs(offset + 4.0 * rim.normals[:, 0]))
    assert gap < 0.4, gap


@pytest.fixture(scope="module")
def term_and_x(scene):
    camera = scene.cameras[0]
    view = surface_view(scene.mesh, camera)
    rim = find_rim(scene.mesh, view, 400)
    edges = find_edges(scene.photos[0], view, rim, 6.0)
    increments = Increments(camera, scene.mesh.centroid, PriorScales())
    size = (camera.width, camera.height)
    term = RimTerm.measured(0, rim, edges, size, increments, 0.5, 0.5)
    assert term is not None
    return term, 0.05 * np.random.default_rng(0).normal(size=9)


def test_gradient_is_the_finite_difference_of_the_cost(term_and_x):
    term, x = term_and_x
    model = term.linearise(x)
    assert model.cost == pytest.approx(term.linearise(x).cost, rel=1e-12)
    numeric = np.zeros(9)
    for j in range(9):
        step = np.zeros(9)
        step[j] = 1e-5
        numeric[j] = (
            term.linearise(x + step).cost - term.linearise(x - step).cost
        ) / 2e-5
    # The offsets end after six passes, not quite at their minimum.
    gap = np.abs(model.gradient - numeric).max() / np.abs(numeric).max()
    assert gap < 2e-2, gap


def test_an_edge_that_is_not_found_changes_its_own_segment_only(scene):
    camera = scene.cameras[0]
    view = surface_view(scene.mesh, camera)
    rim = find_rim(scene.mesh, view, 400)
    edges = find_edges(scene.photos[0], view, rim, 6.0)
    lost = edges.offset_px.copy()
    lost[np.flatnonzero(np.isfinite(lost))[5]] = np.nan
    increments = Increments(camera, scene.mesh.centroid, PriorScales())
    size = (camera.width, camera.height)
    with_it, without = (
        RimTerm.measured(0, rim, found, size, increments, 0.5, 0.5)
        for found in (edges, dataclasses.replace(edges, offset_px=lost))
    )
    assert with_it is not None
    assert without is not None
    counts, fewer = (
        {
            tuple(cell): n
            for cell, n in zip(
                term.cells.tolist(), np.diff(term.cell_starts), strict=True
            )
        }
        for term in (with_it, without)
    )
    changed = [cell for cell, n in counts.items() if fewer.get(cell, 0) != n]
    assert len(changed) == 1
    mean = len(with_it.edges) / len(with_it.cells)
    assert 0.7 * SEGMENT_POINTS < mean < 1.4 * SEGMENT_POINTS, mean


def test_normal_matrix_is_symmetric_and_not_negative(term_and_x):
    term, x = term_and_x
    normal = term.linearise(x).normal
    values = np.linalg.eigvalsh(0.5 * (normal + normal.T))
    assert np.abs(normal - normal.T).max() < 1e-9 * values[-1]
    assert values[0] > -1e-9 * values[-1], values


def test_no_edge_is_found_where_the_photo_does_not_count(scene):
    view = surface_view(scene.mesh, scene.cameras[0])
    rim = find_rim(scene.mesh, view, 400)
    photo = scene.photos[0]
    middle = photo.width // 2
    left = np.zeros((photo.height, photo.width), dtype=bool)
    left[:, :middle] = True
    edges = find_edges(dataclasses.replace(photo, mask=left), view, rim, 6.0)
    at = rim.pixels[:, 0] + edges.offset_px * rim.normals[:, 0]
    assert np.nanmax(at) <= middle + 1.5
    assert np.isfinite(edges.offset_px[rim.pixels[:, 0] < middle - 10]).mean() > 0.8
    assert not edges.counts[rim.pixels[:, 0] > middle + 10].any()
    none = dataclasses.replace(photo, mask=np.zeros_like(left))
    assert np.isnan(find_edges(none, view, rim, 6.0).offset_px).all()


def test_the_rim_of_a_photo_that_is_cut_out_is_found_on_the_border_of_its_mask(scene):
    view = surface_view(scene.mesh, scene.cameras[0])
    rim = find_rim(scene.mesh, view, 400)
    cut = dataclasses.replace(scene.photos[0], mask=view.covered)
    offset = find_edges(cut, view, rim, 6.0).offset_px
    assert np.isfinite(offset).mean() > 0.8
    assert abs(np.nanmedian(offset)) < 0.2, np.nanmedian(offset)


def test_a_wrong_mesh_moves_the_gradient_as_far_as_it_says(scene):
    camera = scene.cameras[0]
    view = surface_view(scene.mesh, camera)
    rim = find_rim(scene.mesh, view, 800)
    increments = Increments(camera, scene.mesh.centroid, PriorScales())
    edges = find_edges(scene.photos[0], view, rim, 6.0)
    size_px = (camera.width, camera.height)
    term = RimTerm.measured(0, rim, edges, size_px, increments, 1.0, 0.5)
    assert term is not None
    x = np.zeros(increments.n)
    field = MeshField(0.001 * scene.mesh.diagonal, 0.1 * scene.mesh.diagonal)
    scatter = term.mesh_scatter(x, field)
    points = term.rim.points
    covariance = field.covariance(points) + 1e-8 * field.sigma**2 * np.eye(len(points))
    factor = np.linalg.cholesky(covariance)
    px_per_unit = camera.focal_px / camera.to_camera(points)[:, 2]
    still = term.linearise(x).gradient
    rng = np.random.default_rng(0)
    size, moves = 1e-3, []
    for _ in range(400):
        error_px = size * (factor @ rng.standard_normal(len(points))) * px_per_unit
        moved = term.edges + error_px[:, None] * term.rim.normals
        gradient = dataclasses.replace(term, edges=moved).linearise(x).gradient
        moves.append((gradient - still) / size)
    seen = np.cov(np.array(moves).T, bias=True)
    values, vectors = np.linalg.eigh(scatter)
    for along in vectors.T[values > 0.05 * values.max()]:
        ratio = np.sqrt((along @ seen @ along) / (along @ scatter @ along))
        assert 0.6 < ratio < 1.5, ratio
