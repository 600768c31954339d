"""The search's term that asks whether the object lies where its colours are."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.parameters.genes import GeneMap
from photoreg.registration.config import RegistrationConfig
from photoreg.search.foreground import Foreground, mean_evidence_gap
from tests.polish_scene import make_polish_scene


def misfit(term, cameras, mesh):
    gene_map = GeneMap(cameras, mesh.centroid)
    return term.misfits(np.zeros((1, gene_map.n_genes)), gene_map)[0]


def slid(camera, x_px, y_px):
    """The camera that puts the object this far to the side in the photo."""
    K = camera.K.copy()
    K[:2, 2] += (x_px, y_px)
    return dataclasses.replace(camera, K=K)


@pytest.fixture(scope="module")
def scene():
    return make_polish_scene()


def obvious_gap(P, inside, outside, image):
    """One point after the other, by the definition."""
    means = []
    for points in (inside, outside):
        read = []
        for point in points:
            x, y, depth = P @ np.append(point, 1.0)
            at = np.array([y / depth, x / depth])
            within = (at >= 0).all() and (at < np.array(image.shape) - 1).all()
            read.append(
                map_coordinates(image.astype(float), at[:, None], order=1)[0]
                if depth > 0 and within
                else 0.0
            )
        means.append(np.mean(read))
    return means[0] - means[1]


def test_the_kernel_is_its_obvious_twin():
    rng = np.random.default_rng(5)
    image = rng.uniform(-1, 1, (30, 40)).astype(np.float32)
    camera = Camera.look_at([0, 0, -4], [0, 0, 0], [0, -1, 0], 50.0, 40, 30)
    inside = rng.normal(size=(60, 3))
    # Some leave the picture, some lie behind the camera.
    outside = rng.normal(size=(80, 3)) * 4.0
    projections = np.stack([slid(camera, x, -x).P for x in (0.0, 3.3, -8.1, 90.0)])
    wanted = [obvious_gap(P, inside, outside, image) for P in projections]
    got = mean_evidence_gap(projections, inside, outside, image)
    assert got == pytest.approx(wanted, abs=1e-12)
    assert np.ptp(wanted) > 0.01


@pytest.mark.parametrize("side", [(60, 0), (-60, 0), (0, 50), (0, -50)])
def test_cameras_slid_onto_the_background_cost_more_than_the_true(scene, side):
    """Learnt from the rough cameras, as in a run; both photos slide alike."""
    term = Foreground(scene.mesh, scene.photos, scene.rough, seed=0)
    true = misfit(term, scene.cameras, scene.mesh)
    away = misfit(term, [slid(c, *side) for c in scene.cameras], scene.mesh)
    assert true < 0.2, true
    assert away > true + 0.15, (true, away)


@pytest.mark.parametrize("zoom", [0.6, 1.6])
def test_neither_growing_nor_shrinking_pays(scene, zoom):
    term = Foreground(scene.mesh, scene.photos, scene.rough, seed=0)
    cameras = [
        dataclasses.replace(c, K=np.diag([zoom, zoom, 1.0]) @ c.K)
        for c in scene.cameras
    ]
    # About the middle of the picture, not its corner.
    cameras = [
        slid(c, *(true.K[:2, 2] - c.K[:2, 2]))
        for c, true in zip(cameras, scene.cameras, strict=True)
    ]
    true = misfit(term, scene.cameras, scene.mesh)
    assert misfit(term, cameras, scene.mesh) > true + 0.05


def test_units_of_the_world_change_nothing(scene):
    scale = 1000.0
    big = Mesh(scene.mesh.vertices * scale, scene.mesh.faces)

    def scaled(cameras):
        return [
            dataclasses.replace(c, t_cam_world=c.t_cam_world * scale) for c in cameras
        ]

    term = Foreground(scene.mesh, scene.photos, scene.rough, seed=0)
    big_term = Foreground(big, scene.photos, scaled(scene.rough), seed=0)
    for cameras in (scene.rough, scene.cameras):
        assert misfit(big_term, scaled(cameras), big) == pytest.approx(
            misfit(term, cameras, scene.mesh), abs=2e-3
        )


def test_the_paper_asks_for_no_colours_of_the_object():
    assert RegistrationConfig.preset("paper").foreground == 0.0
    assert RegistrationConfig.preset("default").foreground > 0.0


def test_where_a_photo_does_not_count_there_is_no_evidence(scene):
    size = (scene.photos[0].height, scene.photos[0].width)
    hidden = np.zeros(size, dtype=bool)
    photos = [dataclasses.replace(photo, mask=hidden) for photo in scene.photos]
    term = Foreground(scene.mesh, photos, scene.rough, seed=0)
    assert misfit(term, scene.rough, scene.mesh) == 1.0
    left = hidden.copy()
    left[:, : size[1] // 2] = True
    photos = [dataclasses.replace(photo, mask=left) for photo in scene.photos]
    half = Foreground(scene.mesh, photos, scene.rough, seed=0)
    whole = Foreground(scene.mesh, scene.photos, scene.rough, seed=0)
    true = misfit(whole, scene.cameras, scene.mesh)
    assert true < misfit(half, scene.cameras, scene.mesh) < 1.0
