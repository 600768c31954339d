"""One number for how well cameras fit photos and mesh, measured alike at any pose.

The polish's own cost holds points, edges and noise that were measured at one pose, so
it cannot compare two. This one measures everything afresh at the pose it judges.
"""

from collections.abc import Sequence

import numpy as np

from photoreg.camera import Camera
from photoreg.kernels_polish import colours_at
from photoreg.mesh import Mesh
from photoreg.photo import Photo
from photoreg.photometric import (
    EDGE_MARGIN_PX,
    cell_means,
    measure_noise,
    pair_points,
    prepare_photo,
    surface_views,
)
from photoreg.silhouette import find_edges, find_rim

SIDE_PX = 1024
"""Photos are reduced to this many pixels on the longer side at most."""
BLUR_PX = 1.0
CELL_PX = 48.0
N_POINTS = 6_000
"""Surface points over all pairs of photos; a pair has ``MIN_POINTS`` or more."""
MIN_POINTS = 1_000
RIM_POINTS = 400
RIM_REACH_PX = 8.0
"""A rim point without an edge this near counts as this far off."""


def disagreement(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera], min_cosine: float
) -> float:
    """Colours that differ on the surface plus rim off the edges; 0 is perfect, 2 chance.

    Colours: the mean squared difference of two photos over the surface points that
    both see, after gain and the slow changes of light, cut off at and relative to what
    unrelated colours of the same contrast would give; 1 where nothing is shared. Rim:
    the mean squared distance to the nearest clear edge, cut off at and relative to
    ``RIM_REACH_PX``; 1 where there is no rim.
    """
    small = [_reduced(camera) for camera in cameras]
    views = surface_views(mesh, small)
    images = [
        prepare_photo(photo, view, BLUR_PX)
        for photo, view in zip(photos, views, strict=True)
    ]
    n_pairs = max(1, len(photos) * (len(photos) - 1) // 2)
    colour = []
    for k in range(len(photos)):
        for i in range(k):
            surface = pair_points(
                mesh,
                (photos[i], photos[k]),
                (views[i], views[k]),
                max(MIN_POINTS, N_POINTS // n_pairs),
                CELL_PX,
                EDGE_MARGIN_PX,
                min_cosine,
                seed=0,
            )
            if len(surface.points) < 100:
                colour.append(1.0)
                continue
            values = np.stack(
                [
                    colours_at(images[m], small[m].project(surface.points))
                    for m in (i, k)
                ],
                axis=1,
            )
            colour.append(_colour_share(values, surface.cell_starts))
    rims = []
    for photo, view in zip(photos, views, strict=True):
        rim = find_rim(mesh, view, RIM_POINTS)
        if len(rim.points) < 20:
            rims.append(1.0)
            continue
        offset = np.abs(find_edges(photo, view, rim, RIM_REACH_PX).offset_px)
        offset = np.minimum(np.nan_to_num(offset, nan=RIM_REACH_PX), RIM_REACH_PX)
        rims.append(float(np.mean((offset / RIM_REACH_PX) ** 2)))
    return (float(np.mean(colour)) if colour else 1.0) + float(np.mean(rims))


def _reduced(camera: Camera) -> Camera:
    scale = min(1.0, SIDE_PX / max(camera.width, camera.height))
    return camera.resized(
        max(16, round(camera.width * scale)), max(16, round(camera.height * scale))
    )


def _colour_share(values: np.ndarray, cell_starts: np.ndarray) -> float:
    gain = measure_noise(values, cell_starts)[0]
    counts = np.diff(cell_starts)
    pair = np.stack([values[:, 0] * gain, values[:, 1] / gain])
    inner = np.stack(
        [
            part - np.repeat(cell_means(part, cell_starts), counts, axis=0)
            for part in pair
        ]
    )
    # What unrelated colours of this contrast would differ by.
    chance = (inner**2).mean(axis=1).sum(axis=0)
    squared = np.minimum((inner[0] - inner[1]) ** 2, 2.0 * chance)
    return float(min(1.0, squared.mean(axis=0).sum() / max(chance.sum(), 1e-12)))
