"""The polish of cameras on small worlds with truth."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.rotations import rotation_matrix
from photoreg.polish.polish_cameras import PolishConfig, polish_cameras
from photoreg.polish.uncertainty import estimate_uncertainty, undetermined_directions
from photoreg.synthetic.rough_cameras import rough_start
from tests.polish_scene import make_polish_scene, moved, projection_error_px

pytestmark = pytest.mark.workqueue

QUICK = PolishConfig(
    blurs_px=(8.0, 2.0, 0.5),
    points=(3000, 6000, 15000),
    rounds=(2, 2, 1),
    rim_reaches_px=(40.0, 12.0, 5.0),
)


@pytest.fixture(scope="module")
def scene():
    return make_polish_scene(gain=0.85, offset=9.0)


def polished(scene, config=QUICK, **options):
    return list(
        polish_cameras(
            scene.mesh, scene.photos, scene.rough, scene.rough, config, **options
        )
    )


@pytest.fixture(scope="module")
def steps(scene):
    return polished(scene)


def test_rough_cameras_become_precise(scene, steps):
    before = projection_error_px(scene.mesh, scene.cameras, scene.rough)
    after = projection_error_px(scene.mesh, scene.cameras, steps[-1].cameras)
    assert before > 4.0, before
    # Exact mesh and half a grey level of noise: worst observed 0.06.
    assert after < 0.15, (before, after)


@pytest.fixture(scope="module")
def far(scene):
    """The same scene from cameras too far off for a round a level."""
    rough = rough_start(scene.mesh, scene.cameras, (22.0, 26.0), seed=3)
    return dataclasses.replace(scene, rough=tuple(rough))


def test_a_level_goes_on_while_the_cameras_still_move(far):
    short = dataclasses.replace(QUICK, rounds=(1, 1, 1), extra_rounds=0)
    longer = dataclasses.replace(short, extra_rounds=6)
    ended, settled = (
        projection_error_px(far.mesh, far.cameras, polished(far, config)[-1].cameras)
        for config in (short, longer)
    )
    assert settled < 0.15, (ended, settled)
    assert ended > 2.0 * settled, (ended, settled)


def test_a_level_that_has_settled_adds_no_round(scene):
    exact = dataclasses.replace(scene, rough=scene.cameras)
    fine = dataclasses.replace(
        QUICK, blurs_px=(2.0,), points=(6000,), rounds=(1,), rim_reaches_px=(5.0,)
    )
    least = polished(exact, dataclasses.replace(fine, extra_rounds=0))[-1]
    most = polished(exact, fine)[-1]
    assert np.array_equal(least.x, most.x)


def test_the_last_step_says_that_it_is_no_worse(steps):
    last = steps[-1]
    assert last.disagreement is not None
    before, after = last.start_disagreement.total, last.disagreement.total
    assert after < 0.3 * before, after
    assert all(step.disagreement is None for step in steps[:-1])


def test_cameras_that_nothing_improves_come_back_as_they_were(scene):
    exact = dataclasses.replace(scene, rough=scene.cameras)
    coarse = PolishConfig(
        blurs_px=(8.0,), points=(300,), rounds=(1,), rim_reaches_px=(40.0,)
    )
    last = polished(exact, coarse)[-1]
    for camera, true in zip(last.cameras, scene.cameras, strict=True):
        assert np.array_equal(camera.P, true.P)
    assert "nothing better" in last.warnings[-1]


def test_the_same_seed_gives_the_same_answer(scene, steps):
    again = polished(scene)[-1]
    assert np.array_equal(again.x, steps[-1].x)


def test_units_and_axes_of_the_world_change_nothing(scene, steps):
    R = rotation_matrix(np.array([0.4, -1.0, 0.7]))
    # Metres as micrometres, far from the origin.
    other = moved(scene, 1e6, R, np.array([3e6, -2e6, 5e6]))
    last = polished(other)[-1]
    gap = projection_error_px(
        other.mesh,
        last.cameras,
        moved(
            dataclasses.replace(scene, cameras=steps[-1].cameras),
            1e6,
            R,
            np.array([3e6, -2e6, 5e6]),
        ).cameras,
    )
    # Rays are float32, so a few edges and points differ.
    assert gap < 0.05, gap


def test_one_photo_alone_is_drawn_to_its_outline(scene):
    alone = dataclasses.replace(
        scene, photos=scene.photos[:1], cameras=scene.cameras[:1], rough=scene.rough[:1]
    )
    last = polished(alone)[-1]
    before = projection_error_px(scene.mesh, alone.cameras, alone.rough)
    after = projection_error_px(scene.mesh, alone.cameras, last.cameras)
    assert after < 0.5 * before, (before, after)


def test_three_photos_are_polished_together():
    scene = make_polish_scene(n_photos=3)
    after = projection_error_px(scene.mesh, scene.cameras, polished(scene)[-1].cameras)
    assert after < 0.15, after


def test_a_camera_that_looks_away_is_named(scene):
    camera = scene.rough[1]
    turn = rotation_matrix(np.array([0.0, 3.0, 0.0]))
    away = dataclasses.replace(
        camera,
        R_cam_world=turn @ camera.R_cam_world,
        t_cam_world=turn @ camera.t_cam_world,
    )
    lost = dataclasses.replace(scene, rough=(scene.rough[0], away))
    with pytest.raises(RefinementError, match=r"1\.png does not see the mesh"):
        polished(lost)


def test_a_configuration_of_unequal_levels_is_refused():
    with pytest.raises(InputError, match="one length"):
        PolishConfig(points=(100,))


def test_fewer_than_no_extra_rounds_are_refused():
    with pytest.raises(InputError, match="extra_rounds should be 0 or more"):
        PolishConfig(extra_rounds=-1)


def test_expected_error_is_of_the_size_of_the_true_error(scene, steps):
    ends = [step for step in steps if step.scatter is not None]
    assert [step.level for step in ends] == list(range(ends[-1].n_levels))
    told = [estimate_uncertainty(scene.mesh, step).expected_error_px for step in ends]
    for step, unsure in zip(ends, told, strict=True):
        true = projection_error_px(scene.mesh, scene.cameras, step.cameras)
        assert true < 4.0 * unsure, (step.level, true, unsure)
    assert told[-1] < 0.5


def test_directions_left_open_are_named_in_plain_words(steps):
    increments = steps[-1].increments
    covariance = 1e-6 * np.eye(18)
    trade = np.zeros(18)
    trade[9 + 5], trade[9 + 6] = 0.6, 0.8
    covariance += 0.9 * np.outer(trade, trade)
    words = undetermined_directions(
        covariance, increments, ("a.jpg", "b.jpg"), np.eye(18)
    )
    assert words == (
        "Focal length of b.jpg (±1.5 %) and distance of b.jpg (±1.7 %) trade off.",
    )
