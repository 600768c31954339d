"""Where the cameras of photos are, found without a click: outlines first, colours then."""

from collections.abc import Generator, Mapping, Sequence

import numpy as np

from photoreg.errors import InputError
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rotations import rotation_vector
from photoreg.imaging.photo import Photo
from photoreg.placing.agreement import (
    DISTINCT_DEG,
    Choice,
    ranked_choices,
    readings_of,
    surface_points,
)
from photoreg.placing.outcome import (
    MOST_CANDIDATES,
    WHAT_TO_DO,
    Box,
    Placed,
    Placement,
    PlacingEvent,
    PlacingGrade,
    PlacingStep,
)
from photoreg.placing.outline_candidates import (
    Candidate,
    OutlineSearch,
    differ,
    distinct,
)
from photoreg.placing.segmentation import Segmentation, segment

FITS = 0.98
"""Least overlap of an outline that is believed by itself: less than a pixel is wrong all
along it, of 320. Poses that were wrong reached 0.93 with a stand or a hand in the mask."""
CLEARLY = 0.03
"""How much more it overlaps than that of any other pose, then."""
FITS_WITH_OTHERS = 0.9
"""Least overlap of an outline where photos confirm each other."""
CLEAR_MARGIN = 0.25
"""By how much photos agree better in one choice of poses than in any other where it is
believed: wrong ones came to half of that."""
TIE = 0.005
"""Overlaps that differ by less are equal: twice what noise in a photo does to one."""
ALIKE_AXES = 0.95
"""Cosine between axes of turns that are taken for one."""
LEAST_OVERLAP = 0.7
"""An outline that overlaps less is not this object's."""
SEGMENTED = 0.1
"""Share of the work of finding the object in a photo."""


def place(
    mesh: Mesh,
    photos: Sequence[Photo],
    *,
    boxes: Mapping[str, Box] | None = None,
    focals_px: Mapping[str, float] | None = None,
) -> Generator[PlacingEvent, None, None]:
    """Finds cameras of photos by the outline of the object and the colours on it.

    Stop iterating to cancel. The last event is a ``Placed``. The cameras are some pixels
    off: ``registration.refinement.refine`` makes them precise.

    Args:
        mesh: The surface.
        photos: One or more; each mask says where the object is.
        boxes: Around the object, in pixels, by the photo's name: hints.
        focals_px: Focal lengths in pixels by the photo's name; else EXIF tells, or nothing.

    Raises:
        InputError: if there is no photo, or a box or a focal length is of a photo that
            is not there, or is not possible.
    """
    if len(photos) == 0:
        raise InputError("Placing needs at least one photo, but there is none.")
    boxes, focals_px = dict(boxes or {}), dict(focals_px or {})
    names = [photo.name for photo in photos]
    for name in (*boxes, *focals_px):
        if name not in names:
            raise InputError(f"There is no photo {name}; there are {', '.join(names)}.")
    for name, focal_px in focals_px.items():
        if not 0.0 < focal_px < np.inf:
            raise InputError(
                f"The focal length of {name} is {focal_px:g} px; give a positive number."
            )
    return _events(mesh, photos, boxes, focals_px)


def _events(
    mesh: Mesh,
    photos: Sequence[Photo],
    boxes: Mapping[str, Box],
    focals_px: Mapping[str, float],
) -> Generator[PlacingEvent, None, None]:
    none_yet: list[Candidate] = []
    by_photo = [none_yet for _ in photos]
    segmented: list[Segmentation | None] = []

    def step(words: str) -> PlacingStep:
        work = SEGMENTED * len(segmented) + (1 - SEGMENTED) * sum(map(bool, by_photo))
        best = tuple(found[0].camera if found else None for found in by_photo)
        return PlacingStep(0.95 * work / len(photos), words, best)

    yield step("getting ready")
    for photo in photos:
        segmented.append(segment(photo, boxes.get(photo.name)))
        yield step(f"looking for the object in {photo.name}")
    search = OutlineSearch(mesh)
    for i, (photo, found) in enumerate(zip(photos, segmented, strict=True)):
        if found is not None:
            focal_px = focals_px.get(photo.name, photo.exif_focal_px)
            ends = search.candidates(photo, found, focal_px)
            by_photo[i] = [one for one in ends if one.overlap >= LEAST_OVERLAP]
        yield step(f"comparing outlines with {photo.name}")
    choices: list[Choice] = []
    known = [i for i, found in enumerate(by_photo) if found]
    if len(known) > 1:
        samples = surface_points(search.fine)
        readings = []
        for i in known:
            found = segmented[i]
            assert found is not None
            readings.append(
                readings_of(search.fine, samples, photos[i], found.covered, by_photo[i])
            )
        choices = ranked_choices(
            [by_photo[i] for i in known], readings, MOST_CANDIDATES
        )
    yield Placed(
        tuple(
            _placement(
                photo,
                segmented[i],
                by_photo[i],
                [by_photo[i][choice.chosen[known.index(i)]] for choice in choices]
                if i in known
                else [],
                choices[0].margin if choices else None,
            )
            for i, photo in enumerate(photos)
        )
    )


def _placement(
    photo: Photo,
    found: Segmentation | None,
    candidates: Sequence[Candidate],
    chosen: Sequence[Candidate],
    margin: float | None,
) -> Placement:
    """What is known of one photo.

    Args:
        photo: The photo.
        found: The object in it.
        candidates: Its poses, the best first.
        chosen: Which of them go best with those of other photos; empty where there are
            none.
        margin: How much better the first of these choices is than the second.
    """
    if found is None:
        return Placement(
            "not found",
            f"{photo.name}: not found, as nothing stands out from the background. "
            f"{WHAT_TO_DO}",
        )
    if not candidates:
        return Placement(
            "not found",
            f"{photo.name}: not found; no view of the mesh has the outline that the photo "
            f"shows. {WHAT_TO_DO}",
            how=found.how,
        )
    poses = list(chosen) or distinct(candidates, DISTINCT_DEG)
    first = poses[0]
    ties = [
        one
        for one in candidates
        if one.overlap >= candidates[0].overlap - TIE
        and differ(one.camera, first.camera, DISTINCT_DEG)
    ]
    about_axis = _turn_about_one_axis(first, ties)
    grade, why = _grade(found, first, candidates, ties, about_axis, margin)
    sentence = f"{photo.name}: {grade}{why}"
    if grade != "found":
        sentence += f" Look at the candidates and pick one. {WHAT_TO_DO}"
    return Placement(
        grade,
        sentence,
        tuple(one.camera for one in poses[:MOST_CANDIDATES]),
        first.overlap,
        found.how,
        bool(ties),
        about_axis,
    )


def _grade(
    found: Segmentation,
    first: Candidate,
    candidates: Sequence[Candidate],
    ties: Sequence[Candidate],
    about_axis: bool,
    margin: float | None,
) -> tuple[PlacingGrade, str]:
    """How sure a pose is, and why, as the rest of a sentence."""
    if found.is_weak:
        return "unsure", ", as the background is not plain."
    if found.touches_frame:
        return "unsure", ", as the object goes on beyond the photo."
    if about_axis:
        return "unsure", ": any turn about the object's axis fits equally."
    if margin is not None:
        if first.overlap < FITS_WITH_OTHERS:
            return "unsure", _fits_badly(first)
        if margin < CLEAR_MARGIN:
            return "unsure", ", as the photos agree nearly as well in other poses."
        return (
            "found",
            f": outlines overlap by {100 * first.overlap:.1f} %, and colours agree.",
        )
    if ties:
        return "unsure", ", as other poses fit the outline equally."
    if first.overlap < FITS:
        return "unsure", _fits_badly(first)
    others = [
        one.overlap
        for one in candidates
        if differ(one.camera, first.camera, DISTINCT_DEG)
    ]
    if others and first.overlap < max(others) + CLEARLY:
        return "unsure", ", as other poses fit the outline nearly as well."
    return "found", f": outlines overlap by {100 * first.overlap:.1f} %."


def _fits_badly(first: Candidate) -> str:
    return f", as the outlines overlap by {100 * first.overlap:.0f} % only."


def _turn_about_one_axis(first: Candidate, ties: Sequence[Candidate]) -> bool:
    """Whether poses differ from the first by turns of the object about one axis."""
    if len(ties) < 2:
        return False
    R = first.camera.R_cam_world
    axes = []
    for tie in ties:
        turn = rotation_vector(R.T @ tie.camera.R_cam_world)
        length = float(np.linalg.norm(turn))
        if length < np.radians(170.0):
            axes.append(turn / max(length, 1e-12))
    if len(axes) < 2:
        return False
    cosines = np.abs(np.array(axes) @ axes[0])
    return bool((cosines >= ALIKE_AXES).all())
