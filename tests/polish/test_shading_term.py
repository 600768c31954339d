"""How far the shading of a surface explains one photo, and where that draws its camera."""

import dataclasses

import cv2
import numpy as np
import pytest

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_descriptors import surface_descriptors
from photoreg.geometry.surface_view import surface_view
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.camera_parameters import PRINCIPAL
from photoreg.parameters.increments import Increments
from photoreg.polish.levenberg_marquardt import Damping, Prior, Term, minimise
from photoreg.polish.shading_kernels import draw_features, linear_equations
from photoreg.polish.shading_term import (
    NO_TEXTURE,
    NO_UV,
    ShadingTerm,
    fit_shading,
)
from tests.polish.naive_shading import naive_equations, naive_features
from tests.polish_scene import colours, make_polish_scene
from tests.scenes import small_scene

REACH_PX = 8.0


@pytest.fixture(scope="module")
def scene():
    """A rock of one colour in the light of lamps."""
    return small_scene(
        kind="hard", contrast=0.0, mesh_noise=0.0, light="same", width=512, height=384
    )


def fit(scene, photo, camera):
    view = surface_view(scene.mesh, camera)
    return view, fit_shading(
        photo, view, surface_descriptors(scene.mesh), REACH_PX, 8_000
    )


def of_values(photo, table):
    return dataclasses.replace(photo, pixels=table.astype(np.uint8)[photo.pixels])


def test_features_are_those_of_the_slow_twin(scene):
    camera, found = scene.cameras[0], surface_descriptors(scene.mesh)
    view = surface_view(scene.mesh, camera)
    normals = np.stack([found.normals, found.coarse_normals])
    scalars = np.column_stack([found.occlusion, found.curvature])
    drawn = draw_features(
        camera.record,
        camera.center,
        view.face_index,
        scene.mesh.vertices,
        scene.mesh.faces,
        normals,
        scalars,
        NO_UV,
        NO_TEXTURE,
    )
    assert not drawn[:, ~view.covered].any()
    rows, columns = np.nonzero(view.inner > 2.0)
    some = np.random.default_rng(0).choice(len(rows), 40, replace=False)
    pixels = np.column_stack([columns[some], rows[some]])
    slow = naive_features(scene.mesh, camera, pixels, normals, scalars)
    gap = np.abs(drawn[:, rows[some], columns[some]].T - slow).max()
    assert gap < 1e-4, gap


def test_equations_are_those_of_the_slow_twin_and_of_finite_differences():
    rng = np.random.default_rng(1)
    residual, slopes = 2.0 * rng.normal(size=(60, 3)), rng.normal(size=(60, 3, 5))
    step, starts = 0.3 * rng.normal(size=5), np.array([0, 7, 30, 60])
    cost, gradients, normal = linear_equations(residual, slopes, step, starts, 2.0)
    slow = naive_equations(residual, slopes, step, 2.0)
    np.testing.assert_allclose(cost, slow[0])
    np.testing.assert_allclose(gradients.sum(axis=0), slow[1])
    np.testing.assert_allclose(normal, slow[2])
    part = naive_equations(residual[7:30], slopes[7:30], step, 2.0)
    np.testing.assert_allclose(gradients[1], part[1])
    for k, unit in enumerate(1e-6 * np.eye(5)):
        ahead, behind = (
            naive_equations(residual, slopes, step + sign * unit, 2.0)[0]
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(slow[1][k], (ahead - behind) / 2e-6, rtol=1e-5)


@pytest.mark.parametrize(
    "table",
    [np.arange(256), 255 - np.arange(256), np.abs(2 * np.arange(256) - 170) % 256],
    ids=["as it is", "inverted", "not monotone"],
)
def test_shape_explains_shading_whatever_the_sensor_made_of_it(scene, table):
    photo, camera = of_values(scene.photos[0], table), scene.cameras[0]
    _, right = fit(scene, photo, camera)
    _, wrong = fit(scene, photo, scene.rough_cameras[0])
    assert right is not None
    assert wrong is not None
    # 0.79 to 0.86 were measured, and 0.66 to 0.69 at the rough camera, 7 px off.
    assert right.explained > 0.7, right.explained
    assert wrong.explained < right.explained - 0.08, (wrong.explained, right.explained)


def test_shape_explains_neither_paint_nor_noise(scene):
    painted = small_scene(kind="clean", light="flat")
    _, found = fit(painted, painted.photos[0], painted.cameras[0])
    assert found is not None
    assert found.explained < 0.1, found.explained
    noise = np.random.default_rng(0).integers(0, 256, scene.photos[0].pixels.shape)
    photo = dataclasses.replace(scene.photos[0], pixels=noise.astype(np.uint8))
    _, found = fit(scene, photo, scene.cameras[0])
    assert found is not None
    assert found.explained < 0.02, found.explained


def test_colours_of_the_mesh_explain_paint():
    made = make_polish_scene()
    photo, camera = made.photos[0], made.cameras[0]
    painted = np.clip(colours(made.mesh.vertices), 0, 255).astype(np.uint8)
    shares = []
    for mesh in (made.mesh, dataclasses.replace(made.mesh, vertex_colours=painted)):
        view = surface_view(mesh, camera)
        found = fit_shading(photo, view, surface_descriptors(mesh), REACH_PX, 8_000)
        assert found is not None
        shares.append(found.explained)
    assert shares[0] < 0.1 < 0.5 < shares[1], shares


def test_a_texture_is_drawn_where_its_coordinates_say():
    corners = np.array([[0.0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    camera = Camera.look_at([1.9, 1.6, -9], [2.1, 1.4, 0], [0.1, -1, 0], 300, 160, 120)
    texture = np.random.default_rng(0).uniform(0, 255, (6, 8, 3)).astype(np.float32)
    uv = corners[:, :2] / (4.0, 3.0) + (1.0, -2.0)  # It repeats itself.
    view = surface_view(Mesh(corners, faces), camera)
    one = np.ones((1, 4, 3)), np.zeros((4, 0))
    drawn = draw_features(
        camera.record,
        camera.center,
        view.face_index,
        corners,
        faces.astype(np.int32),
        *one,
        uv[faces],
        texture,
    )[8:]
    rows, columns = np.nonzero(view.covered)
    pixels = np.column_stack([columns, rows]).astype(float)
    center, rays = camera.rays(pixels)
    points = center - rays * (center[2] / rays[:, 2:])
    places = points[:, :2] / (4.0, 3.0) * (8, 6)
    maps = (places * (1, -1) + (-0.5, 5.5)).astype(np.float32)[None]
    wanted = cv2.remap(
        texture,
        maps[..., 0],
        maps[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )[0]
    # cv2 rounds the place to a 32nd of a texel.
    gap = np.abs(drawn[:, rows, columns].T - wanted)
    assert np.median(gap) < 3.0, np.median(gap)
    assert gap.max() < 25.0, gap.max()


def test_too_little_of_the_surface_is_no_fit(scene):
    mask = np.zeros((scene.photos[0].height, scene.photos[0].width), dtype=bool)
    mask[:10] = True
    photo = dataclasses.replace(scene.photos[0], mask=mask)
    assert fit(scene, photo, scene.cameras[0])[1] is None


@pytest.fixture(scope="module")
def term(scene):
    """The term at a camera whose principal point is off by two pixels and one."""
    camera = scene.cameras[0]
    K = camera.K.copy()
    K[:2, 2] += (2.0, -1.0)
    wrong = dataclasses.replace(camera, K=K)
    view, found = fit(scene, scene.photos[0], wrong)
    assert found is not None
    increments = Increments(wrong, scene.mesh.centroid, PriorScales())
    return ShadingTerm.measured(0, found, view, increments, np.zeros(9))


def test_the_gradient_is_that_of_the_cost(term):
    assert isinstance(term, Term)
    x = 0.2 * np.random.default_rng(2).normal(size=9)
    model = term.linearise(x)
    for k, unit in enumerate(1e-5 * np.eye(9)):
        ahead, behind = (term.linearise(x + s * unit).cost for s in (1.0, -1.0))
        slope = (ahead - behind) / 2e-5
        np.testing.assert_allclose(
            model.gradient[k], slope, rtol=1e-4, atol=1e-4 * abs(model.gradient).max()
        )
    np.testing.assert_allclose(model.normal, model.normal.T)
    assert np.linalg.eigvalsh(model.normal).min() > -1e-6 * model.normal.max()


def test_it_draws_the_principal_point_to_where_the_shading_is(term):
    prior = Prior(np.zeros(9), 0.1 * np.eye(9))
    *_, last = minimise([prior, term], np.zeros(9), Damping(), np.eye(9)[:, PRINCIPAL])
    moved = term.increments.camera(last.x).K[:2, 2] - term.increments.base.K[:2, 2]
    # One step, to first order: half of the way or more; the rest is for the next round.
    left = moved - (-2.0, 1.0)
    assert np.linalg.norm(left) < 0.5 * np.hypot(2.0, 1.0), moved


def test_tempering_trusts_it_less_and_its_scatter_is_a_covariance(term):
    x = np.zeros(9)
    tempered = term.tempered(x)
    assert 0.0 < tempered.weight <= term.weight
    scatter = tempered.scatter(x)
    np.testing.assert_allclose(scatter, scatter.T)
    assert np.linalg.eigvalsh(scatter).min() > -1e-9 * scatter.max()
