"""Cameras found without a click: placed, and refined a little where that has to decide.

Outlines and colours often leave no doubt. Where they do, the most likely poses are refined
briefly, and the verdict decides whether they are right.
"""

import dataclasses
from collections.abc import Generator, Mapping, Sequence

from photoreg.errors import PhotoregError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.placing.agreement import DISTINCT_DEG
from photoreg.placing.common_points import place_by_points
from photoreg.placing.outcome import (
    Box,
    Placed,
    Placement,
    PlacingEvent,
    PlacingStep,
)
from photoreg.placing.outline_candidates import differ
from photoreg.placing.place import FITS_WITH_OTHERS, place
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished
from photoreg.registration.refinement import refine

OUTLINES_UNTIL, JUDGED_UNTIL, POINTS_UNTIL = 0.4, 0.55, 0.85
"""Shares of the progress at which outlines are compared, the poses judged, common points
fitted; the rest judges these."""
JUDGED_PX = 640
"""Photos are reduced to this for it: right or wrong is a matter of many pixels."""


def find_cameras(
    mesh: Mesh,
    photos: Sequence[Photo],
    *,
    boxes: Mapping[str, Box] | None = None,
    focals_px: Mapping[str, float] | None = None,
    seed: int = 0,
) -> Generator[PlacingEvent, None, None]:
    """Finds the cameras of photos; see ``placing.place``, whose arguments these are.

    Stop iterating to cancel. The last event is a ``Placed``. Poses that outlines and colours
    alone do not decide are found if they convince when they are refined, and no others do
    that fit the outline as well; never where any turn about an axis fits.

    Args:
        mesh: The surface.
        photos: One or more.
        boxes: Around the object, in pixels, by the photo's name.
        focals_px: Focal lengths in pixels, by the photo's name.
        seed: Of the refinements. Same seed, same cameras.

    Raises:
        InputError: as ``placing.place``.
    """
    placing = place(mesh, photos, boxes=boxes, focals_px=focals_px)
    return _events(mesh, photos, placing, dict(focals_px or {}), seed)


def _events(
    mesh: Mesh,
    photos: Sequence[Photo],
    placing: Generator[PlacingEvent, None, None],
    focals_px: Mapping[str, float],
    seed: int,
) -> Generator[PlacingEvent, None, None]:
    placed = yield from _within(placing, 0.0, OUTLINES_UNTIL)
    judging = _judged(mesh, photos, placed, seed)
    placed = yield from _within(judging, OUTLINES_UNTIL, JUDGED_UNTIL)
    # A guessed outline may look like a round thing's.
    is_round = any(one.about_axis and one.how != "clutter" for one in placed.placements)
    if placed.grade != "found" and not is_round and len(photos) > 1:
        fitting = place_by_points(mesh, photos, focals_px)
        by_points = yield from _within(fitting, JUDGED_UNTIL, POINTS_UNTIL)
        judging = _judged(mesh, photos, by_points, seed)
        by_points = yield from _within(judging, POINTS_UNTIL, 1.0)
        if _is_better(by_points, placed):
            placed = by_points
    yield placed


def _through_known_lenses(photos: Sequence[Photo], placed: Placed) -> Placed:
    """The placements, whose cameras were found as if lenses were ideal, with known lenses."""
    return dataclasses.replace(
        placed,
        placements=tuple(
            one
            if (known := photo.known_lens) is None
            else dataclasses.replace(
                one,
                candidates=tuple(c.with_lens(known.lens) for c in one.candidates),
            )
            for photo, one in zip(photos, placed.placements, strict=True)
        ),
    )


def _within(
    events: Generator[PlacingEvent, None, None], low: float, high: float
) -> Generator[PlacingStep, None, Placed]:
    """The steps as a part of the whole progress; returns how they end."""
    for event in events:
        if isinstance(event, Placed):
            return event
        fraction = low + (high - low) * event.fraction
        yield dataclasses.replace(event, fraction=fraction)
    raise AssertionError("Placing ends with a Placed.")


def _is_better(by_points: Placed, by_outlines: Placed) -> bool:
    """Whether what photos show alike tells more than the outlines do."""
    n_by_points, n_by_outlines = (
        sum(one.grade == "found" for one in placed.placements)
        for placed in (by_points, by_outlines)
    )
    if n_by_points != n_by_outlines:
        return n_by_points > n_by_outlines
    return not all(map(_is_likely, by_outlines.placements)) and any(
        one.candidates for one in by_points.placements
    )


def _is_likely(placement: Placement) -> bool:
    """Whether a pose is worth judging."""
    return placement.how == "common points" or placement.overlap >= FITS_WITH_OTHERS


def _is_another(a: Camera, b: Camera) -> bool:
    """Whether two refined cameras are different answers."""
    return differ(a, b, DISTINCT_DEG)


def _judged(
    mesh: Mesh, photos: Sequence[Photo], placed: Placed, seed: int
) -> Generator[PlacingEvent, None, None]:
    """The placements, with known lenses, and what refining says of those that are unsure."""
    placed = _through_known_lenses(photos, placed)
    known = [i for i, one in enumerate(placed.placements) if one.candidates]
    placements = [placed.placements[i] for i in known]
    doubtful = [one for one in placements if one.grade == "unsure"]
    is_worth_it = all(map(_is_likely, placements))
    if not doubtful or not is_worth_it or any(one.about_axis for one in doubtful):
        yield placed
        return
    config = RegistrationConfig.preset("fast", seed)
    small = [photos[i].resized(JUDGED_PX) for i in known]
    # Where others fit the outline as well, these must not convince either.
    is_tied = any(one.is_tied for one in placements)
    n = min(len(one.candidates) for one in placements) if is_tied else 1
    best: list[Camera] = []
    rivals = 0
    for k in range(n):
        start = [one.candidates[k] for one in placements]
        shown: list[Camera | None] = [None] * len(photos)
        for i, camera in zip(known, start, strict=True):
            shown[i] = camera
        step = PlacingStep(k / n, f"judging pose {k + 1} of {n}", tuple(shown))
        yield step
        reduced = [
            camera.resized(photo.width, photo.height)
            for photo, camera in zip(small, start, strict=True)
        ]
        end: Finished | None = None
        try:
            for event in refine(mesh, small, reduced, config):
                end = event if isinstance(event, Finished) else None
                yield step
        except PhotoregError:
            continue
        if end is None or end.verdict is None or not end.verdict.is_credible:
            continue
        ends = [
            camera.resized(photos[i].width, photos[i].height)
            for i, camera in zip(known, end.cameras, strict=True)
        ]
        if end.verdict.grade == "convincing" and not best:
            best = ends
        elif not best or any(map(_is_another, ends, best)):
            rivals += 1
    if not best or rivals:
        yield placed
        return
    result = list(placed.placements)
    for i, one, camera in zip(known, placements, best, strict=True):
        result[i] = dataclasses.replace(
            one,
            grade="found",
            sentence=f"{photos[i].name}: found: refined from there, the camera convinces.",
            candidates=(camera, *one.candidates[1:]),
        )
    yield Placed(tuple(result))
