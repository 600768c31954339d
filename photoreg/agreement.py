"""How well cameras fit photos and mesh, measured alike at any pose.

The polish's own cost holds points, edges and noise that were measured at one pose, so
it cannot compare two. Here everything is measured afresh at the pose that is judged.
"""

import concurrent.futures
import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from photoreg.camera import Camera
from photoreg.cells import within_cells
from photoreg.kernels_polish import colours_at
from photoreg.light import fit_light
from photoreg.mesh import Mesh
from photoreg.photo import Photo
from photoreg.photometric import (
    EDGE_MARGIN_PX,
    PairPoints,
    SurfaceView,
    exposure_gain,
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
MIN_CELL_POINTS = 8
"""Fewer points than this say too little of their cell."""
RIM_POINTS = 400
RIM_REACH_PX = 8.0
"""A rim point without an edge this near counts as this far off."""


@dataclasses.dataclass(frozen=True)
class Disagreement:
    """How badly cameras fit, colours and outlines apart: 0 is perfect, 1 chance."""

    colours: dict[tuple[int, int], float]
    """Of each pair of photos: the mean squared difference over the surface points that
    both see, after gain and the slow changes of light, cut off at and relative to what
    unrelated colours of the same contrast would give; 1 where nothing is shared."""
    typical_colours: dict[tuple[int, int], float]
    """The same of each pair's median cell: what covers less than half of the surface in
    one photo is not in it."""
    outlines: tuple[float, ...]
    """Of each photo: the mean squared distance of the rim to the nearest clear edge,
    cut off at and relative to ``RIM_REACH_PX``; 1 where there is no rim."""

    @property
    def total(self) -> float:
        """One number to compare by: geometric mean of colours' and outlines' means.

        The noise of neither is known, and then the likelihood of cameras falls with
        the logarithms of both. Their sum would not: an outline that is rough everywhere
        hides colours that halve, and half a pixel with them.
        """
        colour = float(np.mean(list(self.colours.values()))) if self.colours else 1.0
        return float(np.sqrt(colour * np.mean(self.outlines)))

    def typical_colour_of(self, photo: int) -> float:
        """Typical colours of the pair of ``photo`` that agrees best; 1: no pair."""
        return min(
            (share for pair, share in self.typical_colours.items() if photo in pair),
            default=1.0,
        )


def disagreement(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera], min_cosine: float
) -> Disagreement:
    """Colours that differ on the surface, and rims off the photos' edges."""
    small = [_reduced(camera) for camera in cameras]
    views = surface_views(mesh, small)
    pairs = [(i, k) for k in range(len(photos)) for i in range(k)]

    def shared_points(pair: tuple[int, int]) -> PairPoints:
        i, k = pair
        return pair_points(
            mesh,
            (photos[i], photos[k]),
            (views[i], views[k]),
            max(MIN_POINTS, N_POINTS // len(pairs)),
            CELL_PX,
            EDGE_MARGIN_PX,
            min_cosine,
            seed=0,
        )

    with concurrent.futures.ThreadPoolExecutor() as threads:
        surfaces = threads.map(shared_points, pairs)
        images = threads.map(prepare_photo, photos, views, itertools.repeat(BLUR_PX))
        outlines = threads.map(_outline_share, itertools.repeat(mesh), photos, views)
        surfaces, images, outlines = list(surfaces), list(images), tuple(outlines)
    colours, typical_colours = {}, {}
    for (i, k), surface in zip(pairs, surfaces, strict=True):
        if len(surface.points) < 100:
            colours[i, k] = typical_colours[i, k] = 1.0
            continue
        values = np.stack(
            [colours_at(images[m], small[m].project(surface.points)) for m in (i, k)],
            axis=1,
        )
        colours[i, k], typical_colours[i, k] = _colour_shares(values, surface)
    return Disagreement(colours, typical_colours, outlines)


def _outline_share(mesh: Mesh, photo: Photo, view: SurfaceView) -> float:
    rim = find_rim(mesh, view, RIM_POINTS)
    if len(rim.points) < 20:
        return 1.0
    offset = np.abs(find_edges(photo, view, rim, RIM_REACH_PX).offset_px)
    offset = np.minimum(np.nan_to_num(offset, nan=RIM_REACH_PX), RIM_REACH_PX)
    return float(np.mean((offset / RIM_REACH_PX) ** 2))


def _reduced(camera: Camera) -> Camera:
    scale = min(1.0, SIDE_PX / max(camera.width, camera.height))
    return camera.resized(
        max(16, round(camera.width * scale)), max(16, round(camera.height * scale))
    )


def _colour_shares(values: np.ndarray, surface: PairPoints) -> tuple[float, float]:
    """Over all points, cut off at chance; and of the median cell."""
    cell_starts = surface.cell_starts
    gain = exposure_gain(np.nan_to_num(values), cell_starts)
    counts = np.diff(cell_starts)
    pair = np.stack([values[:, 0] * gain, values[:, 1] / gain])
    inner = np.stack([within_cells(part, cell_starts) for part in pair])
    # What unrelated colours of this contrast would differ by.
    chance = (inner**2).mean(axis=1).sum(axis=0)
    differences = pair[0] - pair[1]
    differences -= fit_light(differences, surface.light_normals, cell_starts)
    squared = within_cells(differences, cell_starts) ** 2
    share = np.minimum(squared, 2.0 * chance).mean(axis=0).sum() / max(
        chance.sum(), 1e-12
    )
    big = counts >= MIN_CELL_POINTS
    if not big.any():
        return float(min(1.0, share)), 1.0
    differ = np.add.reduceat(squared.sum(axis=1), cell_starts[:-1])[big]
    by_chance = np.add.reduceat((inner**2).sum(axis=(0, 2)), cell_starts[:-1])[big]
    typical = np.median(differ / np.maximum(by_chance, 1e-12))
    return float(min(1.0, share)), float(min(1.0, typical))
