"""Cameras found by what photos show alike: near the truth before clutter, or not at all."""

import dataclasses

import numpy as np
import pytest

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.geometry.ray_hits import surface_hits
from photoreg.geometry.rotations import rotation_vector
from photoreg.imaging.photo import Photo
from photoreg.placing.cloud_fit import CloudFit
from photoreg.placing.common_points import place_by_points
from photoreg.placing.outcome import Placed, PlacingStep
from photoreg.placing.two_views import Features, features_of, matched, two_views
from photoreg.synthetic.scene import Scene
from tests.scenes import small_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    # The rig's principal points lie off the middle, as nobody tells the finder.
    return small_scene(
        seed=3, kind="clutter", n_photos=3, width=512, height=384, error_px=(8.0, 12.0)
    )


@pytest.fixture(scope="module")
def features(scene: Scene) -> list[Features]:
    return [features_of(photo) for photo in scene.photos]


def angle_deg(R: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(rotation_vector(R))))


def test_two_photos_tell_their_relative_pose_and_points_up_to_scale(scene, features):
    a, b = scene.cameras[:2]
    matches = matched(features[0], features[1])
    assert len(np.unique(np.hstack(matches), axis=0)) == len(matches[0])
    back = matched(features[1], features[0])
    np.testing.assert_array_equal(
        np.unique(np.hstack(back[::-1]), axis=0), np.hstack(matches)
    )
    views = two_views(scene.photos[:2], matches, (a.focal_px, b.focal_px))
    again = two_views(scene.photos[:2], matches, (a.focal_px, b.focal_px))
    assert views is not None
    assert again is not None
    np.testing.assert_array_equal(again.points, views.points)
    first, second = views.cameras
    np.testing.assert_array_equal(first.P[:, 3], 0.0)
    R_b_a = b.R_cam_world @ a.R_cam_world.T
    t_b_a = b.t_cam_world - R_b_a @ a.t_cam_world
    assert angle_deg(second.R_cam_world @ R_b_a.T) < 1.5
    baseline = np.linalg.norm(t_b_a)
    assert second.t_cam_world @ t_b_a / baseline > np.cos(np.radians(4.0))
    # Where the first photo shows the object, the points lie on it.
    pixels = first.project(views.points)
    met, hits = surface_hits(scene.true_mesh, *a.rays(pixels))
    assert met.sum() > 50
    depth = a.to_camera(hits.points)[:, 2] / baseline
    ratio = views.points[met, 2] / depth
    assert abs(np.median(ratio) - 1.0) < 0.05
    assert np.percentile(ratio, 75) - np.percentile(ratio, 25) < 0.05


def test_what_a_mask_leaves_out_has_no_features(scene, features):
    photo = scene.photos[0]
    left = np.indices(photo.pixels.shape[:2])[1] < 200
    masked = features_of(dataclasses.replace(photo, mask=left)).pixels
    assert len(masked) > 100
    assert masked[:, 0].max() < 201.0
    assert features[0].pixels[:, 0].max() > 400.0


def test_photos_of_nothing_in_common_tell_nothing(scene):
    grey = Photo("grey.png", np.full((120, 160, 3), 90, np.uint8))
    nothing = features_of(grey)
    assert len(nothing.pixels) == 0
    matches = matched(nothing, features_of(scene.photos[0]))
    assert len(matches[0]) == 0
    assert two_views((grey, scene.photos[0]), matches, (200.0, 400.0)) is None
    *_, last = place_by_points(scene.mesh, [grey, scene.photos[0]], {})
    assert isinstance(last, Placed)
    assert last.grade == "not found"
    assert not any(one.candidates for one in last.placements)
    assert all("draw a box" in one.sentence.lower() for one in last.placements)


def test_a_mesh_is_fitted_to_points_of_unknown_scale_among_others(scene):
    camera, mesh = scene.cameras[0], scene.mesh
    rng = np.random.default_rng(0)
    pixels = rng.random((600, 2)) * [camera.width, camera.height]
    met, hits = surface_hits(mesh, *camera.rays(pixels))
    seen = camera.to_camera(hits.points)
    # A fifth of the points are of things behind.
    _, rays = camera.rays(pixels[~met][: met.sum() // 4])
    behind = rays @ camera.R_cam_world.T
    behind *= (2.0 * np.median(seen[:, 2]) / behind[:, 2])[:, None]
    points = np.vstack([seen, behind]) / 7.0
    share = camera.focal_px / max(camera.width, camera.height)
    best = CloudFit(mesh).poses(rng.permutation(points), share, 1)[0]
    assert angle_deg(best.R_cam_world @ camera.R_cam_world.T) < 0.5
    assert np.linalg.norm(best.center - camera.center) < 0.01 * mesh.diagonal
    assert best.scale == pytest.approx(7.0, rel=0.01)
    assert 0.75 < best.share < 0.85


def test_three_photos_before_clutter_are_found(scene):
    focals = {
        photo.name: camera.focal_px
        for photo, camera in zip(scene.photos, scene.cameras, strict=True)
    }
    *steps, last = place_by_points(scene.mesh, scene.photos, focals)
    fractions = [step.fraction for step in steps if isinstance(step, PlacingStep)]
    assert fractions == sorted(fractions)
    assert isinstance(last, Placed)
    assert last.grade == "unsure", "a refinement must judge"
    cameras = [one.candidates[0] for one in last.placements]
    errors = projection_error(scene.true_mesh, scene.cameras, cameras).cameras
    # 40 px at 1,024 is what a refinement takes.
    assert max(error.mean for error in errors) < 20.0


def test_photos_of_another_object_are_not_found(scene):
    other = small_scene(seed=8, kind="clutter", width=512, height=384)
    stretched = Mesh(other.mesh.vertices * [1.0, 0.3, 2.0], other.mesh.faces)
    *_, last = place_by_points(
        stretched,
        scene.photos[:2],
        {
            photo.name: camera.focal_px
            for photo, camera in zip(scene.photos, scene.cameras, strict=True)
        },
    )
    assert isinstance(last, Placed)
    assert last.grade == "not found", [one.sentence for one in last.placements]


def test_a_photo_whose_focal_length_exif_rounds_is_found_all_the_same(scene):
    photos = [
        dataclasses.replace(photo, exif_focal_px=0.93 * camera.focal_px)
        for photo, camera in zip(scene.photos[:2], scene.cameras[:2], strict=True)
    ]
    *_, last = place_by_points(scene.mesh, photos, {})
    assert isinstance(last, Placed)
    cameras = [one.candidates[0] for one in last.placements]
    errors = projection_error(scene.true_mesh, scene.cameras[:2], cameras).cameras
    assert max(error.mean for error in errors) < 20.0
