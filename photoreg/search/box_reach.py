"""What the intervals of a search mean in the photos: its reach in pixels."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.visibility import middle_for, samples_for, seen_points
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.gene_box import BoxReach, CameraModel, Coordinates, GeneBox
from photoreg.parameters.genes import GeneMap

N_POINTS = 400
N_DRAWS = 400
"""The highest twentieth of the moves, which is reported, is then 20 draws."""


def box_reach(
    mesh: Mesh,
    cameras: Sequence[Camera],
    box: GeneBox,
    model: CameraModel = "pinhole",
    coordinates: Coordinates = "object",
    freedom: Freedom | None = None,
) -> BoxReach:
    """The reach of ``box`` around ``cameras``; takes some milliseconds.

    Args:
        mesh: The surface.
        cameras: The pre-registration.
        box: The gene intervals.
        model: Which parameters have genes.
        coordinates: What the genes are.
        freedom: What may move; None: everything.

    Raises:
        InputError: if no camera sees the surface.
    """
    points = samples_for(mesh, cameras, N_POINTS, seed=0).points
    seen = [points[seen_points(mesh, camera, points)] for camera in cameras]
    kept = [i for i, own in enumerate(seen) if len(own) > 0]
    if not kept:
        raise InputError(
            "No camera sees the surface, so there is no telling how far a search would "
            "reach; align the cameras first."
        )
    freedom, middle = freedom or Freedom(), middle_for(mesh, cameras)
    begun = freedom.begin(cameras, middle)
    gene_map = GeneMap(
        [begun[i] for i in kept],
        middle,
        box,
        model,
        coordinates,
        freedom.subset(kept),
    )
    shown = [seen[i] for i in kept]
    draws = gene_map.first_population(N_DRAWS, np.random.default_rng(0))
    moves = _moves_px(gene_map, shown, draws).mean(axis=1)
    alone = _moves_px(gene_map, shown, np.eye(gene_map.n_genes))
    # A gene moves the photo of its own camera, or of all that share it.
    by_gene = zip(gene_map.names(), alone.max(axis=1).tolist(), strict=True)
    return BoxReach(
        float(np.median(moves)), float(np.quantile(moves, 0.95)), tuple(by_gene)
    )


def _moves_px(
    gene_map: GeneMap, points: Sequence[np.ndarray], genes: Float[np.ndarray, "p g"]
) -> Float[np.ndarray, "p c"]:
    """Mean distance from the start's projections, an individual and camera."""
    P = gene_map.poses(np.vstack([np.zeros(gene_map.n_genes), genes])).P
    moves = []
    for c, own in enumerate(points):
        homogeneous = (
            np.einsum("pij,nj->pni", P[:, c, :, :3], own) + P[:, c, None, :, 3]
        )
        # What a wide box takes behind a camera is far off, not infinitely.
        depth = np.maximum(homogeneous[..., 2:], 1e-3 * homogeneous[:1, :, 2:])
        pixels = homogeneous[..., :2] / depth
        moves.append(np.linalg.norm(pixels[1:] - pixels[:1], axis=-1).mean(axis=1))
    return np.column_stack(moves)
