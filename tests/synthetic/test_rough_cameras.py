"""Rough cameras: off by what was asked for, in everything, as a person would be."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.projection_error import projection_error
from photoreg.synthetic.rough_cameras import rough_start
from tests.scenes import small_scene


@pytest.mark.parametrize("band", [(1.0, 1.5), (5.0, 8.0), (25.0, 27.0)])
def test_every_camera_is_off_by_a_mean_error_within_the_band(band):
    scene = small_scene()
    for seed in range(6):
        rough = rough_start(scene.mesh, scene.cameras, band, seed)
        error = projection_error(scene.mesh, scene.cameras, rough)
        for camera in error.cameras:
            assert band[0] <= camera.mean <= band[1], (seed, camera.mean)


def test_everything_is_wrong_at_once():
    scene = small_scene()
    rough = rough_start(scene.mesh, scene.cameras, (5.0, 8.0), seed=4)
    middle = scene.mesh.centroid
    for true, wrong in zip(scene.cameras, rough, strict=True):
        turn = wrong.R_cam_world @ true.R_cam_world.T
        angle_deg = np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0))
        distance = np.linalg.norm(true.center - middle)
        off = np.linalg.norm(wrong.center - middle) / distance - 1.0
        assert abs(wrong.focal_px / true.focal_px - 1.0) > 1e-4
        assert np.abs(wrong.K[:2, 2] - true.K[:2, 2]).min() > 1e-3
        assert 0.05 < angle_deg < 20.0, angle_deg
        assert 1e-4 < abs(off) < 0.2, off
        # Square pixels stay square.
        assert wrong.K[0, 0] / wrong.K[1, 1] == pytest.approx(1.0, abs=1e-12)
        assert wrong.K[0, 1] == 0.0


def test_the_object_stays_aimed_at_as_a_person_would_aim_it():
    # Turning a camera about itself by the angle it is off would move the object by
    # more than the whole error: it was aimed again.
    scene = small_scene()
    middle = scene.mesh.centroid[None]
    for seed in range(5):
        rough = rough_start(scene.mesh, scene.cameras, (5.0, 8.0), seed)
        for true, wrong in zip(scene.cameras, rough, strict=True):
            moved = np.linalg.norm(wrong.project(middle) - true.project(middle))
            assert moved < 8.0, moved


def test_a_rough_start_is_a_function_of_its_seed():
    scene = small_scene()
    first, again, other = (
        rough_start(scene.mesh, scene.cameras, (5.0, 8.0), seed) for seed in (1, 1, 2)
    )
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a.P, b.P)
        assert np.abs(a.P - c.P).max() > 1e-3


def test_the_models_units_do_not_matter():
    scene = small_scene()
    mesh = dataclasses.replace(scene.mesh, vertices=1e6 * scene.mesh.vertices)
    cameras = [
        dataclasses.replace(camera, t_cam_world=1e6 * camera.t_cam_world)
        for camera in scene.cameras
    ]
    large = rough_start(mesh, cameras, (5.0, 8.0), seed=1)
    small = rough_start(scene.mesh, scene.cameras, (5.0, 8.0), seed=1)
    for a, b in zip(large, small, strict=True):
        np.testing.assert_allclose(a.K, b.K, rtol=1e-3)
        np.testing.assert_allclose(a.R_cam_world, b.R_cam_world, atol=1e-3)
        np.testing.assert_allclose(1e-6 * a.t_cam_world, b.t_cam_world, atol=1e-3)


@pytest.mark.parametrize("band", [(0.0, 5.0), (8.0, 5.0), (-2.0, -1.0)])
def test_an_impossible_band_is_refused(band):
    scene = small_scene()
    with pytest.raises(InputError, match="band of errors"):
        rough_start(scene.mesh, scene.cameras, band)


def test_a_camera_that_sees_nothing_is_refused():
    camera = small_scene().cameras[0]
    about = np.diag([1.0, -1.0, -1.0])
    away = dataclasses.replace(
        camera,
        R_cam_world=about @ camera.R_cam_world,
        t_cam_world=about @ camera.t_cam_world,
    )
    with pytest.raises(InputError, match="sees nothing"):
        rough_start(small_scene().mesh, [away])
