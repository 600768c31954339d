"""Rendering: pixels fall where Camera.project says, and are means over their squares."""

import numpy as np
import pytest

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.ray_hits import surface_hits
from photoreg.synthetic.render import (
    decode_srgb,
    encode_srgb,
    render_linear,
    sky_and_key_light,
)
from tests.scenes import small_scene


def slanted_square() -> Mesh:
    """A square of side 4 across the view, its right side farther away."""
    corners = np.array([[-2, -2, -0.8], [2, -2, 0.8], [2, 2, 0.8], [-2, 2, -0.8]])
    return Mesh(corners + np.array([0.1, -0.2, 6.0]), np.array([[0, 2, 1], [0, 3, 2]]))


def camera(width: int = 120, height: int = 90) -> Camera:
    x, y = 0.4775 * width, 0.5211 * height
    K = np.array([[130.0, 0.0, x], [0.0, 130.0, y], [0.0, 0.0, 1.0]])
    return Camera(K, np.eye(3), np.zeros(3), width, height)


def black(_, pixels):
    return np.zeros((len(pixels), 3))


def test_a_small_disc_appears_centred_where_its_middle_projects():
    mesh = slanted_square()
    worst = 0.0
    for x, y in np.random.default_rng(3).uniform(-1.3, 1.3, (12, 2)):
        middle = np.array([x + 0.1, y - 0.2, 6.0 + 0.4 * x])

        def disc(hits, middle=middle):
            near = np.linalg.norm(hits.points - middle, axis=1) < 0.16
            return near[:, None] * np.ones(3)

        image = render_linear(mesh, camera(), disc, black, supersampling=3)[:, :, 0]
        rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
        seen = np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()
        worst = max(worst, np.abs(seen - camera().project(middle[None])[0]).max())
    # The disc is 7 px wide: foreshortening moves its centroid by 0.02 px.
    assert worst < 0.05, worst


def test_a_pixel_is_the_mean_over_the_square_around_its_centre():
    # In front of x_pixel = 20.0 + 1/6 the surface is white: two of three columns of
    # samples in pixel 20, all of pixel 19, none of pixel 21.
    def shade(hits):
        x = camera().project(hits.points)[:, 0]
        return (x < 20.0 + 1.0 / 6.0)[:, None] * np.ones(3)

    image = render_linear(slanted_square(), camera(), shade, black, supersampling=3)
    np.testing.assert_allclose(image[45, 19:22, 0], [1.0, 2.0 / 3.0, 0.0], atol=1e-6)


def test_pixels_at_the_rim_mix_object_and_backdrop_by_the_area_each_covers():
    mesh = slanted_square()
    image = render_linear(
        mesh, camera(200, 160), lambda hits: np.ones((len(hits.points), 3)), black, 4
    )
    outline = camera().project(mesh.vertices)
    x, y = outline[:, 0], outline[:, 1]
    area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
    assert image[:, :, 0].sum() == pytest.approx(area, rel=2e-3)
    assert ((image > 0.05) & (image < 0.95)).any()


def test_hits_lie_on_their_rays_and_faces():
    mesh = small_scene().true_mesh
    view = small_scene().cameras[0]
    pixels = np.random.default_rng(0).uniform([0, 0], [319, 239], (500, 2))
    origin, rays = view.rays(pixels)
    met, hits = surface_hits(mesh, origin, rays)
    assert 100 < met.sum() < 500
    np.testing.assert_allclose(view.project(hits.points), pixels[met], atol=1e-3)
    corners = mesh.vertices[mesh.faces[hits.face]]
    on_face = np.einsum("nc,ncd->nd", hits.weights, corners)
    assert np.abs(on_face - hits.points).max() < 1e-12 * mesh.diagonal + 1e-12
    assert hits.weights.min() >= 0.0
    np.testing.assert_allclose(np.linalg.norm(hits.normals, axis=1), 1.0, atol=1e-12)


def test_srgb_round_trips_and_meets_the_standards_values():
    values = np.arange(256.0)
    np.testing.assert_allclose(encode_srgb(decode_srgb(values)), values, atol=1e-3)
    # IEC 61966-2-1: middle grey of 18 % is 117.6 of 255.
    assert encode_srgb(np.array(0.18)) == pytest.approx(117.6, abs=0.1)


def test_light_is_less_in_hollows_and_in_shadow():
    # A floor, and a wall on it at x = 0; the lamp stands low on the side of x < 0.
    n = 41
    x, y = np.meshgrid(np.linspace(-2, 2, n), np.linspace(-2, 2, n), indexing="ij")
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)])
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.vstack(
        [np.column_stack([i, i + n, i + n + 1]), np.column_stack([i, i + n + 1, i + 1])]
    )
    wall = np.array([[0, -2, 0.01], [0, 2, 0.01], [0, 2, 1], [0, -2, 1.0]])
    mesh = Mesh(
        np.vstack([floor, wall]),
        np.vstack([faces, n * n + np.array([[0, 2, 1], [0, 3, 2]])]),
    )
    up = np.array([0.0, 0.0, 1.0])
    key = np.array([-1.0, 0.0, 1.0])
    light = sky_and_key_light(mesh, up, key, key_share=0.5, key_spread=0.05)
    before = light[np.argmin(np.linalg.norm(floor - [-1.5, 0, 0], axis=1))]
    behind = light[np.argmin(np.linalg.norm(floor - [0.4, 0, 0], axis=1))]
    beyond = light[np.argmin(np.linalg.norm(floor - [1.8, 0, 0], axis=1))]
    assert behind < beyond - 0.2, (behind, beyond)
    assert behind < before - 0.2, (behind, before)
    assert light.min() >= 0.0
    assert light.max() <= 1.0
