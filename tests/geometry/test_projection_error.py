"""The projection error: known answers, invariance, visibility, refusals."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.geometry.sampling import sample_surface
from tests.scenes import small_scene


def two_sheets() -> Mesh:
    """A square of side 2 at z = 5 and one of side 2 behind it, hidden, at z = 6."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    vertices = np.vstack([square + np.array([0, 0, 5]), square + np.array([0, 0, 6])])
    faces = np.array([[0, 2, 1], [0, 3, 2], [4, 6, 5], [4, 7, 6]])
    return Mesh(vertices, faces)


def plain_camera(width: int = 200, height: int = 160) -> Camera:
    K = np.array([[300.0, 0.0, 93.0], [0.0, 300.0, 84.0], [0.0, 0.0, 1.0]])
    return Camera(K, np.eye(3), np.zeros(3), width, height)


def with_principal_point_moved(camera: Camera, x: float, y: float) -> Camera:
    K = camera.K.copy()
    K[:2, 2] += (x, y)
    return dataclasses.replace(camera, K=K)


def test_the_true_cameras_are_exactly_0_px_off():
    scene = small_scene()
    error = projection_error(scene.mesh, scene.cameras, scene.cameras)
    assert error.mean == 0.0
    assert error.max == 0.0


def test_a_principal_point_off_by_3_and_4_px_is_an_error_of_5_px_everywhere():
    scene = small_scene()
    moved = [with_principal_point_moved(camera, 3.0, -4.0) for camera in scene.cameras]
    error = projection_error(scene.mesh, scene.cameras, moved)
    for camera in error.cameras:
        figures = [camera.mean, camera.rms, camera.median, camera.max]
        np.testing.assert_allclose(figures, 5.0, atol=1e-9)
    assert error.mean == pytest.approx(5.0, abs=1e-9)


def test_the_mean_is_over_cameras_and_the_max_over_all_points():
    scene = small_scene()
    estimated = [
        with_principal_point_moved(scene.cameras[0], 1.0, 0.0),
        with_principal_point_moved(scene.cameras[1], 0.0, 4.0),
    ]
    error = projection_error(scene.mesh, scene.cameras, estimated)
    assert error.mean == pytest.approx(2.5, abs=1e-9)
    assert error.max == pytest.approx(4.0, abs=1e-9)


def test_the_figures_agree_with_a_loop_over_points_and_rays():
    scene = small_scene()
    true, rough = scene.cameras[0], scene.rough_cameras[0]
    error = projection_error(scene.mesh, [true], [rough], n_samples=400).cameras[0]
    distances = []
    for point in sample_surface(scene.mesh, 400, seed=0).points:
        pixel = true.project(point[None])[0]
        if not true.contains(pixel[None])[0]:
            continue
        ray = point - true.center
        _, reach = scene.mesh.first_hits(true.center[None], ray[None])
        if reach[0] < 1.0 - 1e-3 * scene.mesh.diagonal / np.linalg.norm(ray):
            continue
        distances.append(np.linalg.norm(rough.project(point[None])[0] - pixel))
    assert error.n_points == len(distances)
    assert error.mean == pytest.approx(np.mean(distances), rel=1e-9)
    assert error.rms == pytest.approx(np.sqrt(np.mean(np.square(distances))), rel=1e-9)
    assert error.median == pytest.approx(np.median(distances), rel=1e-9)
    assert error.max == pytest.approx(np.max(distances), rel=1e-9)


def test_points_hidden_from_the_true_camera_do_not_count():
    # Moving by (0.05, 0, 0) shifts the front sheet by 300 * 0.05 / 5 = 3 px; the hidden
    # one, 2.5 px, would lower the mean.
    camera = plain_camera()
    moved = dataclasses.replace(camera, t_cam_world=np.array([0.05, 0.0, 0.0]))
    error = projection_error(two_sheets(), [camera], [moved], n_samples=2000)
    assert error.mean == pytest.approx(3.0, abs=1e-6)
    assert error.cameras[0].n_points == 1000


def test_points_outside_the_true_cameras_frame_do_not_count():
    # The front sheet spans 120 px; a photo 63 px high about its middle shows 62 of
    # them between the centres of its border pixels.
    camera = plain_camera(width=200, height=63)
    camera = with_principal_point_moved(camera, 0.0, 31.0 - 84.0)
    error = projection_error(two_sheets(), [camera], [camera], n_samples=20_000)
    share = error.cameras[0].n_points / 10_000
    assert share == pytest.approx(62 / 120, abs=0.01), share


def test_a_point_behind_the_estimated_camera_is_infinitely_far_off():
    turned = dataclasses.replace(plain_camera(), R_cam_world=np.diag([1.0, -1.0, -1.0]))
    error = projection_error(two_sheets(), [plain_camera()], [turned])
    assert error.mean == np.inf


def test_world_and_cameras_moved_turned_and_scaled_together_change_nothing():
    scene = small_scene()
    error = projection_error(scene.mesh, scene.cameras, scene.rough_cameras)
    R = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    scale, shift = 1e-6, np.array([3e-6, -2e-6, 9e-6])

    def moved(camera: Camera) -> Camera:
        R_cam = camera.R_cam_world @ R.T
        t = scale * camera.t_cam_world - R_cam @ shift
        return dataclasses.replace(camera, R_cam_world=R_cam, t_cam_world=t)

    mesh = Mesh(scale * scene.mesh.vertices @ R.T + shift, scene.mesh.faces)
    again = projection_error(
        mesh,
        [moved(camera) for camera in scene.cameras],
        [moved(camera) for camera in scene.rough_cameras],
    )
    # A few points at the rim change sides with embree's single precision.
    assert again.mean == pytest.approx(error.mean, rel=1e-3)


def test_the_same_question_gets_the_same_answer_whatever_the_global_random_state():
    scene = small_scene()
    np.random.seed(1)  # noqa: NPY002
    first = projection_error(scene.mesh, scene.cameras, scene.rough_cameras)
    np.random.seed(2)  # noqa: NPY002
    second = projection_error(scene.mesh, scene.cameras, scene.rough_cameras)
    assert first == second


def test_a_true_camera_that_sees_nothing_is_refused_by_its_number():
    away = dataclasses.replace(plain_camera(), R_cam_world=np.diag([1.0, -1.0, -1.0]))
    cameras = [plain_camera(), away]
    with pytest.raises(InputError, match="True camera 2 sees nothing"):
        projection_error(two_sheets(), cameras, cameras)


def test_different_numbers_of_cameras_are_refused():
    with pytest.raises(InputError, match="1 true and 2 estimated"):
        projection_error(two_sheets(), [plain_camera()], [plain_camera()] * 2)
    with pytest.raises(InputError, match="at least one"):
        projection_error(two_sheets(), [], [])


def test_cameras_for_photos_of_different_size_are_refused():
    with pytest.raises(InputError, match=r"200x160 px, the estimated one for 100x160"):
        projection_error(two_sheets(), [plain_camera()], [plain_camera(width=100)])
