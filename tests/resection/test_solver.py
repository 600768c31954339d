"""Cameras from clicked pairs: exact, noisy, with gross errors, degenerate, refused."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.geometry.rotations import rotation_matrices
from photoreg.resection import pinhole_model
from photoreg.resection.solver import (
    CLICK_SIGMA_PX,
    GUESSED_FOCAL_SIDES,
    GUESSED_FOCAL_SIGMA,
    PRINCIPAL_SIGMA_SIDES,
    Resection,
    solve_camera,
)
from tests.resection.naive_resection import refined_from_truth

W, H = 1024, 768


def a_camera(rng: np.random.Generator, off_centre_px: float = 0.0) -> Camera:
    """Looks at the cube of side 2 around the origin from 4 away, anyhow rolled."""
    direction = rng.normal(size=3)
    center = 4.0 * direction / np.linalg.norm(direction)
    up = rng.normal(size=3)
    camera = Camera.look_at(center, 0.1 * rng.normal(size=3), up, 1200.0, W, H)
    K = camera.K.copy()
    K[:2, 2] += off_centre_px * rng.uniform(-1.0, 1.0, 2)
    return dataclasses.replace(camera, K=K)


def some_points(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform(-1.0, 1.0, (n, 3))


def with_focal(camera: Camera, factor: float) -> Camera:
    """What EXIF would say: another focal length, no pose."""
    K = camera.K.copy()
    K[:2, :2] *= factor
    return Camera(K, np.eye(3), np.zeros(3), camera.width, camera.height)


def apart(first: Camera, second: Camera) -> float:
    """Largest difference of the projection matrices, relative."""
    return float(np.abs(first.P - second.P).max() / np.abs(second.P).max())


def error_px(found: Camera, true: Camera, places: np.ndarray) -> float:
    """Mean distance between the projections; a point behind is infinitely far."""
    distance = np.linalg.norm(found.project(places) - true.project(places), axis=1)
    return float(np.where(np.isnan(distance), np.inf, distance).mean())


@pytest.mark.parametrize("n", range(4, 13))
def test_exact_pairs_give_the_camera_exactly(n):
    for seed in range(8):
        rng = np.random.default_rng([n, seed])
        true = a_camera(rng, off_centre_px=20.0 if n >= 8 else 0.0)
        points = some_points(rng, n)
        prior = with_focal(true, 1.0 if n < 6 else 1.08)
        if n >= 8:
            prior = None
        solved = solve_camera(points, true.project(points), W, H, prior)
        off = apart(solved.camera, true)
        assert off < 1e-9, f"seed {seed}: P is off by {off:.2g}"
        assert solved.inliers.all()
        assert solved.rms_px < 1e-6, f"seed {seed}: rms {solved.rms_px:.2g} px"


def test_four_pairs_keep_the_priors_intrinsics():
    rng = np.random.default_rng(0)
    true, points = a_camera(rng), some_points(rng, 5)
    prior = with_focal(true, 1.05)
    for n in (4, 5):
        solved = solve_camera(points[:n], true.project(points[:n]), W, H, prior)
        np.testing.assert_allclose(solved.camera.K, prior.K, rtol=1e-12)
        assert solved.solved == "pose"


def test_what_is_solved_grows_with_the_pairs():
    rng = np.random.default_rng(1)
    true, points = a_camera(rng), some_points(rng, 9)
    pixels = true.project(points)
    solved = [solve_camera(points[:n], pixels[:n], W, H).solved for n in range(4, 10)]
    assert (
        solved
        == ["pose"] * 2
        + ["pose and focal length"] * 2
        + ["pose, focal length, principal point"] * 2
    )


@pytest.mark.parametrize("n", [6, 8, 12])
def test_noisy_pairs_give_what_least_squares_from_the_true_camera_gives(n):
    for seed in range(6):
        rng = np.random.default_rng([n, seed, 1])
        true, points = a_camera(rng, off_centre_px=5.0), some_points(rng, n)
        pixels = true.project(points) + rng.normal(size=(n, 2))
        expected = with_focal(true, GUESSED_FOCAL_SIDES * W / true.focal_px)
        K = expected.K.copy()
        K[:2, 2] = 0.5 * (W - 1), 0.5 * (H - 1)
        best = refined_from_truth(
            points,
            pixels,
            true,
            dataclasses.replace(expected, K=K),
            GUESSED_FOCAL_SIGMA,
            PRINCIPAL_SIGMA_SIDES * W,
            CLICK_SIGMA_PX,
            used=np.ones(n, dtype=bool),
        )
        solved = solve_camera(points, pixels, W, H)
        off = error_px(solved.camera, best, some_points(rng, 300))
        assert off < 1e-3, f"seed {seed}: {off:.2g} px from the least-squares camera"


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(6, 12), st.booleans())
def test_errors_of_clicks_stay_as_small_in_the_photo(seed, n, exif):
    rng = np.random.default_rng(seed)
    true, points = a_camera(rng, off_centre_px=5.0), some_points(rng, n)
    prior = with_focal(true, 1.05) if exif else None
    pixels = true.project(points) + rng.normal(size=(n, 2))
    solved = solve_camera(points, pixels, W, H, prior)
    off = error_px(solved.camera, true, points)
    assert off < 6.0, f"{off:.2f} px at the pairs"
    assert solved.inliers.all()
    assert solved.rms_px < 2.5, f"rms {solved.rms_px:.2f} px"


@pytest.mark.parametrize("exif", [False, True])
def test_two_gross_errors_of_eight_are_named_and_do_no_harm(exif):
    places = some_points(np.random.default_rng(0), 300)
    for seed in range(15):
        rng = np.random.default_rng([seed, 2])
        true, points = a_camera(rng, off_centre_px=5.0), some_points(rng, 8)
        pixels = true.project(points) + rng.normal(size=(8, 2))
        gross = np.sort(rng.permutation(8)[:2])
        angle = rng.uniform(0.0, 2.0 * np.pi, 2)
        far = rng.uniform(50.0, 200.0, (2, 1))
        pixels[gross] += far * np.column_stack([np.cos(angle), np.sin(angle)])
        solved = solve_camera(
            points, pixels, W, H, with_focal(true, 1.03) if exif else None
        )
        assert np.flatnonzero(~solved.inliers).tolist() == gross.tolist(), seed
        first, second = gross + 1
        named = f"Pairs {first} and {second} do not fit the others"
        assert named in solved.warnings[0], solved.warnings
        assert solved.worst in gross
        off = error_px(solved.camera, true, places)
        assert off < 12.0, f"seed {seed}: {off:.1f} px"


def test_one_gross_error_of_six_is_named_where_the_focal_length_is_known():
    for seed in range(10):
        rng = np.random.default_rng([seed, 3])
        true, points = a_camera(rng), some_points(rng, 6)
        pixels = true.project(points) + rng.normal(size=(6, 2))
        pixels[seed % 6] += (90.0, -60.0)
        solved = solve_camera(points, pixels, W, H, with_focal(true, 1.03))
        assert np.flatnonzero(~solved.inliers).tolist() == [seed % 6], seed
        assert solved.warnings[0].startswith(f"Pair {seed % 6 + 1} does not fit")


def test_clicks_that_are_all_bad_are_no_outliers():
    rng = np.random.default_rng(4)
    true, points = a_camera(rng), some_points(rng, 12)
    pixels = true.project(points) + 5.0 * rng.normal(size=(12, 2))
    solved = solve_camera(points, pixels, W, H)
    assert solved.inliers.all(), solved.warnings
    assert any("less well than careful clicks" in w for w in solved.warnings)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    st.integers(0, 10**6),
    st.sampled_from([1e-6, 1e-3, 1e3, 1e6]),
    st.sampled_from([0.0, 10.0, 1e5]),
)
def test_neither_units_nor_the_origin_matter(seed, unit, shift):
    rng = np.random.default_rng(seed)
    true, points = a_camera(rng), some_points(rng, 7)
    pixels = true.project(points) + rng.normal(size=(7, 2))
    move = shift * unit * np.array([1.0, -2.0, 0.5])
    plain = solve_camera(points, pixels, W, H)
    other = solve_camera(unit * points + move, pixels, W, H)
    off = np.abs(
        other.camera.project(unit * points + move) - plain.camera.project(points)
    )
    assert off.max() < 1e-4, f"{off.max():.2g} px"
    np.testing.assert_allclose(other.camera.K, plain.camera.K, rtol=1e-5)
    np.testing.assert_allclose(
        (other.camera.center - move) / unit, plain.camera.center, atol=1e-4
    )


def test_the_order_of_the_pairs_does_not_matter():
    rng = np.random.default_rng(6)
    true, points = a_camera(rng), some_points(rng, 8)
    pixels = true.project(points) + rng.normal(size=(8, 2))
    pixels[2] += 90.0
    order = rng.permutation(8)
    plain = solve_camera(points, pixels, W, H)
    other = solve_camera(points[order], pixels[order], W, H)
    assert apart(other.camera, plain.camera) < 1e-6
    np.testing.assert_array_equal(other.inliers, plain.inliers[order])


def test_same_pairs_same_camera_to_the_bit():
    rng = np.random.default_rng(7)
    true, points = a_camera(rng), some_points(rng, 15)
    pixels = true.project(points) + rng.normal(size=(15, 2))
    pixels[[3, 8]] += 70.0
    first, second = (solve_camera(points, pixels, W, H) for _ in range(2))
    np.testing.assert_array_equal(first.camera.P, second.camera.P)
    assert first.warnings == second.warnings


def test_aspect_and_skew_are_the_priors():
    rng = np.random.default_rng(8)
    true, points = a_camera(rng), some_points(rng, 9)
    K = true.K.copy()
    K[0, 1], K[1, 1] = 3.0, 1.02 * K[0, 0]
    true = dataclasses.replace(true, K=K)
    solved = solve_camera(points, true.project(points), W, H, with_focal(true, 1.1))
    assert apart(solved.camera, true) < 1e-9


def flat(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.column_stack([rng.uniform(-1.0, 1.0, (n, 2)), np.zeros(n)])


@pytest.mark.parametrize("n", [4, 6, 8])
def test_a_flat_target_seen_aslant_gives_its_camera(n):
    for seed in range(8):
        rng = np.random.default_rng([seed, n, 9])
        points = flat(rng, n)
        true = Camera.look_at((2.0, -1.0, 3.0), (0, 0, 0), (0, 1, 0), 1200.0, W, H)
        pixels = true.project(points)
        solved = solve_camera(points, pixels, W, H, with_focal(true, 1.0))
        off = np.abs(solved.camera.center - true.center).max()
        assert off < 1e-5, f"seed {seed}: centre off by {off:.2g}"


def test_a_flat_target_seen_face_on_keeps_the_expected_focal_length():
    rng = np.random.default_rng(10)
    true = Camera.look_at((0.0, 0.0, 4.0), (0, 0, 0), (0, 1, 0), 1200.0, W, H)
    for exif in (True, False):
        points = flat(rng, 6)
        pixels = true.project(points) + rng.normal(size=(6, 2))
        prior = with_focal(true, 1.02) if exif else None
        solved = solve_camera(points, pixels, W, H, prior)
        ratio = solved.camera.focal_px / true.focal_px
        assert 0.5 < ratio < 2.0, f"focal length {ratio:.2f} of the true one"
        assert error_px(solved.camera, true, points) < 3.0
        said = any("hardly determine the focal length" in w for w in solved.warnings)
        assert said == (not exif), solved.warnings


def test_the_foretold_error_is_about_the_error_made():
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 11])
        true, points = a_camera(rng), some_points(rng, 7)
        pixels = true.project(points) + CLICK_SIGMA_PX * rng.normal(size=(7, 2))
        places = some_points(rng, 300)
        solved = solve_camera(points, pixels, W, H, surface=places)
        offsets = solved.camera.project(places) - true.project(places)
        rms = np.sqrt((offsets**2).sum(axis=1).mean())
        ratios.append(rms / solved.expected_error_px)
    typical = float(np.sqrt(np.mean(np.square(ratios))))
    assert 0.6 < typical < 1.4, f"made over foretold: {typical:.2f}"


def test_all_clicked_points_end_in_front():
    for seed in range(20):
        rng = np.random.default_rng([seed, 12])
        true, points = a_camera(rng), some_points(rng, 4)
        pixels = true.project(points) + 3.0 * rng.normal(size=(4, 2))
        solved = solve_camera(points, pixels, W, H, with_focal(true, 1.0))
        assert np.isfinite(solved.residuals_px).all(), seed


def test_the_summary_and_the_first_words_are_plain():
    rng = np.random.default_rng(13)
    true, points = a_camera(rng), some_points(rng, 4)
    known = solve_camera(points, true.project(points), W, H, with_focal(true, 1.0))
    assert known.summary.startswith("Solved pose from 4 pairs: they fit to 0.0 px")
    assert any("add a fifth" in w for w in known.warnings)
    assert not any("guess" in w for w in known.warnings)
    guessed = solve_camera(points, true.project(points), W, H)
    assert any("focal length is a guess" in w for w in guessed.warnings)


def test_nonsense_pairs_are_refused_or_said_not_to_fit():
    rng = np.random.default_rng(14)
    for _ in range(5):
        points, pixels = some_points(rng, 8), rng.uniform(0, 700, (8, 2))
        try:
            solved = solve_camera(points, pixels, W, H)
        except InputError:
            continue
        assert solved.warnings, "random pairs passed without a word"


@pytest.mark.parametrize("exif", [False, True])
def test_four_pairs_that_fit_no_camera_are_said_not_to_fit(exif):
    # None can be left out: three always agree on some camera.
    for seed in range(5):
        rng = np.random.default_rng([seed, 16])
        true, points = a_camera(rng), some_points(rng, 4)
        pixels = rng.uniform(0, 700, (4, 2))
        try:
            solved = solve_camera(
                points, pixels, W, H, with_focal(true, 1.0) if exif else None
            )
        except InputError:
            continue
        assert solved.warnings, f"seed {seed}: passed without a word"


@pytest.mark.parametrize(
    ("n", "words"),
    [(0, "0 different pairs so far; 4 more"), (1, "3 more pairs are"), (3, "one more")],
)
def test_too_few_pairs_say_how_many_more(n, words):
    with pytest.raises(InputError, match=words):
        solve(np.arange(3.0 * n).reshape(n, 3) ** 2, np.arange(2.0 * n).reshape(n, 2))


def test_a_pair_given_twice_counts_once():
    rng = np.random.default_rng(15)
    true, points = a_camera(rng), some_points(rng, 5)
    twice = np.concatenate([points, points[:2]])
    with pytest.raises(InputError, match="3 different pairs so far; one more pair is"):
        solve(twice[[0, 1, 2, 5, 6]], true.project(twice)[[0, 1, 2, 5, 6]])
    solved = solve(twice, true.project(twice), with_focal(true, 1.0))
    assert solved.solved == "pose"
    assert apart(solved.camera, true) < 1e-9
    assert len(solved.residuals_px) == 7


def test_points_on_one_line_are_refused():
    rng = np.random.default_rng(16)
    true = a_camera(rng)
    along = np.linspace(-1.0, 1.0, 6)
    points = np.column_stack([along, 0.5 * along, 0.2 * along])
    with pytest.raises(InputError, match="surface lie on one line"):
        solve(points, true.project(points))
    pixels = np.column_stack([100.0 * along + 500.0, 50.0 * along + 300.0])
    with pytest.raises(InputError, match="photo lie on one line"):
        solve(some_points(rng, 6), pixels)


@pytest.mark.wrong_types
def test_what_is_not_finite_or_does_not_match_is_refused():
    rng = np.random.default_rng(17)
    points, pixels = some_points(rng, 6), rng.uniform(0.0, 700.0, (6, 2))
    broken = points.copy()
    broken[2, 1] = np.nan
    with pytest.raises(InputError, match="not finite"):
        solve(broken, pixels)
    with pytest.raises(InputError, match="6 surface points and 5 photo points"):
        solve(points, pixels[:5])
    with pytest.raises(InputError, match="shape"):
        solve(points, points)
    with pytest.raises(InputError, match="should be positive"):
        solve_camera(points, pixels, W, H, click_sigma_px=0.0)


def solve(points, pixels, prior=None) -> Resection:
    return solve_camera(points, pixels, W, H, prior)


def test_the_models_derivatives_are_its_differences():
    rng = np.random.default_rng(18)
    m = 5
    models = pinhole_model.Models(
        rotation_matrices(rng.normal(size=(m, 3))),
        rng.uniform(300.0, 600.0, (m, 2)),
        np.log(rng.uniform(100.0, 400.0, m)),
        np.log(rng.uniform(900.0, 2000.0, m)),
        rng.uniform(300.0, 600.0, (m, 2)),
    )
    X, A = 0.5 * some_points(rng, 6), np.array([[1.0, 0.01], [0.0, 1.03]])
    pixels, J = pinhole_model.project_with_derivatives(models, X, A, 1000.0)
    np.testing.assert_allclose(pixels, pinhole_model.project(models, X, A), rtol=1e-12)
    for k, h in itertools.product(range(pinhole_model.N_PARAMETERS), [1e-6]):
        step = np.zeros((m, pinhole_model.N_PARAMETERS))
        step[:, k] = h
        ahead = pinhole_model.project(models.moved(step, 1000.0), X, A)
        behind = pinhole_model.project(models.moved(-step, 1000.0), X, A)
        off = np.abs((ahead - behind) / (2.0 * h) - J[..., k]).max()
        assert off < 1e-3, f"parameter {k}: derivative off by {off:.2g} px"


def phone(rng: np.random.Generator, k1: float) -> tuple[Camera, np.ndarray]:
    """A camera with the lens of a phone, and points that fill its photo."""
    camera = a_camera(rng, off_centre_px=8.0)
    K = camera.K.copy()
    K[:2, :2] *= 800.0 / 1200.0
    camera = dataclasses.replace(camera, K=K, t_cam_world=0.72 * camera.t_cam_world)
    return camera.with_lens(Lens(k1=k1)), some_points(rng, 40)


@pytest.mark.parametrize("n", [8, 12])
def test_exact_pairs_give_the_lens_exactly(n):
    for seed, k1 in enumerate((-0.15, -0.05, 0.05)):
        true, points = phone(np.random.default_rng([n, seed, 7]), k1)
        points = points[:n]
        solved = solve_camera(points, true.project(points), W, H)
        assert solved.solved.endswith("lens"), (seed, solved.summary)
        assert solved.camera.lens.k1 == pytest.approx(k1, abs=1e-5)
        assert error_px(solved.camera, true, points) < 0.01


def test_a_lens_is_solved_as_well_as_it_says_and_only_where_it_shows():
    pulls, gains, kept = [], [], 0
    for seed in range(12):
        rng = np.random.default_rng([seed, 8])
        k1 = -0.12 if seed % 2 else 0.0
        true, points = phone(rng, k1)
        pairs = points[:16]
        pixels = true.project(pairs) + rng.normal(size=(16, 2))
        solved = solve_camera(pairs, pixels, W, H, surface=points)
        assert solved.k1 is not None
        assert solved.k1_error is not None
        pulls.append((solved.k1 - k1) / solved.k1_error)
        if k1 == 0.0:
            kept += not solved.camera.lens.is_ideal
            continue
        known = solve_camera(pairs, pixels, W, H, true.with_lens(Lens(k1=1e-12)))
        gains.append(
            error_px(known.camera, true, points) / error_px(solved.camera, true, points)
        )
        assert f"{solved.k1:.3f} ±" in solved.summary
    # Clicks are thought to be half again as bad as they are here.
    assert 0.2 < np.sqrt(np.mean(np.square(pulls))) < 1.5, pulls
    assert kept <= 1
    assert np.median(gains) > 1.5, gains


def test_a_lens_that_is_known_is_not_solved():
    true, points = phone(np.random.default_rng(3), -0.1)
    points = points[:10]
    solved = solve_camera(points, true.project(points), W, H, true)
    assert solved.k1 is None
    assert solved.camera.lens == true.lens
