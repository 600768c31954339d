"""The last stage of the polish: correspondences, then all terms by what they know."""

import dataclasses

import numba
import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.mesh import Mesh
from photoreg.parameters.freedom import Freedom, Held
from photoreg.polish.config import PolishConfig
from photoreg.polish.disagreement import Disagreement, MeshError
from photoreg.polish.polish_cameras import is_no_worse, polish_cameras
from photoreg.polish.uncertainty import estimate_uncertainty
from tests.polish_scene import make_polish_scene, projection_error_px

pytestmark = pytest.mark.workqueue

FINE = PolishConfig(
    blurs_px=(2.0, 0.5),
    points=(4000, 8000),
    rounds=(2, 1),
    rim_reaches_px=(12.0, 5.0),
)
WITHOUT = dataclasses.replace(FINE, use_correspondences=False)


def ends(scene, config, **options):
    steps = list(
        polish_cameras(
            scene.mesh, scene.photos, scene.rough, scene.rough, config, **options
        )
    )
    return steps, projection_error_px(scene.mesh, scene.cameras, steps[-1].cameras)


@pytest.fixture(scope="module")
def scene():
    return make_polish_scene(gain=0.85, offset=9.0)


@pytest.fixture(scope="module")
def nearby(scene):
    """Within the reach of two levels."""
    rng = np.random.default_rng(9)
    rough = []
    for camera in scene.cameras:
        K = camera.K.copy()
        K[:2, 2] += rng.normal(size=2)
        rough.append(
            dataclasses.replace(
                camera,
                K=K,
                t_cam_world=camera.t_cam_world + 0.01 * rng.normal(size=3),
            )
        )
    return dataclasses.replace(scene, rough=tuple(rough))


@pytest.fixture(scope="module")
def polished(nearby):
    return ends(nearby, FINE)


def test_it_is_as_exact_as_colours_are_at_their_best(nearby, polished):
    """Exact mesh, one light: nothing speaks against colours here."""
    steps, after = polished
    assert steps[-1].level == steps[-1].n_levels - 1 == 2
    assert steps[-1].mesh_error is not None
    # Worst observed 0.040; colours alone end 0.036 px off.
    assert after < 0.07, after


@pytest.mark.slow
def test_on_wrong_meshes_it_is_better_on_the_whole(nearby):
    before, after = [], []
    for seed in range(3):
        noise = 0.006 * np.random.default_rng(seed).normal(
            size=(len(nearby.mesh.vertices), 1)
        )
        wrong = Mesh(
            nearby.mesh.vertices + noise * nearby.mesh.vertex_normals,
            nearby.mesh.faces,
        )
        scene = dataclasses.replace(nearby, mesh=wrong)
        before.append(ends(scene, WITHOUT)[1])
        steps, error = ends(scene, FINE)
        after.append(error)
        told = estimate_uncertainty(wrong, steps[-1]).expected_error_px
        assert error < 2.0 * told, (seed, error, told)
        mesh_error = steps[-1].mesh_error
        assert mesh_error is not None
        assert 0.3 * 0.006 < mesh_error.sigma < 1.2 * 0.006, (seed, mesh_error)
    assert np.mean(after) < np.mean(before), (before, after)


def test_its_last_step_tells_how_sure_it_is(nearby, polished):
    steps, after = polished
    assert steps[-1].scatter is not None
    told = estimate_uncertainty(nearby.mesh, steps[-1]).expected_error_px
    assert after < 2.5 * told, (after, told)
    assert told < 0.2, told


def test_the_meshs_error_is_told_in_its_units_and_in_pixels():
    assert MeshError(sigma=0.4123, sigma_px=0.83).in_words(diagonal=824.6) == (
        "Scan and photos disagree by about 0.41 of the scan's units along the surface's "
        "normal, 0.05 % of its diagonal, or 0.83 px in the photos."
    )
    in_mm = MeshError(sigma=0.4123, sigma_px=0.83).in_words(824.6, "mm")
    assert "by about 0.41 mm along the surface's normal" in in_mm
    exact = MeshError(sigma=1e-4, sigma_px=0.01)
    assert exact.in_words(824.6) == "Scan and photos agree to less than 0.05 px."


def test_held_numbers_stay_to_the_last_bit(nearby):
    held = Freedom((Held(focal=True, principal_point=True), Held(pose=True)))
    steps, _ = ends(nearby, FINE, freedom=held)
    first, second = steps[-1].cameras
    assert np.array_equal(first.K, nearby.rough[0].K)
    assert np.array_equal(second.R_cam_world, nearby.rough[1].R_cam_world)
    assert np.array_equal(second.t_cam_world, nearby.rough[1].t_cam_world)
    assert not np.array_equal(first.t_cam_world, nearby.rough[0].t_cam_world)


def test_photos_that_match_nowhere_end_as_without_it(nearby):
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, nearby.photos[1].pixels.shape, dtype=np.uint8)
    photos = (nearby.photos[0], dataclasses.replace(nearby.photos[1], pixels=noise))
    lost = dataclasses.replace(nearby, photos=photos)
    short = dataclasses.replace(FINE, extra_rounds=0)
    steps, _ = ends(lost, short)
    without, _ = ends(lost, dataclasses.replace(short, use_correspondences=False))
    assert np.array_equal(steps[-1].x, without[-1].x)
    assert steps[-1].level == steps[-1].n_levels - 1
    assert steps[-1].mesh_error is None


def test_three_photos_are_matched_in_pairs():
    scene = make_polish_scene(n_photos=3)
    steps, after = ends(dataclasses.replace(scene, rough=scene.cameras), FINE)
    assert steps[-2].mesh_error is not None
    assert after < 0.1, after


def test_the_number_of_threads_changes_no_bit(nearby, polished):
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        steps, _ = ends(nearby, FINE)
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(steps[-1].x, polished[0][-1].x)


@pytest.mark.parametrize(
    "wrong", [{"patches": -1}, {"correspondence_rounds": 0}, {"patches": 10**9}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        PolishConfig(**wrong)


def test_details_decide_where_colours_and_outlines_speak_against_better_cameras(nearby):
    fit, worse_fit = (Disagreement({(0, 1): c}, {}, (c, c)) for c in (0.1, 0.2))
    right, off = nearby.cameras, nearby.rough
    pairs = [(0, 1)]

    def no_worse(photos, end, start):
        return is_no_worse(nearby.mesh, photos, end, start, FINE, pairs)

    assert no_worse(nearby.photos, (right, worse_fit), (off, fit))
    assert not no_worse(nearby.photos, (off, worse_fit), (right, fit))
    assert no_worse(nearby.photos, (off, fit), (right, worse_fit)), "nothing against it"
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, nearby.photos[1].pixels.shape, dtype=np.uint8)
    lost = (nearby.photos[0], dataclasses.replace(nearby.photos[1], pixels=noise))
    assert not no_worse(lost, (right, worse_fit), (off, fit)), "no details to ask"
