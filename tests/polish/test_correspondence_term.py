"""Correspondences of two photos over the surface, and their term of the polish."""

import dataclasses

import numba
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import surface_views
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.increments import Increments
from photoreg.polish import correspondence_term
from photoreg.polish.correspondence_term import CorrespondenceTerm, extra_variance
from photoreg.polish.correspondences import find_correspondences
from photoreg.polish.levenberg_marquardt import Damping, Prior, minimise
from photoreg.polish.mesh_field import MeshField
from photoreg.polish.patch_kernels import HALF, SIDE, WINDOW_SIGMA, match_patches
from tests.polish_scene import make_polish_scene, projection_error_px

pytestmark = pytest.mark.workqueue

MIN_COSINE = 0.25


@pytest.fixture(scope="module")
def scene():
    return make_polish_scene(gain=0.85, offset=9.0)


def found(scene, cameras, own=0, photos=None, mesh=None):
    photos = scene.photos if photos is None else photos
    mesh = scene.mesh if mesh is None else mesh
    views = surface_views(mesh, cameras)
    sides = [(photos[i], views[i]) for i in (own, 1 - own)]
    return find_correspondences(mesh, sides[0], sides[1], 4000, MIN_COSINE)


def term_at(scene, cameras, mesh=None):
    mesh = scene.mesh if mesh is None else mesh
    first, second = (
        Increments(camera, mesh.centroid, PriorScales()) for camera in cameras
    )
    x = np.zeros(18)
    ways = (
        found(scene, cameras, 0, mesh=mesh),
        found(scene, cameras, 1, mesh=mesh),
    )
    size = (cameras[0].width, cameras[0].height)
    return (
        CorrespondenceTerm.measured(
            (0, 1), ways, (size, size), (first, second), x, 24.0, 1.0
        ),
        x,
    )


def nudged(scene, size):
    """Cameras about ``size`` px off the true ones."""
    rng = np.random.default_rng(5)
    moved = []
    for camera in scene.cameras:
        increments = Increments(camera, scene.mesh.centroid, PriorScales())
        moved.append(increments.camera(rng.normal(size=9) * size / 30.0))
    return moved


def test_at_the_true_cameras_each_patch_is_where_it_should_be(scene):
    way = found(scene, scene.cameras)
    assert len(way.points) > 250
    gap = np.linalg.norm(way.own_px - scene.cameras[0].project(way.points), axis=1)
    assert np.median(gap) < 0.04, np.median(gap)
    assert np.allclose(scene.cameras[1].project(way.points), way.other_px, atol=1e-6)


def test_shifts_tell_how_far_off_the_cameras_are(scene):
    """A match found with wrong cameras is a true pair of pixels all the same."""
    off = nudged(scene, 1.0)
    way = found(scene, off)
    shift = np.linalg.norm(way.own_px - off[0].project(way.points), axis=1)
    assert np.median(shift) > 0.3, np.median(shift)
    # Where the other photo's pixel meets the surface by the true cameras.
    center, rays = scene.cameras[1].rays(way.other_px)
    face, distance = scene.mesh.first_hits(np.broadcast_to(center, rays.shape), rays)
    hit = face >= 0
    points = center + distance[hit, None] * rays[hit]
    gap = np.linalg.norm(scene.cameras[0].project(points) - way.own_px[hit], axis=1)
    assert np.median(gap) < 0.06, np.median(gap)


def test_gain_and_offset_move_no_patch(scene):
    other = make_polish_scene(gain=1.0, offset=0.0)
    first, second = found(scene, scene.cameras), found(other, scene.cameras)
    assert abs(len(first.points) - len(second.points)) < 0.02 * len(first.points)
    places = {
        tuple(np.round(p, 6)): px
        for p, px in zip(second.points, second.own_px, strict=True)
    }
    gaps = [
        np.linalg.norm(px - places[key])
        for p, px in zip(first.points, first.own_px, strict=True)
        if (key := tuple(np.round(p, 6))) in places
    ]
    assert len(gaps) > 250
    # The rounding of bytes is another one.
    assert np.median(gaps) < 0.04, np.median(gaps)


def test_nothing_is_found_outside_of_either_mask(scene):
    for own in range(2):
        for masked in range(2):
            mask = np.zeros(scene.photos[masked].pixels.shape[:2], bool)
            mask[:, 190:] = True
            photos = list(scene.photos)
            photos[masked] = dataclasses.replace(photos[masked], mask=mask)
            way = found(scene, scene.cameras, own, photos)
            at = scene.cameras[masked].project(way.points)
            assert len(at) > 50
            assert at[:, 0].min() > 188.5, (own, masked, at[:, 0].min())


def naive_shift(template, target, column, row):
    """The shift of best weighted correlation, by a general optimiser."""
    ys, xs = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1]
    window = np.exp(-0.5 * (xs**2 + ys**2) / WINDOW_SIGMA**2)
    patch = template[row + ys, column + xs].astype(float)
    patch = patch - np.average(patch, weights=window)

    def unlike(shift):
        there = map_coordinates(
            target, [row + ys + shift[1], column + xs + shift[0]], order=3
        )
        there = there - np.average(there, weights=window)
        top = (window * patch * there).sum()
        return -top / np.sqrt((window * patch**2).sum() * (window * there**2).sum())

    return minimize(unlike, [0.0, 0.0], method="Nelder-Mead", tol=1e-6).x


def test_patches_are_found_where_a_general_optimiser_finds_them():
    rng = np.random.default_rng(3)
    ys, xs = np.mgrid[0:80, 0:80].astype(float)

    def picture(dx, dy):
        values = np.zeros((80, 80))
        waves = np.random.default_rng(8)
        for _ in range(12):
            u, v = waves.normal(size=2) * 0.35
            values += 12.0 * np.sin(
                u * (xs - dx) + v * (ys - dy) + waves.uniform(0, 6.3)
            )
        return values.astype(np.float32)

    template, target = picture(0.0, 0.0), 0.8 * picture(0.6, -0.35) + 7.0
    target = (target + rng.normal(size=target.shape)).astype(np.float32)
    centres = np.array([[20, 20], [40, 30], [33, 55], [60, 60], [25, 45]])
    rows = match_patches(
        template,
        target,
        np.ones((80, 80), bool),
        centres,
        np.zeros((5, 2)),
        20,
    )
    assert (rows[:, 2] > 0.9).all(), rows[:, 2]
    for (column, row), shift in zip(centres, rows[:, :2], strict=True):
        expected = naive_shift(template, target, column, row)
        assert np.abs(shift - expected).max() < 0.02, (shift, expected)
        assert np.abs(shift - [0.6, -0.35]).max() < 0.1


def test_a_patch_that_leaves_the_picture_is_not_found():
    picture = np.random.default_rng(0).normal(size=(40, 40)).astype(np.float32)
    rows = match_patches(
        picture,
        picture,
        np.ones((40, 40), bool),
        np.array([[2, 20], [20, 38], [20, 20], [20, 20]]),
        np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [np.nan, 0.0]]),
        5,
    )
    assert (rows[[0, 1, 3], 2] == -1.0).all()
    assert rows[2, 2] > 0.999
    assert SIDE == 2 * HALF + 1


def test_the_gradient_is_that_of_the_cost(scene):
    term, x = term_at(scene, nudged(scene, 1.0))
    rng = np.random.default_rng(1)
    for _ in range(4):
        at = x + 0.02 * rng.normal(size=18)
        model = term.linearise(at)
        direction = rng.normal(size=18)
        step = 1e-5
        slope = (
            term.linearise(at + step * direction).cost
            - term.linearise(at - step * direction).cost
        ) / (2.0 * step)
        expected = float(model.gradient @ direction)
        assert abs(slope - expected) < 1e-3 * abs(expected) + 1e-6, (slope, expected)


def test_the_term_alone_finds_the_cameras(scene):
    off = nudged(scene, 1.5)
    before = projection_error_px(scene.mesh, scene.cameras, off)
    prior = Prior(np.zeros(18), np.eye(18))
    term, x = term_at(scene, off)
    *_, last = minimise([prior, term.tempered(x)], x, Damping(max_iterations=10))
    cameras = [
        increments.camera(last.x[9 * i : 9 * i + 9])
        for i, increments in enumerate(term.increments)
    ]
    after = projection_error_px(scene.mesh, scene.cameras, cameras)
    assert before > 0.5, before
    assert after < 0.15, (before, after)


def test_the_meshs_own_error_is_told_in_the_models_units(scene):
    rng = np.random.default_rng(2)
    sigma = 0.01
    wrong = Mesh(
        scene.mesh.vertices
        + sigma
        * rng.normal(size=(len(scene.mesh.vertices), 1))
        * scene.mesh.vertex_normals,
        scene.mesh.faces,
    )
    exact, _ = term_at(scene, scene.cameras)
    told, _ = term_at(scene, scene.cameras, wrong)
    # Between vertices the errors of three are averaged.
    assert 0.3 * sigma < told.mesh_sigma < 1.2 * sigma, told.mesh_sigma
    assert exact.mesh_sigma < 0.2 * told.mesh_sigma, (exact.mesh_sigma, told.mesh_sigma)


def test_a_variance_is_recovered_from_medians():
    rng = np.random.default_rng(0)
    unit = rng.uniform(0.5, 2.0, 20_000)
    noise = rng.uniform(0.1, 1.0, 20_000)
    values = rng.normal(size=20_000) * np.sqrt(noise + 0.7 * unit)
    values[:600] = 50.0
    assert extra_variance(values**2, noise, unit) == pytest.approx(0.7, rel=0.15)
    small = 0.9 * rng.normal(size=20_000) * np.sqrt(noise)
    assert extra_variance(small**2, noise, unit) == 0.0


def test_the_number_of_threads_changes_no_bit(scene):
    before = numba.get_num_threads()
    answers = []
    try:
        for threads in {1, before}:
            numba.set_num_threads(threads)
            term, x = term_at(scene, nudged(scene, 1.0))
            answers.append(term.linearise(x))
    finally:
        numba.set_num_threads(before)
    for model in answers[1:]:
        assert np.array_equal(model.gradient, answers[0].gradient)
        assert np.array_equal(model.normal, answers[0].normal)


def test_a_wrong_mesh_moves_the_gradient_as_far_as_it_says(scene, monkeypatch):
    term, x = term_at(scene, scene.cameras)
    field = MeshField(0.002 * scene.mesh.diagonal, 0.1 * scene.mesh.diagonal)
    monkeypatch.setattr(correspondence_term, "fit_mesh_field", lambda *_: field)
    found_field, scatter = term.mesh_scatter(x)
    assert found_field is field
    points = np.concatenate([way.points for way in term.ways])
    covariance = field.covariance(points) + 1e-8 * field.sigma**2 * np.eye(len(points))
    factor = np.linalg.cholesky(covariance)
    still = term.linearise(x).gradient
    rng = np.random.default_rng(0)
    # So small that the robust cost stays a parabola.
    size, moves = 1e-3, []
    for _ in range(400):
        error = size * (factor @ rng.standard_normal(len(points)))
        parts = np.split(error, [len(term.ways[0].points)])
        ways = tuple(
            dataclasses.replace(
                way, own_px=way.own_px + part[:, None] * way.along_normal
            )
            for way, part in zip(term.ways, parts, strict=True)
        )
        moved = dataclasses.replace(term, ways=ways).linearise(x).gradient
        moves.append((moved - still) / size)
    seen = np.cov(np.array(moves).T, bias=True)
    values, vectors = np.linalg.eigh(scatter)
    for along in vectors.T[values > 1e-3 * values.max()]:
        ratio = np.sqrt((along @ seen @ along) / (along @ scatter @ along))
        assert 0.7 < ratio < 1.4, ratio


def test_too_few_cells_tell_nothing_of_the_mesh(scene):
    term, x = term_at(scene, scene.cameras)
    ways = tuple(
        dataclasses.replace(
            way,
            **{
                name: getattr(way, name)[:10]
                for name in (
                    "points",
                    "own_px",
                    "shifts_px",
                    "other_px",
                    "transfer",
                    "along_normal",
                    "covariance",
                )
            },
        )
        for way in term.ways
    )
    cells = tuple(cells[:10] for cells in term.cells)
    field, scatter = dataclasses.replace(term, ways=ways, cells=cells).mesh_scatter(x)
    assert field == MeshField(0.0, 0.0)
    assert not scatter.any()
