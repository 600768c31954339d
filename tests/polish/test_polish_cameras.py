"""The polish of cameras on small worlds with truth."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.lens import Lens
from photoreg.geometry.rotations import rotation_matrix
from photoreg.parameters.freedom import Freedom, Held
from photoreg.polish.config import PolishConfig
from photoreg.polish.polish_cameras import polish_cameras
from photoreg.polish.uncertainty import estimate_uncertainty, undetermined_directions
from photoreg.synthetic.rough_cameras import rough_start
from tests.polish_scene import (
    PolishScene,
    make_polish_scene,
    moved,
    projection_error_px,
)
from tests.scenes import small_scene

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
    assert steps[-1].missed_centre_px == ()
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
    # It ends 0.2 px off, and 0.06 by patches, which is as good as the truth can be told.
    coarse = PolishConfig(
        blurs_px=(8.0,),
        points=(300,),
        rounds=(1,),
        rim_reaches_px=(40.0,),
        use_correspondences=False,
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


@pytest.mark.parametrize(
    ("scale", "place"),
    [(1.0, [431250.0, 5411800.0, 120.0]), (1e-6, [0, 0, 0]), (1e6, [0, 0, 0])],
)
def test_a_national_grid_and_other_units_change_the_answer_by_no_more_than_a_digit(
    scene, steps, scale, place
):
    place = np.array(place, dtype=float)
    last = polished(moved(scene, scale, np.eye(3), place))[-1]
    same = dataclasses.replace(scene, cameras=steps[-1].cameras)
    there = moved(same, scale, np.eye(3), place)
    gap = projection_error_px(there.mesh, there.cameras, last.cameras)
    assert gap < 1e-3, gap


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


@pytest.fixture(scope="module")
def bent():
    """The scene through the lens of a phone, from rough cameras that do not know it."""
    return make_polish_scene(lens=Lens(k1=-0.12, k2=0.3), share=0.78)


@pytest.mark.parametrize("distortion", ["none", "auto"])
def test_a_lens_is_solved_along(bent, distortion):
    last = polished(bent, distortion=distortion)[-1]
    error = projection_error_px(bent.mesh, bent.cameras, last.cameras)
    if distortion == "none":
        assert error > 0.3, error
        assert all(camera.lens.is_ideal for camera in last.cameras)
        # It is told, and about how much: by one linear step.
        assert 0.3 * error < np.mean(last.missed_px) < 3.0 * error
        return
    assert last.missed_px == ()
    assert error < 0.15, error
    assert {camera.lens.k1 for camera in last.cameras} != {0.0}


def test_a_lens_that_nothing_shows_stays_the_given_one(scene):
    last = polished(scene, distortion="auto")[-1]
    assert all(camera.lens.is_ideal for camera in last.cameras)
    assert projection_error_px(scene.mesh, scene.cameras, last.cameras) < 0.15


def test_a_shared_lens_is_one_and_a_held_one_stays(bent):
    given = [camera.with_lens(Lens(k1=-0.05)) for camera in bent.rough]
    start = dataclasses.replace(bent, rough=tuple(given))
    quick = dataclasses.replace(QUICK, rounds=(1, 1, 1), extra_rounds=0)
    shared = Freedom(shared_focal=((0, 1),))
    last = polished(start, quick, distortion="k1", freedom=shared)[-1]
    first, second = (camera.lens for camera in last.cameras)
    assert first == second != Lens(k1=-0.05)
    held = Freedom((Held(lens=True), Held()))
    last = polished(start, quick, distortion="k1", freedom=held)[-1]
    assert last.cameras[0].lens == Lens(k1=-0.05)
    assert last.cameras[1].lens != Lens(k1=-0.05)


@pytest.mark.parametrize("said", [True, False])
def test_a_cropped_photo_is_solved_if_it_is_said_and_noticed_if_not(said):
    part = small_scene(crop=0.2)
    start = PolishScene(part.mesh, part.photos, part.cameras, part.rough_cameras)
    freedom = Freedom(cropped=(0, 1) if said else ())
    last = polished(start, freedom=freedom)[-1]
    error = projection_error_px(part.mesh, part.cameras, last.cameras)
    if said:
        assert error < 0.15, error
        assert last.missed_centre_px == ()
    else:
        assert error > 0.3, error
        assert max(last.missed_centre_px) > 0.3, (error, last.missed_centre_px)


def test_a_principal_point_that_is_held_wrongly_is_noticed_and_a_right_one_is_not(
    scene,
):
    held = Freedom((Held(principal_point=True),) * 2)
    fine = dataclasses.replace(
        QUICK, blurs_px=(1.0,), points=(15000,), rounds=(2,), rim_reaches_px=(5.0,)
    )
    for off_px, noticed in ((0.0, False), (40.0, True)):
        start = []
        for camera in scene.cameras:
            K = camera.K.copy()
            K[0, 2] += off_px
            turn = rotation_matrix(np.array([0.0, -off_px / K[0, 0], 0.0]))
            R, t = turn @ camera.R_cam_world, turn @ camera.t_cam_world
            start.append(dataclasses.replace(camera, K=K, R_cam_world=R, t_cam_world=t))
        given = dataclasses.replace(scene, rough=tuple(start))
        missed = polished(given, fine, freedom=held)[-1].missed_centre_px
        assert (max(missed, default=0.0) > 0.3) == noticed, (off_px, missed)
