"""Genes to cameras and back, the box, and the first population of the paper's eq. 4."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.rotations import rotation_matrices, rotation_vectors
from photoreg.parameters.gene_box import GeneBox
from photoreg.parameters.genes import GeneMap

PIVOT = np.array([0.2, -0.1, 0.3])
KINDS = [
    (model, coordinates)
    for model in ("pinhole", "full")
    for coordinates in ("camera", "object")
]


def cameras() -> list[Camera]:
    # Nothing is symmetric: a skew, fx != fy, principal points off the middle.
    first = Camera.look_at(
        [3.0, 1.0, -4.0], [0.1, 0.0, 0.2], [0, -1, 0.1], 900, 640, 480
    )
    second = Camera.look_at([-2.0, 0.5, -5.0], PIVOT, [0.2, -1, 0], 1100, 800, 500)
    K = np.array([[910.0, 3.0, 330.0], [0.0, 880.0, 221.0], [0.0, 0.0, 1.0]])
    return [Camera(K, first.R_cam_world, first.t_cam_world, 640, 480), second]


def gene_map(model: Any = "pinhole", coordinates: Any = "camera", box=None) -> GeneMap:
    return GeneMap(cameras(), PIVOT, box, model, coordinates)


@pytest.mark.parametrize(("model", "coordinates"), KINDS)
@given(seed=st.integers(0, 10_000), reach=st.sampled_from([1e-6, 0.3, 1.0]))
@settings(max_examples=40, deadline=None)
def test_genes_survive_the_way_to_cameras_and_back(model, coordinates, seed, reach):
    genes = gene_map(model, coordinates)
    vector = reach * np.random.default_rng(seed).uniform(-1, 1, genes.n_genes)
    back = genes.to_genes(genes.to_cameras(vector))
    worst = np.abs(back - vector).max()
    assert worst < 1e-8, worst


@pytest.mark.parametrize(("model", "coordinates"), KINDS)
def test_zero_genes_are_the_start(model, coordinates):
    genes = gene_map(model, coordinates)
    for start, same in zip(
        cameras(), genes.to_cameras(np.zeros(genes.n_genes)), strict=True
    ):
        np.testing.assert_allclose(same.P, start.P, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize(("model", "n_genes"), [("pinhole", 18), ("full", 22)])
def test_a_pair_has_the_papers_number_of_genes(model, n_genes):
    assert gene_map(model).n_genes == n_genes == len(gene_map(model).names())


@pytest.mark.parametrize(("model", "coordinates"), KINDS)
def test_poses_are_those_of_the_cameras(model, coordinates):
    genes = gene_map(model, coordinates)
    vectors = np.random.default_rng(2).uniform(-1, 1, (5, genes.n_genes))
    poses = genes.poses(vectors)
    for p, vector in enumerate(vectors):
        for c, camera in enumerate(genes.to_cameras(vector)):
            np.testing.assert_allclose(poses.P[p, c], camera.P, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(poses.centers[p, c], camera.center, atol=1e-12)


def test_the_ends_of_the_camera_intervals_are_the_papers():
    genes = gene_map()
    start = cameras()[1]
    ends = genes.to_cameras(np.ones(18))[1]
    assert ends.K[0, 0] / start.K[0, 0] == pytest.approx(1.02)
    assert ends.K[0, 2] - start.K[0, 2] == pytest.approx(0.005 * 800)
    assert ends.K[1, 2] - start.K[1, 2] == pytest.approx(0.005 * 500)
    distance = np.linalg.norm(start.center - PIVOT)
    np.testing.assert_allclose(ends.center - start.center, 0.03 * distance)
    turn = rotation_vectors((ends.R_cam_world @ start.R_cam_world.T)[None])[0]
    np.testing.assert_allclose(np.degrees(turn), 1.0)


def test_object_genes_move_the_object_as_their_names_say():
    genes = gene_map("pinhole", "object")
    start = cameras()[0]
    before = start.project(PIVOT[None])[0]
    for name, n_moved_px in (
        ("focal length", 0.0),
        ("principal point x", 0.0),
        ("rotation y", 0.0),
        ("size in the photo", 0.0),
        ("place in the photo x", genes.box.shift * 640),
    ):
        vector = np.zeros(18)
        vector[genes.names().index(f"camera 1: {name}")] = 1.0
        after = genes.to_cameras(vector)[0].project(PIVOT[None])[0]
        moved = np.linalg.norm(after - before)
        assert moved == pytest.approx(n_moved_px, abs=1e-6), (name, moved)


def test_the_principal_point_gene_leaves_the_camera_where_it_is():
    genes = gene_map("pinhole", "object")
    vector = np.zeros(18)
    vector[genes.names().index("camera 2: principal point x")] = 1.0
    start, moved = cameras()[1], genes.to_cameras(vector)[1]
    apart = np.linalg.norm(moved.center - start.center)
    # A turn by the tangent in place of the arc: third order in 4 px of 1,100.
    assert apart < 1e-4, apart


def test_first_population_ties_focal_length_to_distance():
    genes = gene_map()
    tied = genes.first_population(300, np.random.default_rng(0))
    free = genes.first_population(300, np.random.default_rng(0), False)
    spread = []
    for vectors in (tied, free):
        poses = genes.poses(vectors)
        k_focal = poses.K[..., 0, 0] / [c.K[0, 0] for c in cameras()]
        away = np.linalg.norm(poses.centers - PIVOT, axis=-1)
        spread.append(np.abs(away / genes.distances / k_focal - 1.0).max())
    # Sideways steps of 3 % lengthen the distance, and the box cuts some draws short.
    assert spread[0] < 0.01 < 0.04 < spread[1], spread
    assert np.abs(tied).max() <= 1.0


@given(seed=st.integers(0, 1000))
@settings(max_examples=50, deadline=None)
def test_rotations_are_rotations_and_their_vectors_come_back(seed):
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(4, 3)) * rng.choice([1e-9, 0.1, 1.0])
    vectors *= np.minimum(1.0, 3.0 / np.linalg.norm(vectors, axis=1, keepdims=True))
    R = rotation_matrices(vectors)
    np.testing.assert_allclose(
        R @ np.swapaxes(R, 1, 2), np.eye(3)[None] + 0 * R, atol=1e-12
    )
    np.testing.assert_allclose(rotation_vectors(R), vectors, atol=1e-9)


def test_a_widened_box_leaves_the_principal_point():
    wide = GeneBox().widened(2.0)
    assert (wide.focal, wide.rotation_deg, wide.principal_point) == (0.04, 2.0, 0.005)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_an_interval_without_width_is_refused(value):
    with pytest.raises(InputError, match=r"box\.focal is .*; give a number above 0"):
        GeneBox(focal=value)


def test_a_camera_that_looks_away_is_refused():
    behind = Camera.look_at([0, 0, -3], [0, 0, -9], [0, 1, 0], 500, 320, 240)
    with pytest.raises(InputError, match="Camera 1 looks away"):
        GeneMap([behind], PIVOT, coordinates="object")
