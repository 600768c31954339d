"""The lens against OpenCV, and projection with it against finite differences."""

import cv2
import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection import lens_slopes, pixel_slopes, project, turned
from photoreg.geometry.rasteriser import render_geometry

LENSES = [
    Lens(),
    Lens(k1=-0.15),
    Lens(k1=0.09, k2=-0.15, p1=0.001, p2=-0.0007, k3=0.03),
    Lens(k1=-0.3, k2=0.12),
]


def _camera(lens: Lens) -> Camera:
    camera = Camera.look_at([1.0, -2.0, 4.0], [0, 0, 0], [0, 0, 1], 820.0, 1024, 768)
    K = camera.K.copy()
    K[0, 1], K[1, 1], K[0, 2] = 3.0, 830.0, 520.0
    return Camera(K, camera.R_cam_world, camera.t_cam_world, 1024, 768, lens)


def _points(n: int = 500) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.3, 1.3, (n, 3))


@pytest.mark.parametrize("lens", LENSES)
def test_projection_is_opencvs(lens: Lens) -> None:
    camera = _camera(lens)
    # OpenCV knows no skew.
    K = camera.K.copy()
    K[0, 1] = 0.0
    camera = Camera(K, camera.R_cam_world, camera.t_cam_world, 1024, 768, lens)
    pixels = camera.project(_points())
    theirs, _ = cv2.projectPoints(
        _points(),
        cv2.Rodrigues(camera.R_cam_world)[0],
        camera.t_cam_world,
        camera.K,
        np.array(lens.terms),
    )
    seen = np.isfinite(pixels).all(axis=1)
    assert seen.sum() > 300
    np.testing.assert_allclose(pixels[seen], theirs[:, 0][seen], atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_undistorting_is_opencvs_and_the_way_back(lens: Lens) -> None:
    camera = _camera(lens)
    pixels = camera.project(_points())
    pixels = pixels[camera.contains(pixels)]
    assert len(pixels) > 200
    origin, rays = camera.rays(pixels)
    np.testing.assert_allclose(camera.project(origin + 3.0 * rays), pixels, atol=1e-9)
    x_y = np.linalg.solve(camera.K, np.vstack([pixels.T, np.ones(len(pixels))]))[:2].T
    # OpenCV 4 has another function for the one that takes criteria.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    theirs = undistort(
        x_y[:, None],
        np.eye(3),
        np.array(lens.terms),
        R=np.eye(3),
        P=np.eye(3),
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-15),
    )[:, 0]
    ours = camera.undistort(pixels)
    theirs_px = theirs @ camera.K[:2, :2].T + camera.K[:2, 2]
    np.testing.assert_allclose(ours, theirs_px, atol=1e-8)


@pytest.mark.parametrize("lens", LENSES)
def test_slopes_are_those_of_finite_differences(lens: Lens) -> None:
    camera = _camera(lens)
    step = 1e-6
    for X in _points(20):
        point = camera.R_cam_world @ X + camera.t_cam_world

        def pixel(at: np.ndarray, terms: Lens = lens) -> np.ndarray:
            world = camera.R_cam_world.T @ (at - camera.t_cam_world)
            return camera.with_lens(terms).project(world[None])[0]

        if not np.isfinite(pixel(point)).all():
            continue
        a_b_c = turned(camera.record, *X)
        slopes = np.array(pixel_slopes(camera.record, *a_b_c)).reshape(2, 3)
        for k, axis in enumerate(np.eye(3)):
            there, back = pixel(point + step * axis), pixel(point - step * axis)
            np.testing.assert_allclose(
                slopes[:, k], (there - back) / (2 * step), rtol=1e-6, atol=1e-5
            )
        if lens.is_ideal:
            continue
        by_terms = np.array(lens_slopes(camera.record, *a_b_c))
        for k in range(5):
            moved = [np.array(lens.terms), np.array(lens.terms)]
            moved[0][k] += step
            moved[1][k] -= step
            there, back = (pixel(point, Lens(*terms)) for terms in moved)
            np.testing.assert_allclose(
                by_terms[k], (there - back) / (2 * step), rtol=1e-6, atol=1e-5
            )


def test_beyond_the_fold_nothing_is_seen() -> None:
    lens = Lens(k1=-0.3)
    camera = Camera(np.diag([500.0, 500.0, 1.0]), np.eye(3), np.zeros(3), 9, 9, lens)
    radius = 1.0 / np.sqrt(0.9)
    assert lens.max_radius == pytest.approx(radius)
    for share, is_seen in ((0.999, True), (1.001, False), (3.0, False)):
        pixel = camera.project(np.array([[share * radius, 0.0, 1.0]]))
        assert np.isfinite(pixel).all() == is_seen
    # The lens shows nothing farther out than the fold.
    most = 500.0 * radius * (1.0 - 0.3 * radius**2)
    assert np.isfinite(camera.rays(np.array([[most - 0.1, 0.0]]))[1]).all()
    assert np.isnan(camera.rays(np.array([[most + 0.1, 0.0]]))[1]).all()


def test_a_lens_without_a_number_is_refused() -> None:
    with pytest.raises(InputError, match="k2"):
        Lens(k2=float("nan"))


def test_ideal_lens_in_the_record_costs_no_precision() -> None:
    camera = _camera(Lens())
    for X in _points(10):
        seen, u, v = project(camera.record, *X)
        assert seen
        P = camera.P @ np.append(X, 1.0)
        np.testing.assert_allclose([u, v], P[:2] / P[2], atol=1e-9)


@pytest.mark.parametrize("reach", [1.5, 40.0])
@pytest.mark.parametrize("lens", LENSES[1:])
def test_a_large_face_is_drawn_where_rays_meet_it(lens: Lens, reach: float) -> None:
    """Two faces larger than the photo, once even reaching behind the camera."""
    corners = reach * np.array([[-1.5, -1.2], [1.5, -1.2], [1.5, 1.2], [-1.5, 1.2]])
    vertices = np.column_stack([corners, 0.2 * corners[:, 0]])
    mesh = Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    small = _camera(lens).resized(256, 192)
    drawn = render_geometry(mesh, small)
    rows, columns = np.indices((192, 256)).reshape(2, -1)
    origin, rays = small.rays(np.column_stack([columns, rows]).astype(float))
    face, distance = mesh.first_hits(np.broadcast_to(origin, rays.shape), rays)
    face, distance = face.reshape(192, 256), distance.reshape(192, 256)
    assert (face >= 0).sum() > 5_000
    assert ((drawn.face_index >= 0) != (face >= 0)).sum() <= 10
    both = (drawn.face_index >= 0) & (face >= 0)
    assert (drawn.face_index[both] != face[both]).mean() < 0.01
    points = origin + distance[both][:, None] * rays.reshape(192, 256, 3)[both]
    depth = (points - small.center) @ small.R_cam_world[2]
    np.testing.assert_allclose(drawn.depth[both], depth, rtol=2e-3)
    gap = np.linalg.norm(drawn.points[both] - points, axis=1)
    assert (gap / depth).max() < 4e-3
