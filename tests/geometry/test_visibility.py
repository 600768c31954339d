"""The three visibilities against each other and against a hidden wall."""

import numpy as np
import pytest

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface
from photoreg.geometry.visibility import (
    middle_for,
    samples_for,
    share_seen_twice,
    visible,
)
from tests.scenes import small_scene

METHODS = ("normals", "rays", "depth")


def two_walls() -> Mesh:
    """A small wall (faces 0, 1) before a large one (2, 3), both facing -z."""
    square = np.array([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0.0]])
    vertices = np.concatenate([0.5 * square, 2.0 * square + [0, 0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(vertices, np.concatenate([faces, faces + 4]))


def front_camera() -> Camera:
    return Camera.look_at([0.1, 0.2, -4.0], [0, 0, 0], [0, -1, 0], 200, 320, 240)


@pytest.mark.parametrize("method", METHODS)
def test_the_near_wall_is_seen_whole(method):
    mesh = two_walls()
    samples = sample_surface(mesh, 2000, 1)
    seen = visible(samples, [front_camera()], mesh, method)[0]
    near = samples.face_index < 2
    assert seen[near].all()


@pytest.mark.parametrize("method", ["rays", "depth"])
def test_what_the_near_wall_hides_is_not_seen(method):
    mesh, camera = two_walls(), front_camera()
    samples = sample_surface(mesh, 4000, 1)
    seen = visible(samples, [camera], mesh, method)[0]
    # Where the sight line meets the plane of the near wall.
    share = camera.center[2] / (camera.center[2] - samples.points[:, 2])
    crossing = camera.center + share[:, None] * (samples.points - camera.center)
    far = samples.face_index >= 2
    inset = 0.5 - np.abs(crossing[:, :2]).max(axis=1)
    assert not seen[far & (inset > 0.02)].any()
    assert seen[far & (inset < -0.02)].all()


def test_rays_and_depth_agree_on_a_real_shape():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 3000, 1)
    seen = {
        method: visible(samples, scene.cameras, scene.mesh, method, 0.2)
        for method in METHODS
    }
    # The depth buffer of 320 px cannot tell within a pixel of a contour.
    apart = (seen["rays"] != seen["depth"]).mean()
    assert apart < 0.01, apart
    for method in ("rays", "depth"):
        assert not (seen[method] & ~seen["normals"]).any()


def test_the_back_is_not_seen():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 1000, 1)
    seen = visible(samples, scene.cameras, scene.mesh, "normals", 0.5)
    for camera, row in zip(scene.cameras, seen, strict=True):
        direction = camera.center - samples.points[row]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        cosine = np.einsum("nd,nd->n", direction, samples.normals[row])
        assert cosine.min() >= 0.5 - 1e-12, cosine.min()


@pytest.mark.parametrize("method", METHODS)
def test_what_lies_outside_the_photo_or_behind_is_not_seen(method):
    mesh = two_walls()
    samples = sample_surface(mesh, 500, 1)
    camera = front_camera()
    aside = Camera(
        camera.K,
        camera.R_cam_world,
        camera.t_cam_world + np.array([9.0, 0, 0]),
        320,
        240,
    )
    behind = Camera(
        camera.K,
        camera.R_cam_world,
        camera.t_cam_world - np.array([0, 0, 9.0]),
        320,
        240,
    )
    assert not visible(samples, [aside, behind], mesh, method).any()


def test_what_is_seen_tells_where_points_are_drawn():
    mesh, camera = two_walls(), front_camera()
    whole = samples_for(mesh, [camera], 2000, 1)
    np.testing.assert_array_equal(whole.points, sample_surface(mesh, 2000, 1).points)
    assert middle_for(mesh, [camera]) is mesh.centroid
    # The far wall a hundred times as large, and slid aside until the camera sees 1 in
    # 10,000 of both.
    vertices = mesh.vertices.copy()
    vertices[4:] = vertices[4:] * [100.0, 100.0, 1.0] + [199.0, 0.0, 0.0]
    mesh = Mesh(vertices, mesh.faces)
    detail = samples_for(mesh, [camera], 2000, 1)
    seen = visible(detail, [camera], mesh, "rays", 0.25)[0]
    assert seen.mean() > 0.99, seen.mean()
    assert 200 < seen.sum() <= 2000
    pixels = camera.project(detail.points)
    assert (np.ptp(pixels, axis=0) > 100.0).all()
    # The far wall is seen from x = -1 to 4 only; its middle is at 199.
    np.testing.assert_allclose(middle_for(mesh, [camera]), [1.5, 0, 1.0], atol=0.5)
    same = samples_for(mesh, [camera], 2000, 1)
    np.testing.assert_array_equal(same.points, detail.points)


def test_seen_twice_is_what_two_cameras_see():
    mesh, camera = two_walls(), front_camera()
    # Its frame is 0.8 by 0.6 of the near wall; the walls are 1 by 1 and 4 by 4.
    close = Camera.look_at([0.1, 0.15, -0.5], [0.1, 0.15, 0], [0, -1, 0], 200, 320, 240)
    samples = sample_surface(mesh, 2000, 0)
    share = share_seen_twice(samples, mesh, [camera, close], 0.25)
    # Three standard errors of 2,000 samples.
    assert np.isclose(share, 0.48 / 17.0, atol=0.011), share
    assert share_seen_twice(samples, mesh, [camera, close, close], 0.25) >= share
    assert share_seen_twice(samples, mesh, [camera], 0.25) == 0.0
