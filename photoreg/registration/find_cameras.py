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
from photoreg.placing.outcome import Box, Placed, PlacingEvent, PlacingStep
from photoreg.placing.place import FITS_WITH_OTHERS, place
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished
from photoreg.registration.refinement import refine

PLACING_SHARE = 0.6
"""Share of the progress bar for placing, where poses are judged afterwards."""
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
    for event in place(mesh, photos, boxes=boxes, focals_px=focals_px):
        if isinstance(event, PlacingStep):
            share = PLACING_SHARE * event.fraction
            yield dataclasses.replace(event, fraction=share)
        else:
            yield from _judged(mesh, photos, event, seed)


def _judged(
    mesh: Mesh, photos: Sequence[Photo], placed: Placed, seed: int
) -> Generator[PlacingEvent, None, None]:
    """The placements, with what refining says of those that are unsure."""
    known = [i for i, one in enumerate(placed.placements) if one.candidates]
    placements = [placed.placements[i] for i in known]
    doubtful = [one for one in placements if one.grade == "unsure"]
    is_worth_it = all(one.overlap >= FITS_WITH_OTHERS for one in placements)
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
        fraction = PLACING_SHARE + (1.0 - PLACING_SHARE) * k / n
        step = PlacingStep(fraction, f"judging pose {k + 1} of {n}", tuple(shown))
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
        if end.verdict.grade == "convincing" and not best:
            best = [
                camera.resized(photos[i].width, photos[i].height)
                for i, camera in zip(known, end.cameras, strict=True)
            ]
        else:
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
