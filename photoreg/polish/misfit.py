"""How well cameras fit photos and mesh, measured in the same way at any pose.

The polish's own cost holds points, edges and noise that were measured at one pose, so
it cannot compare two. Here everything is measured afresh at the pose that is judged.
"""

import concurrent.futures
import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_descriptors import surface_descriptors
from photoreg.geometry.surface_view import SurfaceView, surface_view, surface_views
from photoreg.imaging.colour_model import object_regions
from photoreg.imaging.pairs import choose_pairs, points_of_pair
from photoreg.imaging.photo import Pair, Photo
from photoreg.polish.disagreement import Disagreement
from photoreg.polish.grid_cells import within_cells
from photoreg.polish.kernels import colours_at
from photoreg.polish.lighting import fit_light
from photoreg.polish.photometric_term import (
    EDGE_MARGIN_PX,
    PairPoints,
    exposure_gain,
    light_normals_of_firsts,
    opponent_channels,
    pair_points,
)
from photoreg.polish.shading_term import fit_shading, shading_side_px
from photoreg.polish.silhouette_term import (
    EdgeImage,
    Rim,
    RimEdges,
    find_edges,
    find_rim,
)

SIDE_PX = 1024
"""Photos are reduced to this many pixels on the longer side at most."""
BLUR_PX = 1.0
CELL_PX = 48.0
N_POINTS = 6_000
"""Surface points over all pairs of photos; a pair has ``MIN_POINTS`` or more."""
SHADING_REACH_PX = 12.0
"""Changes of brightness slower than this, in pixels of a photo 1,024 px wide, are no
detail that the surface should explain."""
MIN_POINTS = 1_000
MIN_CELL_POINTS = 8
"""Fewer points than this say too little about their cell."""
RIM_POINTS = 400
MIN_RIM_POINTS = 20
"""Fewer points than this are no outline."""
RIM_REACH_PX = 8.0
"""A rim point without an edge this near counts as this far off."""
N_DISPLACED = 19
"""Places at random that an outline is compared with: one that lies there by chance
itself fits better than all of them once in 20 times."""
MIN_DISPLACEMENT_PX = 4.0 * RIM_REACH_PX
"""Nearer to where it is, an outline would still find its own edges."""
ROUNDING = 1.0 / 12.0 / (4.0 * np.pi * BLUR_PX**2)
"""Variance of the rounding of bytes after the blur: colours whose contrast is no more
than that cannot be seen to agree."""


def disagreement(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    min_cosine: float,
    pairs: Sequence[Pair] | None = None,
) -> Disagreement:
    """Colours that differ on the surface, and rims off the photos' edges.

    Of one photo, in place of the colours: shading that the surface does not explain.

    ``pairs``: which photos to compare; None: those of ``choose_pairs``. Cameras that are to
    be compared with each other need the same.
    """
    small = [camera.reduced(SIDE_PX, least_px=16) for camera in cameras]
    views = surface_views(mesh, small)
    if pairs is None:
        pairs = choose_pairs(mesh, photos, cameras)
    normals = light_normals_of_firsts(mesh, views, pairs)

    def shared_points(pair: tuple[int, int]) -> PairPoints:
        i, k = pair
        return pair_points(
            mesh,
            (photos[i], photos[k]),
            (views[i], views[k]),
            normals[i],
            points_of_pair(N_POINTS, len(pairs), MIN_POINTS),
            CELL_PX,
            EDGE_MARGIN_PX,
            min_cosine,
            seed=0,
        )

    with concurrent.futures.ThreadPoolExecutor() as threads:
        surfaces = threads.map(shared_points, pairs)
        images = threads.map(
            opponent_channels, photos, views, itertools.repeat(BLUR_PX)
        )
        outlines = threads.map(_outline_share, itertools.repeat(mesh), photos, views)
        surfaces, images, outlines = list(surfaces), list(images), tuple(outlines)
    colours, typical_colours, errors = {}, {}, {}
    for (i, k), surface in zip(pairs, surfaces, strict=True):
        if len(surface.points) < 100:
            colours[i, k], typical_colours[i, k], errors[i, k] = 1.0, 1.0, 0.0
            continue
        values = np.stack(
            [colours_at(images[m], small[m].project(surface.points)) for m in (i, k)],
            axis=1,
        )
        colours[i, k], typical_colours[i, k], errors[i, k] = _colour_shares(
            values, surface
        )
    shadings = ()
    if len(photos) == 1:
        shadings = (_unexplained_share(mesh, photos[0], cameras[0]),)
    return Disagreement(colours, typical_colours, outlines, errors, shadings)


def _unexplained_share(mesh: Mesh, photo: Photo, camera: Camera) -> float:
    """Of the photo's detail, what the shape of the surface does not explain."""
    descriptors = surface_descriptors(mesh)
    small = camera.reduced(shading_side_px(SHADING_REACH_PX), least_px=16)
    view = surface_view(descriptors.mesh, small)
    reach_px = SHADING_REACH_PX * small.width / 1024.0
    fit = fit_shading(photo, view, descriptors, reach_px, N_POINTS)
    return 1.0 if fit is None else float(np.clip(1.0 - fit.explained, 0.0, 1.0))


def _outline_share(mesh: Mesh, photo: Photo, view: SurfaceView) -> float:
    rim = find_rim(mesh, view, RIM_POINTS)
    if len(rim.pixels) < MIN_RIM_POINTS:
        return 1.0
    share = _share_off_edges(find_edges(photo, view, rim, RIM_REACH_PX))
    return 1.0 if share is None else share


def _share_off_edges(edges: RimEdges) -> float | None:
    """Mean squared distance of a rim to its edges, relative to the reach.

    None where hardly any of the rim is in the photo's mask.
    """
    if edges.counts.sum() < MIN_RIM_POINTS:
        return None
    offset = np.abs(edges.offset_px[edges.counts])
    offset = np.minimum(np.nan_to_num(offset, nan=RIM_REACH_PX), RIM_REACH_PX)
    return float(np.mean((offset / RIM_REACH_PX) ** 2))


def against_chance(
    fit: Disagreement, mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> Disagreement:
    """``fit`` with its outlines relative to what chance gives in these photos.

    Edges are found near any line in a photo that is full of them. So each outline is
    laid ``N_DISPLACED`` times at random elsewhere in its photo, turned at random, and is
    measured there in the same way. It is relative to their mean, and 1 unless it fits
    better than all of them.

    Args:
        fit: ``disagreement`` of these cameras.
        mesh: The surface.
        photos: The photos.
        cameras: Their cameras.
    """
    small = [camera.reduced(SIDE_PX, least_px=16) for camera in cameras]
    with concurrent.futures.ThreadPoolExecutor() as threads:
        outlines = threads.map(
            _relative_to_chance, itertools.repeat(mesh), photos, small, fit.outlines
        )
        return dataclasses.replace(fit, outlines=tuple(outlines))


def _relative_to_chance(
    mesh: Mesh, photo: Photo, camera: Camera, share: float
) -> float:
    others = []
    for other in _shares_elsewhere(mesh, photo, camera):
        if other <= share:
            return 1.0
        others.append(other)
    return share / float(np.mean(others)) if others else 1.0


def _shares_elsewhere(mesh: Mesh, photo: Photo, camera: Camera) -> Iterator[float]:
    """Of the outline at random places of the photo, what ``_share_off_edges`` gives."""
    view = surface_view(mesh, camera)
    rim = find_rim(mesh, view, RIM_POINTS)
    if len(rim.pixels) < MIN_RIM_POINTS:
        return
    width, height = camera.width, camera.height
    image = EdgeImage.of(photo, (width, height))
    regions = object_regions(view.covered, RIM_REACH_PX)
    rng = np.random.default_rng(0)
    middle = rim.pixels.mean(axis=0)
    margin = RIM_REACH_PX + 2.0
    n_found = 0
    # Places where most of a large outline lies outside the photo say little; most
    # others do.
    for _ in range(20 * N_DISPLACED):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        turn = np.array(
            [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        )
        place = rng.uniform(0.0, [width, height])
        pixels = (rim.pixels - middle) @ turn.T + place
        inside = (pixels >= margin).all(axis=1)
        inside &= (pixels <= np.array([width, height]) - 1.0 - margin).all(axis=1)
        if np.linalg.norm(place - middle) < MIN_DISPLACEMENT_PX or inside.sum() < max(
            MIN_RIM_POINTS, 0.3 * len(pixels)
        ):
            continue
        moved = Rim(rim.points[inside], pixels[inside], (rim.normals @ turn.T)[inside])
        there = cv2.warpAffine(
            regions,
            np.column_stack([turn, place - turn @ middle]),
            (width, height),
            flags=cv2.INTER_NEAREST,
        )
        share = _share_off_edges(image.edges(moved, there, RIM_REACH_PX))
        if share is not None:
            yield share
            n_found += 1
        if n_found == N_DISPLACED:
            return


def _colour_shares(
    values: np.ndarray, surface: PairPoints
) -> tuple[float, float, float]:
    """Over all points, cut off at chance; of the median cell; and its standard error."""
    cell_starts = surface.cell_starts
    gain = exposure_gain(np.nan_to_num(values), cell_starts)
    counts = np.diff(cell_starts)
    pair = np.stack([values[:, 0] * gain, values[:, 1] / gain])
    inner = np.stack([within_cells(part, cell_starts) for part in pair])
    # What unrelated colours of this contrast would differ by.
    chance = (inner**2).mean(axis=1).sum(axis=0)
    if chance.sum() <= len(chance) * ROUNDING:
        return 1.0, 1.0, 0.0
    differences = pair[0] - pair[1]
    differences -= fit_light(differences, surface.light_normals, cell_starts)
    squared = within_cells(differences, cell_starts) ** 2
    share = np.minimum(squared, 2.0 * chance).mean(axis=0).sum() / max(
        chance.sum(), 1e-12
    )
    differ = np.add.reduceat(squared.sum(axis=1), cell_starts[:-1])
    by_chance = np.add.reduceat((inner**2).sum(axis=(0, 2)), cell_starts[:-1])
    telling = by_chance > 2.0 * len(chance) * ROUNDING * counts
    telling &= counts >= MIN_CELL_POINTS
    if not telling.any():
        return float(min(1.0, share)), 1.0, 0.0
    ratios = np.sort(differ[telling] / by_chance[telling])
    typical = np.median(ratios)
    # The cells' rank of the true median is binomial: sqrt(n) / 2 about the middle.
    ranks = 0.5 * (len(ratios) - 1 + np.sqrt(len(ratios)) * np.array([-1.0, 1.0]))
    low, high = np.interp(ranks, np.arange(len(ratios)), ratios)
    error = 0.5 * float(high - low)
    return float(min(1.0, share)), float(min(1.0, typical)), error
