"""The photo pair's term: against its twin, finite differences, and its own noise."""

import dataclasses

import numba
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from photoreg.geometry.camera import Camera, reduced_size
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import surface_view
from photoreg.imaging.pairs import all_pairs
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.increments import Increments
from photoreg.polish.config import PolishConfig
from photoreg.polish.kernels import bilinear_at, colours_at, weighted_moments
from photoreg.polish.photometric_term import CUT, PairTerm, measure_noise, spread_pixels
from photoreg.polish.polish_cameras import _terms
from photoreg.synthetic.rough_cameras import rough_start
from tests.polish import naive_photometric_term
from tests.polish.naive_photometric_term import catmull_rom, pair_cost
from tests.polish_scene import make_polish_scene
from tests.scenes import small_scene


@pytest.fixture(scope="module")
def scene():
    return make_polish_scene(gain=0.85, offset=9.0)


@pytest.fixture(scope="module")
def term_and_x(scene):
    increments = tuple(
        Increments(camera, scene.mesh.centroid, PriorScales()) for camera in scene.rough
    )
    # Near the truth, where no point leaves a photo.
    x = np.concatenate(
        [inc.of_camera(c) for inc, c in zip(increments, scene.cameras, strict=True)]
    )
    x = x + 0.03 * np.random.default_rng(1).normal(size=18)
    sizes = [reduced_size(photo.width, photo.height, 2048) for photo in scene.photos]
    config = PolishConfig(
        blurs_px=(2.0,), points=(3000,), rounds=(1,), rim_reaches_px=(8.0,)
    )
    terms = _terms(
        scene.mesh,
        scene.photos,
        increments,
        x,
        sizes,
        0,
        config,
        0,
        all_pairs(2),
    )
    (pair,) = (term for term in terms if isinstance(term, PairTerm))
    return pair, x


def test_distance_to_jumps_of_depth_sees_one_surface_hide_another():
    # A wall, and before its left half a plate: they meet in the picture at x = 32.
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    wall = np.column_stack([60 * square - 30, np.full(4, 20.0)])
    plate = np.column_stack([30 * square - [30, 15], np.full(4, 10.0)])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    mesh = Mesh(np.vstack([wall, plate]), faces)
    K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
    view = surface_view(mesh, Camera(K, np.eye(3), np.zeros(3), 64, 48))
    assert view.covered.all()
    row = view.inner[24]
    assert row[32] == 0.0
    assert row[10] > 10.0
    assert row[54] > 10.0


def test_between_pixels_values_are_bilinear():
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 255, (20, 30, 3)).astype(np.float32)
    # Some lie beyond the border, whose values go on there.
    pixels = rng.uniform([-3.0, -3.0], [33.0, 23.0], (40, 5, 2))
    rows, columns = pixels[..., 1], pixels[..., 0]
    twin = np.stack(
        [
            map_coordinates(
                image[..., k].astype(float), [rows, columns], order=1, mode="nearest"
            )
            for k in range(3)
        ],
        axis=-1,
    )
    gap = np.abs(bilinear_at(image, pixels) - twin).max()
    assert gap < 1e-4, gap


def test_points_are_spread_evenly_over_what_is_seen():
    rows, columns = np.indices((300, 400))
    window = (rows - 150) ** 2 + (columns - 220) ** 2 < 110**2
    pixels, rank = spread_pixels(window, 5000, seed=3)
    assert 5000 <= len(pixels) < 6500
    assert rank.shape == (len(pixels),)
    assert abs(np.corrcoef(rank, pixels[:, 0])[0, 1]) < 0.05
    near = np.rint(pixels).astype(int)
    assert window[near[:, 1], near[:, 0]].all()
    counts = np.histogram2d(*pixels.T, bins=8, range=[[160, 280], [90, 210]])[0]
    # Independent draws would scatter by the root of the mean.
    assert counts.std() < 0.7 * np.sqrt(counts.mean()), counts


def test_a_pixel_more_or_less_leaves_the_other_points_where_they_are():
    rows, columns = np.indices((300, 400))
    window = (rows - 150) ** 2 + (columns - 220) ** 2 < 110**2
    less = window.copy()
    less[tuple(np.argwhere(window)[7])] = False
    before, after = (
        {tuple(row) for row in np.column_stack(spread_pixels(seen, 5000, seed=3))}
        for seen in (window, less)
    )
    assert after <= before
    assert len(before - after) <= 4


def test_distance_to_jumps_of_depth_leaves_a_steep_slope_alone():
    # Seen at 70 degrees, nearer to the view than the steepest points that count.
    turn = np.deg2rad(70.0)
    along = np.array([np.cos(turn), 0.0, np.sin(turn)])
    corners = np.array([[-9, -9], [9, -9], [9, 9], [-9, 9]], dtype=float)
    vertices = corners[:, :1] * along + corners[:, 1:] * [0, 1, 0] + [0, 0, 40]
    mesh = Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    K = np.array([[200.0, 0, 31.5], [0, 200.0, 31.5], [0, 0, 1]])
    view = surface_view(mesh, Camera(K, np.eye(3), np.zeros(3), 64, 64))
    middle = view.inner[31, 31]
    assert middle > 4.0, middle


def test_sampling_equals_its_twin():
    rng = np.random.default_rng(0)
    photo = rng.uniform(0, 255, (20, 30, 3)).astype(np.float32)
    pixels = rng.uniform(2.0, 17.0, (50, 2))
    twin = np.array([catmull_rom(photo, u, v) for u, v in pixels])
    gap = np.abs(colours_at(photo, pixels) - twin).max()
    assert gap < 1e-4, gap


def test_cost_equals_its_twin(term_and_x):
    term, x = term_and_x
    cameras = [
        inc.camera(x[9 * i : 9 * i + 9]) for i, inc in enumerate(term.increments)
    ]
    twin = pair_cost(
        term.surface,
        term.images,
        cameras,
        term.gain,
        term.offsets,
        term.sigma,
        np.minimum((term.sigma / np.maximum(term.tau, 1e-9)) ** 2, 1e12),
        CUT,
    )
    assert term.linearise(x).cost == pytest.approx(float(term.weight @ twin), rel=1e-4)


def test_gradient_is_the_finite_difference_of_the_cost(term_and_x):
    term, x = term_and_x
    model = term.linearise(x)
    assert model.cost == pytest.approx(term.linearise(x).cost, rel=1e-12)
    numeric = np.zeros(18)
    for j in range(18):
        step = np.zeros(18)
        step[j] = 1e-4
        numeric[j] = (
            term.linearise(x + step).cost - term.linearise(x - step).cost
        ) / 2e-4
    # The cells' offsets end after four passes, not quite at their minimum.
    gap = np.abs(model.gradient - numeric).max() / np.abs(numeric).max()
    assert gap < 2e-2, gap


def test_normal_matrix_is_symmetric_and_not_negative(term_and_x):
    term, x = term_and_x
    normal = term.linearise(x).normal
    assert np.array_equal(normal, normal.T)
    values = np.linalg.eigvalsh(normal)
    assert values[0] > -1e-9 * values[-1], values


def test_both_cameras_sliding_together_cost_nothing_in_the_normal_matrix(term_and_x):
    # A flat normal matrix along a common world motion needs slopes shared on the
    # surface; with slopes of each photo its noise would look like curvature.
    term, x = term_and_x
    normal = term.linearise(x).normal
    values = np.linalg.eigvalsh(normal)
    assert values[0] < 1e-3 * values[-1], values


def test_measure_noise_finds_exposure_and_noise():
    rng = np.random.default_rng(0)
    starts = np.arange(0, 20_001, 100)
    truth = rng.normal(100.0, 30.0, (20_000, 3))
    light = np.repeat(rng.normal(0.0, 3.0, (200, 3)), 100, axis=0)
    values = np.stack([truth, 0.8 * truth + 5.0], axis=1)
    values += rng.normal(0.0, 1.0, values.shape)
    values[:, 1] += light
    flat = np.tile([0.0, 0.0, 1.0], (len(values), 1, 1))
    gain, _, sigma, tau = measure_noise(values, starts, flat)
    root = np.sqrt(0.8)
    assert np.abs(gain - root).max() < 0.005, gain
    expected = np.sqrt(root**2 + 1.0 / root**2)
    assert np.abs(sigma / expected - 1.0).max() < 0.03, (sigma, expected)
    assert np.abs(tau / (3.0 / root) - 1.0).max() < 0.25, tau


def test_sums_do_not_depend_on_the_number_of_threads(term_and_x):
    term, x = term_and_x
    threads = numba.get_num_threads()
    first = term.linearise(x)
    try:
        numba.set_num_threads(1)
        second = term.linearise(x)
    finally:
        numba.set_num_threads(threads)
    assert first.cost == second.cost
    assert np.array_equal(first.normal, second.normal)
    assert np.array_equal(first.gradient, second.gradient)


def test_weighted_moments_equal_their_twin():
    rng = np.random.default_rng(9)
    arguments = rng.normal(size=(500, 5)), rng.normal(size=500), rng.random(500)
    for ours, twin in zip(
        weighted_moments(*arguments),
        naive_photometric_term.weighted_moments(*arguments),
        strict=True,
    ):
        np.testing.assert_allclose(ours, twin, rtol=1e-10, atol=1e-10)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("seed", [0, 3, 5, 7])
def test_terms_that_would_go_astray_alone_are_weighted_all_the_same(seed):
    """Far off, a term's own step would take the focal length to 1e26 px."""
    scene = small_scene()
    start = rough_start(scene.true_mesh, scene.cameras, (34.0, 150.0), seed)
    scales = PriorScales(*(2.7 * one for one in dataclasses.astuple(PriorScales())))
    increments = tuple(
        Increments(camera, scene.mesh.centroid, scales) for camera in start
    )
    x, sizes = np.zeros(18), [(320, 240)] * 2
    terms = _terms(
        scene.mesh,
        scene.photos,
        increments,
        x,
        sizes,
        0,
        PolishConfig(),
        0,
        all_pairs(2),
    )
    assert terms
    for term in terms:
        sure = dataclasses.replace(term, weight=1e6 * term.weight).tempered(x)
        assert np.isfinite(sure.weight).all()
        assert np.isfinite(sure.scatter(x)).all()
