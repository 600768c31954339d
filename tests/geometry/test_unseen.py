"""What is said of cameras that do not see the surface names what is wrong."""

from collections.abc import Callable

import numpy as np
import pytest

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.unseen import why_unseen
from tests.painted import ball_and_moon, cameras_around

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
PLACE = np.array([3.0, 20.0, 1.0])
OFFSET = np.array([512345.0, 5401234.0, 310.0])


def moved(change: Callable[[np.ndarray], np.ndarray]) -> Mesh:
    """Off its origin, so that turns and scales take it out of view."""
    mesh = ball_and_moon(2)
    return Mesh(change(mesh.vertices + PLACE), mesh.faces)


def cameras() -> list[Camera]:
    found = []
    for camera in cameras_around(2):
        t = camera.t_cam_world - camera.R_cam_world @ PLACE
        found.append(
            Camera(camera.K, camera.R_cam_world, t, camera.width, camera.height)
        )
    return found


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: v @ Y_UP.T, "x, y, z were x, -z, y"),
        (lambda v: v * 1000.0, "0.001 times as large"),
        (lambda v: v * 0.01, "100 times as large"),
        (lambda v: 1000.0 * v @ Y_UP.T, "Neither units nor axes"),
        (lambda v: v + OFFSET, "not in one world"),
        (lambda v: v + 3.0 * PLACE[::-1], "not of this mesh's world"),
    ],
)
def test_the_mesh_s_world_is_compared_with_the_cameras(change, words):
    assert words in why_unseen(moved(change), cameras())


def test_cameras_in_opengl_s_axes_are_told():
    flip = np.diag([1.0, -1.0, -1.0])
    turned = [
        Camera(c.K, flip @ c.R_cam_world, flip @ c.t_cam_world, c.width, c.height)
        for c in cameras()
    ]
    assert "OpenGL" in why_unseen(moved(lambda v: v), turned)


def test_cameras_to_world_are_told():
    turned = [
        Camera(
            c.K,
            c.R_cam_world.T,
            -c.R_cam_world.T @ c.t_cam_world,
            c.width,
            c.height,
        )
        for c in cameras()
    ]
    assert "camera to world" in why_unseen(moved(lambda v: v), turned)


def test_a_mesh_of_a_few_pixels_is_told():
    mesh = ball_and_moon(2)
    tiny = Mesh(mesh.vertices * 0.001, mesh.faces)
    assert "only 0." in why_unseen(tiny, cameras_around(2))
