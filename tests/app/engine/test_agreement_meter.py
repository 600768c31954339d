"""The number beside the status: how well the photos agree."""

import dataclasses

import numpy as np
import pytest

from app.engine.agreement_meter import AgreementMeter
from app.model.camera_moves import nudged
from app.model.state import Agreement
from photoreg.geometry.projection_error import projection_error
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import Scene, make_scene
from tests.scenes import on_a_site


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(SceneOptions(kind="clean", width=640, height=480))


@pytest.fixture(scope="module")
def judge(scene) -> AgreementMeter:
    return AgreementMeter(scene.mesh, scene.photos)


@pytest.mark.workqueue
def test_the_true_cameras_agree_and_agreement_falls_as_one_is_moved(scene, judge):
    anchor = scene.mesh.bounds.mean(axis=0)
    shares, errors = [], []
    for shift_px in (0.0, 4.0, 10.0, 20.0):
        moved = nudged(scene.cameras[0], anchor, shift_px, 0.5 * shift_px, 0.0)
        cameras = (moved, *scene.cameras[1:])
        share = judge.agreement(cameras).share
        assert share is not None
        shares.append(share)
        errors.append(projection_error(scene.mesh, scene.cameras, cameras).mean)
    told = ", ".join(
        f"{e:.1f} px: {s:.2f}" for e, s in zip(errors, shares, strict=True)
    )
    assert shares[0] > 0.97, told
    assert all(np.diff(shares) < -0.02), told
    assert shares[-1] < 0.75, told


def test_the_order_of_the_photos_does_not_matter(scene, judge):
    cameras = scene.rough_cameras
    one = judge.agreement(cameras)
    other = AgreementMeter(scene.mesh, scene.photos[::-1]).agreement(cameras[::-1])
    assert one.share_seen == other.share_seen
    assert one.share == pytest.approx(other.share, abs=1e-3)


def test_a_detail_of_a_large_site_is_measured(scene):
    site = on_a_site(scene, 30.0)
    meter = AgreementMeter(site, scene.photos)
    shares = []
    for cameras in (scene.rough_cameras, scene.cameras):
        found = meter.agreement(cameras)
        assert found.share is not None
        assert found.share_seen > 0.3
        shares.append(found.share)
    rough, true = shares
    assert true > 0.97, shares
    assert rough < 0.95, shares


def test_cameras_that_share_nothing_have_no_agreement(scene, judge):
    first = scene.cameras[0]
    R = first.R_cam_world
    turn = R.T @ np.diag([-1.0, 1.0, -1.0]) @ R
    centre = scene.mesh.bounds.mean(axis=0)
    # The same photo from the opposite side of the object.
    opposite = dataclasses.replace(
        first,
        R_cam_world=R @ turn,
        t_cam_world=first.t_cam_world + R @ (centre - turn @ centre),
    )
    found = judge.agreement((first, opposite))
    assert found.share is None, found
    assert found.share_seen < 0.05


def test_a_share_is_never_outside_of_nothing_and_all():
    assert Agreement(30.0, 10.0, 0.5).share == 0.0
    assert Agreement(0.0, 10.0, 0.5).share == 1.0
    assert Agreement(float("inf"), 10.0, 0.1).share is None
