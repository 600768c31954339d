"""Cameras found by features that photos have in common, where there is no clear outline.

Two photos give points in space up to scale (``two_views``); the mesh is fitted to them from all
around (``cloud_fit``); and poses are verified by the matches themselves: carried over the
mesh from one photo into the other, they must arrive where they were matched. Further photos
follow by the places on the mesh that they share with those that have cameras.
"""

import dataclasses
import itertools
from collections.abc import Generator, Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera, centred_intrinsics
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.ray_hits import surface_hits
from photoreg.geometry.sampling import SurfaceSamples
from photoreg.imaging.photo import Photo
from photoreg.placing.agreement import DISTINCT_DEG, surface_points
from photoreg.placing.cloud_fit import CloudFit, CloudPose
from photoreg.placing.outcome import (
    MOST_CANDIDATES,
    WHAT_TO_DO,
    Placed,
    Placement,
    PlacingEvent,
    PlacingStep,
)
from photoreg.placing.outline_candidates import GUESSED_FOCAL, differ
from photoreg.placing.two_views import (
    LEAST_MATCHES,
    SIDE_PX,
    TwoViews,
    features_of,
    matched,
    two_views,
)

FOCALS = (0.65, 0.8, 1.0, 1.25)
"""Focal lengths over the guessed one that are tried where EXIF tells none."""
NEARLY = (1.0, 0.9, 1.1)
"""Focal lengths over the known one that are tried until one does: EXIF rounds."""
N_CENTRAL = 250
"""Of the matches the most central half counts, at least so many: objects are there."""
N_VERIFIED = 400
"""Fitted poses that are verified by matches."""
RIGHT_PX, WRONG_PX = 5.0, 12.0
"""A match that arrives so near speaks for a pose, one so far off against it, at a width of
``SIDE_PX``."""
ACCEPTED = 0.3
"""Least score of a pose that may be right."""
RIVAL = 0.8
"""A pose with this share of the best one's score may be right in its place."""
MOST_PAIRS = 3
"""Pairs of photos that are tried."""
MOST_FOR_ALL_PAIRS = 8
"""With more photos only neighbours in their order are matched to find a pair."""
RESECTION_PX = 8.0
"""How far places of a photo may be off where a first camera is fitted to them."""


@dataclasses.dataclass(frozen=True, eq=False)
class PairPose:
    """A choice of cameras for two photos."""

    cameras: tuple[Camera, Camera]
    score: float
    """Matches that arrive, less those that go astray, over all that meet the mesh, times the
    share of the mesh in view; at most 1."""


def place_by_points(
    mesh: Mesh, photos: Sequence[Photo], focals_px: Mapping[str, float]
) -> Generator[PlacingEvent, None, None]:
    """Finds cameras of two photos or more by what they show alike.

    The last event is a ``Placed`` in which every camera is unsure at best: a refinement
    must judge.

    Args:
        mesh: The surface.
        photos: At least two, of one state of the object and its surroundings.
        focals_px: Focal lengths in pixels by the photo's name, where they are known.
    """
    nobody: tuple[Camera | None, ...] = (None,) * len(photos)

    def step(fraction: float, words: str) -> PlacingStep:
        return PlacingStep(fraction, words, nobody)

    features = []
    for i, photo in enumerate(photos):
        yield step(0.2 * i / len(photos), f"looking for details in {photo.name}")
        features.append(features_of(photo))
    matches = {}
    pairs = list(itertools.combinations(range(len(photos)), 2))
    if len(photos) > MOST_FOR_ALL_PAIRS:
        pairs = list(itertools.pairwise(range(len(photos))))
    for k, (a, b) in enumerate(pairs):
        words = f"comparing details of {photos[a].name} and {photos[b].name}"
        yield step(0.2 + 0.2 * k / len(pairs), words)
        matches[a, b] = matched(features[a], features[b])
    fit, samples = CloudFit(mesh), surface_points(mesh)
    pairs.sort(key=lambda pair: -len(matches[pair][0]))
    pairs = [pair for pair in pairs if len(matches[pair][0]) >= LEAST_MATCHES]
    found: list[PairPose] = []
    placed: dict[int, Camera] = {}
    for k, (a, b) in enumerate(pairs[:MOST_PAIRS]):
        both = photos[a], photos[b]
        told = [focals_px.get(one.name, one.exif_focal_px) for one in both]
        is_known = None not in told
        factors = NEARLY if is_known else FOCALS
        found = []
        for j, factor in enumerate(factors):
            done = (k + j / len(factors)) / min(len(pairs), MOST_PAIRS)
            words = f"fitting the mesh to {both[0].name} and {both[1].name}"
            yield step(0.4 + 0.5 * done, words)
            focal_a, focal_b = (
                factor * (focal_px if is_known and focal_px else _guessed(one))
                for one, focal_px in zip(both, told, strict=True)
            )
            views = two_views(both, matches[a, b], (focal_a, focal_b))
            if views is not None:
                found += _poses(mesh, fit, samples, views)
            found = _distinct(found)
            if is_known and found and found[0].score >= ACCEPTED:
                break
        if found and found[0].score >= ACCEPTED:
            placed = dict(zip((a, b), found[0].cameras, strict=True))
            break
    if not placed:
        yield Placed(tuple(_not_found(photo) for photo in photos))
        return
    pair = tuple(placed)
    shown = found[:MOST_CANDIDATES]
    is_tied = len(shown) > 1 and shown[1].score >= RIVAL * shown[0].score
    for i in range(len(photos)):
        if i not in placed:
            yield step(0.95, f"placing {photos[i].name}")
            shared = {
                other: matches.get((other, i))
                or matches.get((i, other), ())[::-1]
                or matched(features[other], features[i])
                for other in placed
            }
            camera = _resected(mesh, photos[i], shared, placed, focals_px)
            if camera is not None:
                placed[i] = camera
    yield Placed(
        tuple(
            _placement(
                photo,
                [one.cameras[pair.index(i)] for one in shown]
                if i in pair
                else [placed[i]] * len(shown),
                is_tied,
            )
            if i in placed
            else _not_found(photo)
            for i, photo in enumerate(photos)
        )
    )


def _guessed(photo: Photo) -> float:
    return GUESSED_FOCAL * max(photo.width, photo.height)


def _placement(photo: Photo, cameras: Sequence[Camera], is_tied: bool) -> Placement:
    return Placement(
        "unsure",
        f"{photo.name}: unsure; found by what the photos show alike. Look at the candidates "
        f"and pick one. {WHAT_TO_DO}",
        tuple(cameras),
        how="common points",
        is_tied=is_tied,
    )


def _not_found(photo: Photo) -> Placement:
    return Placement(
        "not found",
        f"{photo.name}: not found; it shows too little that the others show alike. "
        f"{WHAT_TO_DO}",
        how="common points",
    )


def _poses(
    mesh: Mesh, fit: CloudFit, samples: SurfaceSamples, views: TwoViews
) -> list[PairPose]:
    """Poses in which the points lie on the mesh, verified."""
    first, second = views.cameras
    apart = np.linalg.norm(views.points[:, :2] / views.points[:, 2:], axis=1)
    central = np.argsort(apart, kind="stable")
    central = central[: max(N_CENTRAL, len(central) // 2)]
    share = first.focal_px / max(first.width, first.height)
    found = []
    for pose in fit.poses(views.points[central], share, N_VERIFIED):
        cameras = _placed_pair(pose, first, second)
        found.append(PairPose(cameras, _score(mesh, samples, cameras, views)))
    return found


def _placed_pair(
    pose: CloudPose, first: Camera, second: Camera
) -> tuple[Camera, Camera]:
    R, t = pose.R_cam_world, -pose.R_cam_world @ pose.center
    return (
        dataclasses.replace(first, R_cam_world=R, t_cam_world=t),
        dataclasses.replace(
            second,
            R_cam_world=second.R_cam_world @ R,
            t_cam_world=second.R_cam_world @ t + pose.scale * second.t_cam_world,
        ),
    )


def _score(
    mesh: Mesh,
    samples: SurfaceSamples,
    cameras: tuple[Camera, Camera],
    views: TwoViews,
) -> float:
    """See ``PairPose.score``."""
    places = views.places, views.places_in_second
    right = wrong = total = 0
    shares = []
    for a, b in ((0, 1), (1, 0)):
        met, on_mesh, arrived = _carried(mesh, cameras[a], cameras[b], places[a])
        scale = max(cameras[b].width, cameras[b].height) / SIDE_PX
        error = np.linalg.norm(arrived - places[b][met], axis=1) / scale
        sees = mesh.is_unoccluded(on_mesh, cameras[b].center) & np.isfinite(error)
        right += int((error[sees] < RIGHT_PX).sum())
        wrong += int((error[sees] > WRONG_PX).sum())
        total += int(sees.sum())
        inside = cameras[a].contains(cameras[a].project(samples.points))
        shares.append(float(inside.mean()))
    return (right - wrong) / max(total, 2 * LEAST_MATCHES) * min(shares)


def _carried(
    mesh: Mesh, a: Camera, b: Camera, places: Float[np.ndarray, "n 2"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which places of a photo show the mesh, where on it, and where another shows that."""
    origin, rays = a.rays(places)
    met, hits = surface_hits(mesh, origin, rays)
    return met, hits.points, b.project(hits.points)


def _distinct(found: Sequence[PairPose]) -> list[PairPose]:
    """The best of each group of poses that lead to one end, the best first."""
    kept: list[PairPose] = []
    for one in sorted(found, key=lambda one: -one.score):
        if all(
            differ(one.cameras[0], other.cameras[0], DISTINCT_DEG) for other in kept
        ):
            kept.append(one)
    return kept


def _resected(
    mesh: Mesh,
    photo: Photo,
    shared: Mapping[int, tuple[np.ndarray, np.ndarray]],
    placed: Mapping[int, Camera],
    focals_px: Mapping[str, float],
) -> Camera | None:
    """The camera of a photo by places on the mesh that it shares with placed photos.

    References:
        G. Terzakis and M. Lourakis, "SQPnP", ECCV 2020, DOI 10.1007/978-3-030-58452-8_28.
    """
    points, pixels = [], []
    for other, camera in placed.items():
        there, here = shared[other]
        met, hits = surface_hits(mesh, *camera.rays(there))
        points.append(hits.points)
        pixels.append(here[met])
    on_mesh, here = np.concatenate(points), np.concatenate(pixels)
    if len(on_mesh) < LEAST_MATCHES:
        return None
    like = next(iter(placed.values()))
    focal_px = (
        focals_px.get(photo.name)
        or photo.exif_focal_px
        or like.focal_px / max(like.width, like.height) * max(photo.width, photo.height)
    )
    K = centred_intrinsics(focal_px, photo.width, photo.height)
    middle = on_mesh.mean(axis=0)
    scale = max(photo.width, photo.height) / SIDE_PX
    is_solved, turn, shift, inliers = cv2.solvePnPRansac(
        on_mesh - middle,
        here,
        K,
        None,
        iterationsCount=2000,
        reprojectionError=RESECTION_PX * scale,
        confidence=0.9999,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not is_solved or inliers is None or len(inliers) < LEAST_MATCHES:
        return None
    R = cv2.Rodrigues(turn)[0]
    t = shift.ravel() - R @ middle
    return Camera(K, R, t, photo.width, photo.height)
