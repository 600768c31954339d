import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera, same_camera


def make_camera(seed: int = 3) -> Camera:
    # Nothing is symmetric: fx != fy, skew, cx and cy off the middle, a general pose,
    # so a transposed matrix or an inverted pose changes every number.
    rng = np.random.default_rng(seed)
    K = np.array([[910.0, 2.5, 331.0], [0.0, 955.0, 228.0], [0.0, 0.0, 1.0]])
    R = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    return Camera(K, R, np.array([0.3, -0.2, 5.0]), 640, 480)


@pytest.fixture
def camera() -> Camera:
    return make_camera()


def test_project_sends_a_point_on_the_optical_axis_to_the_principal_point(camera):
    point = camera.center + 4.0 * camera.R_cam_world[2]
    assert camera.project(point[None])[0] == pytest.approx([331.0, 228.0], abs=1e-9)


def test_project_gives_nan_behind_the_camera(camera):
    point = camera.center - 4.0 * camera.R_cam_world[2]
    assert np.isnan(camera.project(point[None])).all()


def test_project_agrees_with_the_projection_matrix(camera):
    points = np.random.default_rng(1).normal(size=(50, 3))
    homogeneous = np.column_stack([points, np.ones(50)]) @ camera.P.T
    expected = homogeneous[:, :2] / homogeneous[:, 2:]
    assert np.abs(camera.project(points) - expected).max() < 1e-9


def test_rays_go_back_through_the_pixels_they_came_from(camera):
    pixels = np.array([[0.0, 0.0], [639.0, 479.0], [12.5, 400.25]])
    center, directions = camera.rays(pixels)
    back = camera.project(center + 3.7 * directions)
    assert np.abs(back - pixels).max() < 1e-9
    assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(3))


@given(st.integers(0, 10_000), st.floats(-5.0, 5.0).filter(lambda s: abs(s) > 1e-3))
def test_decomposition_undoes_the_projection_matrix_at_any_scale(seed, scale):
    camera = make_camera(seed)
    back = Camera.from_projection_matrix(scale * camera.P, 640, 480)
    assert np.abs(back.K - camera.K).max() < 1e-7
    assert np.abs(back.R_cam_world - camera.R_cam_world).max() < 1e-9
    assert np.abs(back.t_cam_world - camera.t_cam_world).max() < 1e-8


def test_resized_keeps_the_corners_of_the_photo(camera):
    # The outer corner of the first pixel, (-1/2, -1/2), stays the outer corner.
    half = camera.resized(320, 120)
    point = camera.center + 2.0 * camera.rays(np.array([[-0.5, -0.5]]))[1][0]
    assert half.project(point[None])[0] == pytest.approx([-0.5, -0.5], abs=1e-9)
    back = half.resized(640, 480)
    assert np.abs(back.K - camera.K).max() < 1e-9


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    camera = Camera.look_at([3.0, 1.0, 2.0], [0.5, 0.2, 0.1], [0, 0, 1], 800, 641, 481)
    middle, above = camera.project(np.array([[0.5, 0.2, 0.1], [0.5, 0.2, 0.3]]))
    assert middle == pytest.approx([320.0, 240.0], abs=1e-9)
    assert above[1] < middle[1]
    assert above[0] == pytest.approx(middle[0], abs=1e-9)
    assert camera.center == pytest.approx([3.0, 1.0, 2.0])


def test_contains_reaches_from_first_to_last_pixel_centre(camera):
    pixels = np.array([[0.0, 0.0], [639.0, 479.0], [-0.01, 5.0], [639.01, 5.0]])
    assert camera.contains(pixels).tolist() == [True, True, False, False]
    assert not camera.contains(np.array([[np.nan, np.nan]]))[0]


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"K": np.diag([900.0, -900.0, 1.0])}, "focal lengths"),
        ({"K": np.eye(3)[:2]}, r"shape \(3, 3\)"),
        ({"K": np.eye(3) + np.eye(3)[::-1]}, "upper triangular"),
        ({"R_cam_world": np.diag([1.0, 1.0, -1.0])}, "rotation"),
        ({"R_cam_world": 1.1 * np.eye(3)}, "rotation"),
        ({"R_cam_world": np.full((3, 3), np.nan)}, "finite"),
        ({"t_cam_world": np.array([1.0, np.inf, 0.0])}, "finite"),
        ({"t_cam_world": "here"}, "numbers"),
        ({"width": 0}, "positive"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(camera, change, words):
    with pytest.raises(InputError, match=words):
        dataclasses.replace(camera, **change)


def test_a_rotation_with_few_decimals_becomes_the_nearest_rotation(camera):
    rounded = dataclasses.replace(camera, R_cam_world=camera.R_cam_world.round(4))
    R = rounded.R_cam_world
    assert np.abs(R.T @ R - np.eye(3)).max() < 1e-14
    assert np.abs(R - camera.R_cam_world).max() < 2e-4


def test_a_singular_projection_matrix_is_refused():
    with pytest.raises(InputError, match="singular"):
        Camera.from_projection_matrix(np.zeros((3, 4)), 640, 480)


def test_a_camera_is_the_same_after_quaternions_and_not_a_millionth_of_a_pixel_on(
    camera,
):
    turned = Rotation.from_matrix(camera.R_cam_world.copy()).as_quat() * (1.0 + 1e-15)
    back = dataclasses.replace(
        camera,
        R_cam_world=Rotation.from_quat(turned).as_matrix(),
        t_cam_world=camera.R_cam_world @ (camera.R_cam_world.T @ camera.t_cam_world),
    )
    assert same_camera(camera, back)
    K = camera.K.copy()
    K[0, 2] += 1e-6
    assert not same_camera(camera, dataclasses.replace(camera, K=K))
    assert not same_camera(camera, dataclasses.replace(camera, width=641))
