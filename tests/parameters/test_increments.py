"""Nine numbers that move a camera: round trips, derivatives, the pivot stays."""

import dataclasses
import itertools

import numpy as np
import pytest

from photoreg.geometry.camera import MAX_FOCAL_PX, Camera
from photoreg.geometry.lens import Lens
from photoreg.geometry.rotations import rotation_matrix, rotation_vector
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.freedom import Held
from photoreg.parameters.increments import Increments
from photoreg.polish.kernels import rim_rows


@pytest.fixture
def increments():
    K = np.array([[900.0, 1.5, 310.0], [0.0, 880.0, 260.0], [0.0, 0.0, 1.0]])
    base = Camera(
        K,
        rotation_matrix(np.array([0.3, -0.5, 0.2])),
        np.array([0.2, -0.1, 6.0]),
        640,
        480,
    )
    return Increments(base, np.array([0.1, 0.2, -0.3]), PriorScales())


X = np.array([0.7, -1.2, 0.4, 0.3, -0.8, 1.1, -0.9, 1.5, -0.6])


def test_of_camera_inverts_camera(increments):
    back = increments.of_camera(increments.camera(X))
    assert np.abs(back - X).max() < 1e-10, back - X


def test_zero_is_the_base(increments):
    assert np.abs(increments.camera(np.zeros(9)).P - increments.base.P).max() < 1e-10


def test_rotation_leaves_the_pivot_where_it_is(increments):
    turned = increments.camera(np.array([3.0, -2.0, 5.0, 0, 0, 0, 0, 0, 0]))
    pivot = increments.pivot[None]
    gap = np.abs(turned.project(pivot) - increments.base.project(pivot)).max()
    assert gap < 1e-9, gap


def test_rotation_vector_inverts_rotation_also_near_zero():
    for size in (1e-10, 1e-5, 0.1, 3.0):
        vector = size * np.array([0.6, -0.3, 0.74162])
        gap = np.abs(rotation_vector(rotation_matrix(vector)) - vector).max()
        assert gap < 1e-9, (size, gap)


@pytest.mark.parametrize("lens", [Lens(), Lens(-0.12, 0.04, 0.002, -0.001, 0.01)])
@pytest.mark.parametrize("distortion", ["none", "k1", "k1k2", "full"])
def test_projection_rows_are_the_finite_differences(increments, distortion, lens):
    increments = dataclasses.replace(
        increments, base=increments.base.with_lens(lens), distortion=distortion
    )
    n = increments.n
    assert n == {"none": 9, "k1": 10, "k1k2": 11, "full": 14}[distortion]
    x = np.append(X, [0.3, -0.4, 0.5, 0.2, -0.6])[:n]
    points = np.random.default_rng(0).normal(size=(20, 3))
    pixels, rows = rim_rows(increments.record(x, 640, 480), points, n)
    assert np.abs(pixels - increments.camera(x).project(points)).max() < 1e-8
    assert np.abs(increments.of_camera(increments.camera(x)) - x).max() < 1e-10
    for j in range(n):
        step = np.zeros(n)
        step[j] = 1e-5
        ahead = increments.camera(x + step).project(points)
        behind = increments.camera(x - step).project(points)
        gap = np.abs((ahead - behind) / 2e-5 - rows[:, :, j]).max()
        assert gap < 1e-5, (j, gap)


def test_a_lens_that_is_held_stays_to_the_last_bit(increments):
    lens = Lens(-0.12, 0.04, 0.002)
    base = increments.base.with_lens(lens)
    for held in (Held(lens=True), Held(focal=True, principal_point=True, pose=True)):
        own = dataclasses.replace(increments, base=base, held=held, distortion="full")
        assert own.camera(np.ones(14)).lens == lens
        assert not own.units[9:].any()


def test_geometry_of_a_reduced_photo_is_the_resized_camera(increments):
    points = np.random.default_rng(0).normal(size=(20, 3))
    pixels, _ = rim_rows(increments.record(X, 160, 120), points, 9)
    expected = increments.camera(X).resized(160, 120).project(points)
    assert np.abs(pixels - expected).max() < 1e-9


@pytest.mark.parametrize("scale", [1.0, 2.7, 1e3])
def test_every_vector_within_the_limits_is_a_camera(increments, scale):
    scales = PriorScales(*(scale * one for one in dataclasses.astuple(PriorScales())))
    wide = dataclasses.replace(increments, scales=scales)
    signs = np.array(list(itertools.product([-1.0, 1.0], repeat=9)))
    for x in signs * wide.limits:
        camera = wide.camera(x)
        assert np.abs(wide.of_camera(camera) - x).max() < 1e-6 * np.abs(x).max()
        # The object is still before it.
        assert camera.to_camera(wide.pivot[None])[0, 2] > 0.0


def test_a_camera_of_the_longest_focal_length_has_nowhere_longer_to_go(increments):
    K = increments.base.K.copy()
    K[0, 0] = K[1, 1] = MAX_FOCAL_PX
    base = dataclasses.replace(increments.base, K=K)
    at_end = dataclasses.replace(increments, base=base)
    assert at_end.limits[6] == 0.0


def test_a_cropped_photo_s_principal_point_moves_far_at_no_cost_of_aim(increments):
    wide = dataclasses.replace(increments, is_cropped=True)
    assert wide.units[7:] == pytest.approx(24.0 * increments.units[7:])
    # The same camera as a person aims it: the object is back in its place once the
    # principal point has moved by 60 px.
    base, moved = increments.base, np.array([60.0, -45.0])
    K = base.K.copy()
    K[:2, 2] += moved
    depth = base.to_camera(increments.pivot[None])[0, 2]
    turn = rotation_matrix(np.array([moved[1] / K[1, 1], -moved[0] / K[0, 0], 0.0]))
    R = turn @ base.R_cam_world
    pixel = base.project(increments.pivot[None])[0]
    t = depth * np.linalg.solve(K, [*pixel, 1.0]) - R @ increments.pivot
    aimed = dataclasses.replace(base, K=K, R_cam_world=R, t_cam_world=t)
    x = wide.of_camera(aimed)
    alone = np.zeros(9)
    alone[7:] = x[7:]
    # Skew and second-order terms are left.
    assert abs(x @ wide.precision @ x / (alone @ alone) - 1.0) < 0.02
    assert x @ x > 5.0 * (alone @ alone)
    assert np.array_equal(increments.precision, np.eye(9))
    held = dataclasses.replace(wide, held=Held(pose=True))
    assert np.array_equal(held.precision, np.eye(9))
