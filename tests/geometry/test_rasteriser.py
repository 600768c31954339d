"""The rasteriser against rays (embree), which share none of its code."""

import numpy as np
import pytest
import trimesh

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry


def bumpy_ball(subdivisions: int = 5, scale: float = 1.0) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y = ball.vertices[:, :1], ball.vertices[:, 1:2]
    radius = 1.0 + 0.1 * np.sin(7.0 * x) * np.cos(5.0 * y)
    return Mesh(ball.vertices * radius * scale, ball.faces)


@pytest.fixture
def camera():
    # Nothing is symmetric: fx != fy, skew, the principal point far off the centre.
    seen_from = Camera.look_at([3.0, 0.9, 0.4], [0.1, 0, 0], [0.2, 0, 1], 300, 320, 200)
    K = np.array([[310.0, 4.0, 171.0], [0.0, 290.0, 88.0], [0.0, 0.0, 1.0]])
    return Camera(K, seen_from.R_cam_world, seen_from.t_cam_world, 320, 200)


def by_rays(mesh: Mesh, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Face and depth at every pixel centre."""
    y, x = np.mgrid[: camera.height, : camera.width]
    center, directions = camera.rays(np.column_stack([x.ravel(), y.ravel()]))
    face, distance = mesh.first_hits(
        np.broadcast_to(center, directions.shape), directions
    )
    depth = distance * (directions @ camera.R_cam_world[2])
    return face.reshape(y.shape), depth.reshape(y.shape)


def test_a_picture_agrees_with_rays(camera):
    mesh = bumpy_ball()
    buffer = render_geometry(mesh, camera)
    face, depth = by_rays(mesh, camera)
    assert 0.2 < buffer.covered.mean() < 0.8
    same_cover = (buffer.covered == (face >= 0)).mean()
    assert same_cover > 0.9999, same_cover
    same_face = (buffer.face_index == face).mean()
    assert same_face > 0.999, same_face
    both = buffer.covered & (face >= 0)
    # Embree works in float32: worst observed 2e-5 of the diagonal, at grazing angles.
    worst = np.abs(buffer.depth[both] - depth[both]).max() / mesh.diagonal
    assert worst < 1e-3, worst


def test_uncovered_pixels_have_no_face_and_infinite_depth(camera):
    buffer = render_geometry(bumpy_ball(2), camera)
    assert (buffer.face_index[~buffer.covered] == -1).all()
    assert np.isinf(buffer.depth[~buffer.covered]).all()
    assert np.isnan(buffer.points[~buffer.covered]).all()


def test_points_project_to_their_own_pixel_centres(camera):
    buffer = render_geometry(bumpy_ball(), camera)
    y, x = np.nonzero(buffer.covered)
    pixels = camera.project(buffer.points[y, x])
    worst = np.abs(pixels - np.column_stack([x, y])).max()
    assert worst < 1e-9, worst


def test_points_lie_on_their_faces(camera):
    mesh = bumpy_ball()
    buffer = render_geometry(mesh, camera)
    face = buffer.face_index[buffer.covered]
    offsets = buffer.points[buffer.covered] - mesh.vertices[mesh.faces[face, 0]]
    worst = np.abs((offsets * mesh.face_normals[face]).sum(axis=1)).max()
    # Depth is float32 (6e-8 of a distance of 3).
    assert worst < 1e-6, worst


def test_triangles_that_reach_behind_the_camera_agree_with_rays():
    # A room of 12 large triangles around the camera: every one crosses its plane.
    room = trimesh.creation.box(extents=(4.0, 6.0, 3.0))
    mesh = Mesh(room.vertices, room.faces)
    camera = Camera.look_at([0.7, -0.4, 0.3], [2, 1, -0.2], [0, 0.1, 1], 120, 320, 240)
    behind = (camera.to_camera(mesh.vertices)[:, 2][mesh.faces] < 0).any(axis=1)
    assert behind.sum() >= 6, behind.sum()
    buffer = render_geometry(mesh, camera)
    face, depth = by_rays(mesh, camera)
    assert buffer.covered.all()
    same_face = (buffer.face_index == face).mean()
    assert same_face > 0.999, same_face
    worst = (np.abs(buffer.depth - depth) / depth).max()
    assert worst < 1e-4, worst


def test_nothing_behind_the_camera_is_drawn(camera):
    mesh = bumpy_ball(3)
    turned = Camera(
        camera.K,
        np.diag([-1.0, 1.0, -1.0]) @ camera.R_cam_world,
        np.diag([-1.0, 1.0, -1.0]) @ camera.t_cam_world,
        camera.width,
        camera.height,
    )
    assert not render_geometry(mesh, turned).covered.any()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_a_picture_does_not_depend_on_the_units(camera, scale):
    reference = render_geometry(bumpy_ball(4), camera)
    scaled = Camera(camera.K, camera.R_cam_world, camera.t_cam_world * scale, 320, 200)
    buffer = render_geometry(bumpy_ball(4, scale), scaled)
    same = (buffer.face_index == reference.face_index).mean()
    assert same > 0.9999, same


def test_a_face_seen_from_behind_is_drawn_too(camera):
    mesh = bumpy_ball(3)
    inside_out = Mesh(mesh.vertices, mesh.faces[:, ::-1])
    np.testing.assert_array_equal(
        render_geometry(inside_out, camera).covered,
        render_geometry(mesh, camera).covered,
    )


def test_a_smaller_picture_shows_the_same_scene(camera):
    mesh = bumpy_ball()
    small = render_geometry(mesh, camera, width=160)
    assert small.face_index.shape == (100, 160)
    face, _ = by_rays(mesh, camera.resized(160, 100))
    same_face = (small.face_index == face).mean()
    assert same_face > 0.999, same_face


def test_a_triangle_without_area_is_left_out(camera):
    vertices = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 2, 0]], dtype=float)
    mesh = Mesh(vertices, np.array([[0, 1, 3], [0, 1, 2]]))
    buffer = render_geometry(mesh, camera)
    assert set(np.unique(buffer.face_index)) == {-1, 1}
