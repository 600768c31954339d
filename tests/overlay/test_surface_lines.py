"""Lines and normals of the surface as a camera sees it, against solids one can count."""

import dataclasses

import numpy as np
import pytest
import trimesh

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo
from photoreg.overlay.surface_lines import SurfaceLines, shaded_normals
from photoreg.synthetic.rock import rock_mesh


def box() -> Mesh:
    solid = trimesh.creation.box((2.0, 1.2, 0.8))
    return Mesh(np.asarray(solid.vertices), np.asarray(solid.faces))


@pytest.fixture
def camera() -> Camera:
    # fx != fy and a principal point off the centre.
    base = Camera.look_at((3, 2, 4), (0.1, 0, 0), (0.1, 1, 0), 700.0, 640, 480)
    K = np.array([[700.0, 0.0, 340.0], [0.0, 650.0, 225.0], [0.0, 0.0, 1.0]])
    return dataclasses.replace(base, K=K)


def length(segments: np.ndarray) -> float:
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def test_of_a_box_seen_at_a_corner_nine_of_twelve_edges_are_drawn(camera):
    segments = SurfaceLines(box()).seen_from(camera)
    assert len(segments) == 9, f"{len(segments)} edges"
    assert length(segments) == pytest.approx(3 * (2.0 + 1.2 + 0.8))


def test_what_another_box_hides_is_not_drawn():
    front, behind = box(), box()
    mesh = Mesh(
        np.concatenate([front.vertices, behind.vertices * 0.5 - (0, 0, 3.0)]),
        np.concatenate([front.faces, behind.faces + len(front.vertices)]),
    )
    camera = Camera.look_at((0, 0, 6), (0, 0, 0), (0, 1, 0), 900.0, 640, 480)
    segments = SurfaceLines(mesh).seen_from(camera)
    assert (segments[..., 2] > -1.0).all(), "the small box is behind the large one"
    assert length(segments) == pytest.approx(2 * (2.0 + 1.2))


def test_a_smooth_surface_has_its_outline_and_nothing_else(camera):
    ball = trimesh.creation.icosphere(4, radius=1.0)
    mesh = Mesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    segments = SurfaceLines(mesh).seen_from(camera)
    middle = segments.mean(axis=1)
    to_camera = camera.center - middle
    cosine = np.einsum("ij,ij->i", middle, to_camera)
    cosine /= np.linalg.norm(middle, axis=1) * np.linalg.norm(to_camera, axis=1)
    assert len(segments) > 40
    assert np.abs(cosine).max() < 0.08, f"seen at {np.abs(cosine).max():.3f}"


def test_the_outline_lies_where_the_rasterised_surface_ends(camera):
    mesh = rock_mesh(seed=1, subdivisions=4)
    camera = dataclasses.replace(camera, t_cam_world=camera.t_cam_world * 0.9)
    segments = SurfaceLines(mesh).seen_from(camera)
    covered = render_geometry(mesh, camera).covered
    padded = np.pad(covered, 1, constant_values=True)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    rim = np.argwhere(covered & ~inner)[:, ::-1]
    ends = camera.project(segments.reshape(-1, 3)).reshape(-1, 2, 2)
    shares = np.linspace(0, 1, 9)[:, None, None, None]
    on_lines = ((1 - shares) * ends[:, 0] + shares * ends[:, 1]).reshape(-1, 2)
    off = np.array([np.linalg.norm(on_lines - pixel, axis=1).min() for pixel in rim])
    assert np.quantile(off, 0.98) < 1.2, f"{np.quantile(off, [0.5, 0.98, 1])} px"


def test_an_open_border_is_a_line_from_both_sides(camera):
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    mesh = Mesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    for z in (4.0, -4.0):
        view = Camera.look_at((0.5, 0.3, z), (0, 0, 0), (0, 1, 0), 700.0, 640, 480)
        segments = SurfaceLines(mesh).seen_from(view)
        assert length(segments) == pytest.approx(8.0), "four sides, no diagonal"


def test_normals_are_coloured_by_where_they_point_in_the_photo():
    ball = trimesh.creation.icosphere(5, radius=1.0)
    inward = np.asarray(ball.faces)[:, ::-1]
    photo = Photo("black.png", np.zeros((240, 320, 3), np.uint8))
    camera = Camera.look_at((0, 0, 5), (0, 0, 0), (0, 1, 0), 400.0, 320, 240)
    for faces in (np.asarray(ball.faces), inward):
        mesh = Mesh(np.asarray(ball.vertices), faces)
        picture = shaded_normals(mesh, photo, camera, share=1.0).astype(int)
        assert np.abs(picture[120, 160] - (128, 128, 255)).max() < 12, "the middle"
        right, top = picture[120, 234], picture[46, 160]
        assert right[0] > 215, f"right {right}"
        assert top[1] > 215, f"top {top}"
        assert (picture[5, 5] == 0).all(), "off the surface the photo stays"
