"""How much the colours of one photo tell of the surface."""

import dataclasses

import numpy as np

from photoreg.parameters.gene_box import GeneBox
from photoreg.parameters.genes import GeneMap
from photoreg.search.mutual_information import MutualInformation, untold_shares
from tests.scenes import small_scene


def naive_untold_share(projection, points, labels, clusters, n_labels, n_clusters):
    """H(label | cluster) / H(label), by counting."""
    height, width = clusters.shape
    counts = np.zeros((n_labels, n_clusters))
    for point, label in zip(points, labels, strict=True):
        u, v, depth = projection @ [*point, 1.0]
        column, row = int(np.rint(u / depth)), int(np.rint(v / depth))
        inside = depth > 0.0 and 0 <= column < width and 0 <= row < height
        counts[label, clusters[row, column] if inside else n_clusters - 1] += 1.0
    shares = counts / counts.sum()

    def entropy(p):
        return -(p[p > 0.0] * np.log(p[p > 0.0])).sum()

    of_label = entropy(shares.sum(axis=1))
    return (entropy(shares) - entropy(shares.sum(axis=0))) / of_label


def test_the_kernel_counts_like_its_slow_twin():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(300, 3))
    labels = rng.integers(0, 5, 300).astype(np.int32)
    clusters = rng.integers(0, 7, (30, 40)).astype(np.int32)
    K = np.array([[30.0, 0.0, 20.0], [0.0, 30.0, 15.0], [0.0, 0.0, 1.0]])
    # The second camera is amid the points: some are behind it.
    projections = np.stack(
        [K @ np.column_stack([np.eye(3), [0.1, 0.2, z]]) for z in (4.0, 0.5)]
    )
    found = untold_shares(projections, points, labels, clusters, 5, 8)
    for projection, share in zip(projections, found, strict=True):
        slow = naive_untold_share(projection, points, labels, clusters, 5, 8)
        np.testing.assert_allclose(share, slow)


def test_colours_that_tell_all_leave_nothing_and_others_all():
    points = np.column_stack(
        [np.repeat(np.arange(4.0), 50), np.zeros(200), np.ones(200)]
    )
    labels = np.repeat(np.arange(4), 50).astype(np.int32)
    P = np.eye(3, 4)[None]
    told = untold_shares(P, points, labels, np.array([[3, 1, 0, 2]], np.int32), 4, 5)
    np.testing.assert_allclose(told, 0.0, atol=1e-12)
    same = untold_shares(P, points, labels, np.zeros((1, 4), np.int32), 4, 5)
    np.testing.assert_allclose(same, 1.0)


def test_the_true_camera_costs_less_than_others_whatever_the_values():
    scene = small_scene(kind="hard")
    rough, true = scene.rough_cameras[:1], scene.cameras[:1]
    gene_map = GeneMap(rough, scene.mesh.centroid, GeneBox(), coordinates="object")
    genes = np.random.default_rng(0).uniform(-1.0, 1.0, (40, gene_map.n_genes))
    photo = scene.photos[0]
    folded = np.abs(2.0 * np.arange(256) - 170.0).astype(np.uint8)
    for pixels in (photo.pixels, 255 - photo.pixels, folded[photo.pixels]):
        cost = MutualInformation(
            scene.mesh, dataclasses.replace(photo, pixels=pixels), rough[0], seed=0
        )
        at_truth = cost.cost(true)
        assert 0.0 < at_truth < cost.cost(rough) < 1.0
        assert (cost.costs(genes, gene_map) > at_truth).mean() > 0.9


def test_what_a_mask_leaves_out_tells_nothing():
    scene = small_scene(kind="hard")
    photo = scene.photos[0]
    masked = dataclasses.replace(photo, mask=np.zeros(photo.pixels.shape[:2], bool))
    cost = MutualInformation(scene.mesh, masked, scene.cameras[0], seed=0)
    assert cost.cost(scene.cameras[:1]) == 1.0
