"""How much the colours of one photo tell of the surface behind them: a cost of the search.

What a surface looks like is some function of its shape, whoever lit it and whatever the film
or the sensor saw: neither whether bright means lit nor any colour is taken for granted. So
the surface around each point is put into a few classes (which way it faces, how much of
the sky it sees, and beside it: the surroundings), the photo's colours into some clusters,
and cameras are good where a point's cluster tells its class.

References:
    P. Viola and W. Wells, "Alignment by maximization of mutual information", IJCV 24(2),
    1997, doi:10.1023/A:1007958904918.
"""

from collections.abc import Sequence

import cv2
import numba as nb
import numpy as np
from jaxtyping import Float, Int
from scipy.cluster.vq import vq

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection import homogeneous
from photoreg.geometry.surface_descriptors import surface_descriptors
from photoreg.geometry.surface_view import camera_rays, surface_view
from photoreg.imaging.colour import convert
from photoreg.imaging.photo import Photo, resized_mask
from photoreg.parameters.genes import GeneMap, Poses
from photoreg.search.foreground import around_object

SIDE_PX = 256
"""The photo is reduced to this many pixels on the longer side at most."""
BLUR_PX = 0.7
N_INSIDE, N_OUTSIDE = 4_000, 1_500
"""Points of the surface, and beside it."""
N_CLASSES = 24
"""Classes of the surface; the surroundings are one more."""
N_CLUSTERS = 32
"""Clusters of the photo's colours; being out of the photo is one more."""
N_TRAINING = 4_000
"""Of each kind, from which classes and clusters are made."""
K_MEANS_STEPS = 12
COLOUR_UNIT = 64.0
"""A difference of the mesh's own colours that counts as much as opposite normals half do."""


class MutualInformation:
    """What one photo's colours do not tell of the surface, as a share."""

    def __init__(self, mesh: Mesh, photo: Photo, camera: Camera, seed: int) -> None:
        """Draws the points that ``camera`` sees, and makes classes and clusters."""
        rng = np.random.default_rng(seed)
        descriptors = surface_descriptors(mesh)
        small = camera.reduced(SIDE_PX, least_px=16)
        view = surface_view(descriptors.mesh, small)
        nearest, around = around_object(view.covered)
        points, labels = [], []
        for region, n in ((view.covered, N_INSIDE), (around, N_OUTSIDE)):
            rows, columns = np.nonzero(region)
            if len(rows) == 0:
                continue
            chosen = rng.integers(0, len(rows), n)
            rows, columns = rows[chosen], columns[chosen]
            at = tuple(nearest[:, rows, columns])
            pixels = np.column_stack([columns, rows]).astype(np.float64)
            origins, rays = camera_rays(small, pixels)
            points.append(origins + view.depth[at][:, None] * rays)
            if region is around:
                labels.append(np.full(n, N_CLASSES))
                continue
            corners = descriptors.mesh.faces[view.face_index[at]]
            looks = [
                descriptors.coarse_normals[corners].mean(axis=1),
                descriptors.occlusion[corners].mean(axis=1)[:, None],
            ]
            if descriptors.colours is not None:
                looks.append(descriptors.colours[corners].mean(axis=1) / COLOUR_UNIT)
            labels.append(_classes(np.hstack(looks), N_CLASSES, rng))
        self._points = np.concatenate(points)
        self._labels = np.concatenate(labels).astype(np.int32)
        self._clusters = _colour_clusters(photo, (small.width, small.height), rng)
        sx, sy = small.width / camera.width, small.height / camera.height
        # Pixel centres: x_new = (x + 1/2) scale - 1/2.
        self._reduce = np.array(
            [[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]]
        )

    def costs(
        self, genes: Float[np.ndarray, "p g"], gene_map: GeneMap
    ) -> Float[np.ndarray, "p"]:
        """The costs of a population: 1 where colours tell nothing, 0 where all."""
        return self._costs(gene_map.poses(genes))

    def cost(self, cameras: Sequence[Camera]) -> float:
        """The cost of the photo's one camera."""
        (camera,) = cameras
        pose = Poses(
            camera.K[None, None],
            camera.R_cam_world[None, None],
            camera.t_cam_world[None, None],
        )
        return float(self._costs(pose)[0])

    def _costs(self, poses: Poses) -> np.ndarray:
        return untold_shares(
            np.ascontiguousarray(self._reduce @ poses.P[:, 0]),
            self._points,
            self._labels,
            self._clusters,
            N_CLASSES + 1,
            N_CLUSTERS + 1,
        )


def _classes(
    values: Float[np.ndarray, "n k"], n_classes: int, rng: np.random.Generator
) -> Int[np.ndarray, "n"]:
    """The cluster of each row, by k-means over some of them."""
    some = values[rng.permutation(len(values))[:N_TRAINING]]
    centres = some[:n_classes].copy()
    for _ in range(K_MEANS_STEPS):
        nearest = vq(some, centres)[0]
        counts = np.bincount(nearest, minlength=len(centres))
        for k in range(values.shape[1]):
            sums = np.bincount(nearest, some[:, k], len(centres))
            # A centre that is nearest to nothing stays where it was.
            centres[:, k] = np.where(
                counts > 0, sums / np.maximum(counts, 1), centres[:, k]
            )
    return vq(values, centres)[0]


def _colour_clusters(
    photo: Photo, size: tuple[int, int], rng: np.random.Generator
) -> Int[np.ndarray, "h w"]:
    """The cluster of each pixel's colour; what the mask leaves out counts as out of view."""
    lab = convert(photo.pixels_at(size), "lab")
    lab = cv2.GaussianBlur(lab, (0, 0), BLUR_PX)
    flat = lab.reshape(-1, 3).astype(np.float64)
    clusters = _classes(flat, N_CLUSTERS, rng).reshape(lab.shape[:2])
    mask = resized_mask(photo, size)
    if mask is not None:
        clusters = np.where(mask, clusters, N_CLUSTERS)
    return np.ascontiguousarray(clusters, dtype=np.int32)


@nb.njit(parallel=True, cache=True, nogil=True)
def untold_shares(projections, points, labels, clusters, n_labels, n_clusters):  # noqa: ANN001, ANN201
    """Share of the labels' entropy that clusters do not tell, for each projection.

    Args:
        projections: (p, 3, 4), into the picture of clusters.
        points: (n, 3).
        labels: (n,) 0 to n_labels - 1.
        clusters: (h, w) 0 to n_clusters - 1; the last also means out of view.
        n_labels: How many labels there are.
        n_clusters: How many clusters.
    """
    height, width = clusters.shape
    n = len(points)
    out = np.ones(len(projections))
    for individual in nb.prange(len(projections)):
        P = projections[individual]
        counts = np.zeros((n_labels, n_clusters), np.int32)
        for i in range(n):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            u, v, depth = homogeneous(P, x, y, z)
            cluster = n_clusters - 1
            if depth > 0.0:
                u, v = u / depth + 0.5, v / depth + 0.5
                if 0.0 <= u < width and 0.0 <= v < height:
                    cluster = clusters[int(v), int(u)]
            counts[labels[i], cluster] += 1
        whole = joint = of_cluster = 0.0
        for k in range(n_labels):
            total = 0
            for c in range(n_clusters):
                count = counts[k, c]
                total += count
                if count > 0:
                    joint -= count * np.log(count / n)
            if total > 0:
                whole -= total * np.log(total / n)
        for c in range(n_clusters):
            total = 0
            for k in range(n_labels):
                total += counts[k, c]
            if total > 0:
                of_cluster -= total * np.log(total / n)
        if whole > 0.0:
            out[individual] = (joint - of_cluster) / whole
    return out
