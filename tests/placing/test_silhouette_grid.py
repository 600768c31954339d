"""The grid of silhouettes: as its slow twin has it, and near the truth on made scenes."""

import numpy as np
import pytest

from photoreg.geometry.rasteriser import render_geometry
from photoreg.placing.silhouette_grid import (
    ANGLES,
    RADII,
    SilhouetteGrid,
    angle_deg,
    fibonacci_sphere,
    overlaps,
    polar_map,
)
from tests.placing.naive_overlap import naive_overlaps
from tests.scenes import small_scene


def test_overlaps_of_all_turns_are_those_counted_cell_by_cell():
    rng = np.random.default_rng(0)
    one = (rng.random((RADII, ANGLES)) < 0.4).astype(float)
    others = (rng.random((2, RADII, ANGLES)) < 0.6).astype(float)
    fast = overlaps(one, others)
    for row, other in zip(fast, others, strict=True):
        np.testing.assert_allclose(row, naive_overlaps(one, other), atol=1e-9)


def test_a_silhouette_overlaps_itself_turned_at_that_turn():
    scene = small_scene()
    camera = scene.cameras[0]
    covered = render_geometry(scene.mesh, camera).covered
    found = polar_map(covered.astype(np.float32), camera)
    assert found is not None
    turned = np.roll(found.cover, 17, axis=1)
    scores = overlaps(turned, found.cover[None])[0]
    assert scores.argmax() == 17
    # Cells on the rim are covered in part, which counts as if by chance.
    assert scores.max() > 0.9


def test_viewpoints_are_spread_evenly():
    points = fibonacci_sphere(600)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0)
    cosines = points @ points.T - 2.0 * np.eye(len(points))
    nearest = np.degrees(np.arccos(cosines.max(axis=1)))
    assert nearest.min() > 4.5
    assert nearest.max() < 9.0


@pytest.mark.parametrize("view", [0, 1])
def test_the_true_view_is_near_one_of_the_first_poses(view):
    scene = small_scene(seed=3)
    camera = scene.cameras[view]
    covered = render_geometry(scene.true_mesh, camera).covered
    poses = SilhouetteGrid(scene.mesh).poses(covered, camera, 40)
    off = [angle_deg(pose.R_cam_world, camera.R_cam_world) for pose in poses]
    assert min(off[:5]) < 10.0, off[:5]
    best = poses[int(np.argmin(off[:5]))]
    middle = scene.mesh.bounds.mean(axis=0)
    at = best.R_cam_world @ middle + best.t_cam_world
    true = camera.R_cam_world @ middle + camera.t_cam_world
    assert np.linalg.norm(at - true) < 0.1 * np.linalg.norm(true)
    for i, pose in enumerate(poses):
        for other in poses[:i]:
            assert angle_deg(pose.R_cam_world, other.R_cam_world) >= 9.0
    assert [pose.overlap for pose in poses] == sorted(
        (pose.overlap for pose in poses), reverse=True
    )
