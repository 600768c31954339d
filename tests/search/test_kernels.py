"""The compiled population cost against its twin, and its invariances."""

import dataclasses

import numba as nb
import numpy as np
import pytest

from photoreg.geometry.camera import Camera
from photoreg.geometry.sampling import SurfaceSamples, sample_surface
from photoreg.geometry.visibility import visible
from photoreg.parameters.genes import GeneMap
from photoreg.search.config import ConsistencyConfig
from photoreg.search.photo_consistency import PhotoConsistency, patches_of
from tests.scenes import small_scene
from tests.search import naive_kernels

N_SAMPLES = 80


def masked_photos(photos):
    """The photos with masks that cut through what they show."""
    masks = []
    for i, photo in enumerate(photos):
        rows, columns = np.mgrid[: photo.height, : photo.width]
        masks.append(columns + (2 * i - 1) * rows // 3 < 0.62 * photo.width)
    return [
        dataclasses.replace(photo, mask=mask)
        for photo, mask in zip(photos, masks, strict=True)
    ]


def naive_colours(consistency, photos, cameras, allowed):
    """What the twin sees of the prepared photos."""
    pictures, valid = [], []
    for first, width, height in consistency.stack.layouts:
        block = consistency.stack.pixels[first : first + width * height]
        pictures.append(block[:, :3].reshape(height, width, 3))
        valid.append(block[:, 3].reshape(height, width))
    return naive_kernels.colours_seen(
        consistency.samples,
        pictures,
        valid,
        cameras,
        allowed,
        consistency.config.min_cosine,
    )


@pytest.mark.parametrize("n_photos", [2, 4])
@pytest.mark.parametrize("exposure", [False, True])
@pytest.mark.parametrize("with_masks", [False, True])
@pytest.mark.parametrize(
    "cost", ["ssd", "trimmed_squares", "alpha_trimmed", "variance"]
)
def test_cost_is_that_of_the_slow_twin(n_photos, exposure, with_masks, cost):
    scene = small_scene(n_photos=n_photos, gain=0.8)
    photos = masked_photos(scene.photos) if with_masks else scene.photos
    samples = sample_surface(scene.mesh, N_SAMPLES, 3)
    allowed = np.random.default_rng(4).random((n_photos, N_SAMPLES)) < 0.9
    config = ConsistencyConfig(cost=cost, exposure=exposure, min_cosine=0.2)
    consistency = PhotoConsistency(samples, photos, config, allowed)
    seen = naive_colours(consistency, photos, scene.rough_cameras, allowed)
    assert len(seen) >= 8
    if exposure:
        seen = naive_kernels.with_equal_exposure(seen, n_photos)
    if cost == "variance":
        expected = naive_kernels.variance_cost(seen)
    else:
        expected = naive_kernels.pair_cost(seen, *config.trimmed_shares)
    found = consistency.cost(scene.rough_cameras)
    assert consistency.n_common(scene.rough_cameras) == len(seen)
    # float32 against float64: 1e-4 relative at most was measured.
    assert found == pytest.approx(expected, rel=1e-3), (found, expected)


@pytest.mark.parametrize("n_photos", [2, 3])
def test_mncc_is_that_of_the_slow_twin(n_photos):
    scene = small_scene(n_photos=n_photos)
    samples = sample_surface(scene.mesh, N_SAMPLES, 3)
    config = ConsistencyConfig(cost="mncc", min_cosine=0.2, patch_side=3)
    patches = patches_of(scene.mesh, samples, scene.rough_cameras, config)
    consistency = PhotoConsistency(samples, scene.photos, config, patches=patches)
    pictures = [
        consistency.stack.pixels[first : first + width * height, :3].reshape(
            height, width, 3
        )
        for first, width, height in consistency.stack.layouts
    ]
    allowed = np.ones((n_photos, N_SAMPLES), dtype=bool)
    expected = naive_kernels.mncc_cost(
        samples, patches, pictures, scene.rough_cameras, allowed, config.min_cosine
    )
    found = consistency.cost(scene.rough_cameras)
    assert found == pytest.approx(expected, rel=1e-3), (found, expected)


def population(scene, n=40):
    gene_map = GeneMap(scene.rough_cameras, scene.mesh.centroid)
    return gene_map, gene_map.first_population(n, np.random.default_rng(7))


def test_costs_are_the_same_to_the_bit_for_any_number_of_threads():
    scene = small_scene()
    gene_map, genes = population(scene)
    samples = sample_surface(scene.mesh, 500, 3)
    consistency = PhotoConsistency(samples, scene.photos)
    n_threads = nb.get_num_threads()
    found = []
    try:
        for n in {1, n_threads}:
            nb.set_num_threads(n)
            found.append(consistency.costs(genes, gene_map))
    finally:
        nb.set_num_threads(n_threads)
    np.testing.assert_array_equal(found[0], found[-1])


def test_costs_do_not_depend_on_the_company_of_an_individual():
    scene = small_scene()
    gene_map, genes = population(scene)
    consistency = PhotoConsistency(sample_surface(scene.mesh, 500, 3), scene.photos)
    together = consistency.costs(genes, gene_map)
    alone = [consistency.costs(one[None], gene_map)[0] for one in genes]
    np.testing.assert_array_equal(together, alone)


def moved(scene, samples):
    """Scene and samples turned, shifted and scaled together."""
    axis = np.array([0.3, -0.8, 0.5])
    angle = np.linalg.norm(axis)
    x, y, z = axis / angle
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R = np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W
    scale, shift = 3.7e-4, np.array([0.02, -0.05, 0.01])
    cameras = [
        Camera(
            camera.K,
            camera.R_cam_world @ R.T,
            scale * camera.t_cam_world - camera.R_cam_world @ R.T @ shift,
            camera.width,
            camera.height,
        )
        for camera in scene.rough_cameras
    ]
    return cameras, SurfaceSamples(
        scale * samples.points @ R.T + shift, samples.normals @ R.T, samples.face_index
    )


def test_cost_is_unchanged_when_world_and_cameras_move_together():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 2000, 3)
    cost = PhotoConsistency(samples, scene.photos).cost(scene.rough_cameras)
    cameras, moved_samples = moved(scene, samples)
    found = PhotoConsistency(moved_samples, scene.photos).cost(cameras)
    # A point on the border of visibility may fall either way: one in 500.
    assert found == pytest.approx(cost, rel=5e-3), (found, cost)


def test_cost_is_unchanged_when_samples_are_permuted():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 500, 3)
    order = np.random.default_rng(1).permutation(len(samples))
    cost = PhotoConsistency(samples, scene.photos).cost(scene.rough_cameras)
    found = PhotoConsistency(samples.subset(order), scene.photos).cost(
        scene.rough_cameras
    )
    assert found == pytest.approx(cost, rel=1e-5), (found, cost)


@pytest.mark.parametrize("exposure", [False, True])
def test_cost_is_unchanged_when_photos_are_swapped(exposure):
    scene = small_scene(gain=0.8)
    samples = sample_surface(scene.mesh, 500, 3)
    config = ConsistencyConfig(exposure=exposure)
    cost = PhotoConsistency(samples, scene.photos, config).cost(scene.rough_cameras)
    found = PhotoConsistency(samples, scene.photos[::-1], config).cost(
        scene.rough_cameras[::-1]
    )
    assert found == pytest.approx(cost, rel=1e-5), (found, cost)


def test_true_cameras_cost_far_less_than_rough_ones():
    scene = small_scene()
    samples = sample_surface(scene.mesh, 2000, 3)
    consistency = PhotoConsistency(
        samples,
        scene.photos,
        allowed=visible(samples, scene.cameras, scene.mesh, "rays", 0.0),
    )
    rough, true = (
        consistency.cost(scene.rough_cameras),
        consistency.cost(scene.cameras),
    )
    assert true < 0.2 * rough, (true, rough)


def test_exposure_takes_out_a_photo_that_was_exposed_otherwise():
    scene = small_scene(gain=0.75)
    samples = sample_surface(scene.mesh, 2000, 3)
    costs = {}
    for exposure in (False, True):
        config = ConsistencyConfig(colour="rgb", exposure=exposure)
        consistency = PhotoConsistency(samples, scene.photos, config)
        costs[exposure] = consistency.cost(scene.cameras)
    assert costs[True] < 0.1 * costs[False], costs


def test_cameras_that_look_away_cost_infinitely_much():
    scene = small_scene()
    consistency = PhotoConsistency(sample_surface(scene.mesh, 300, 3), scene.photos)
    turn = np.diag([-1.0, 1.0, -1.0])
    away = [
        Camera(c.K, turn @ c.R_cam_world, turn @ c.t_cam_world, c.width, c.height)
        for c in scene.cameras
    ]
    assert consistency.cost(away) == np.inf


def test_seeing_too_little_in_common_costs_infinitely_much():
    scene = small_scene()
    consistency = PhotoConsistency(sample_surface(scene.mesh, 300, 3), scene.photos)
    consistency.require(scene.cameras)
    assert np.isfinite(consistency.cost(scene.cameras))
    consistency.min_samples = consistency.n_common(scene.cameras) + 1
    assert consistency.cost(scene.cameras) == np.inf
