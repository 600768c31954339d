"""Further attempts where the first answer does not convince."""

import dataclasses
from collections.abc import Generator, Sequence

import numpy as np

from photoreg.errors import RefinementError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.unseen import guesses_by_view, share_in_view
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import NOTHING_HELD, Freedom
from photoreg.placing.outcome import PlacingStep
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Event, Finished, Progress
from photoreg.registration.find_cameras import find_cameras
from photoreg.registration.refinement import refine

WAS_FOUND = "The answer began at cameras that were found by the object's outline."


def refine_in_attempts(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig | None = None,
    freedom: Freedom | None = None,
) -> Generator[Event, None, None]:
    """Refines as ``refine`` does, and once more where the answer does not convince.

    The second attempt begins at the same cameras and searches as
    ``RegistrationConfig.searching_wider`` has it. Its answer counts where nothing speaks
    against it. Where it does not convince either, or the cameras given see nothing of the
    surface, a last attempt begins at cameras found by the object's outline, if there is
    no doubt about them. Until an attempt counts, every event holds the cameras of the
    first.

    Args:
        mesh: The surface.
        photos: One or more.
        cameras: The pre-registration, one a photo, in the same order.
        config: Settings of the first attempt; None: the default preset.
        freedom: What may move; None: everything.

    Raises:
        InputError: as ``refine``.
        RefinementError: as ``refine``.
    """
    config = config or RegistrationConfig()
    try:
        first = yield from _attempt(mesh, photos, cameras, config, freedom)
    except RefinementError:
        if share_in_view(mesh, cameras) > 0.0 or guesses_by_view(mesh, cameras):
            raise  # What is wrong is known, such as other axes.
        blind = yield from _from_found(mesh, photos, cameras, config, freedom)
        if blind is None:
            raise
        outcome = f"The cameras given see nothing of the surface. {WAS_FOUND}"
        yield dataclasses.replace(blind, reason=f"{blind.reason} {outcome}")
        return
    if first.verdict is None or first.verdict.is_credible:
        yield first
        return
    second = yield from _attempt(
        mesh, photos, cameras, config.searching_wider(), freedom, first
    )
    assert second.verdict is not None
    attempts = [first, second]
    chosen, outcome = first, "A wider search did not convince either."
    if second.verdict.is_credible:
        chosen, outcome = second, "It is the answer of a second, wider search."
    else:
        third = yield from _from_found(mesh, photos, cameras, config, freedom, first)
        if third is not None:
            chosen, outcome = third, f"{outcome} {WAS_FOUND}"
            attempts.append(third)
    phases = dict.fromkeys(phase for one in attempts for phase in one.seconds_by_phase)
    yield dataclasses.replace(
        chosen,
        reason=f"{chosen.reason} {outcome}",
        elapsed_s=sum(one.elapsed_s for one in attempts),
        generations=sum(one.generations for one in attempts),
        evaluations=sum(one.evaluations for one in attempts),
        seconds_by_phase={
            phase: sum(one.seconds_by_phase.get(phase, 0.0) for one in attempts)
            for phase in phases
        },
    )


def _from_found(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig,
    freedom: Freedom | None,
    before: Finished | None = None,
) -> Generator[Event, None, Finished | None]:
    """An attempt from cameras that are found by the object's outline.

    Returns:
        None where something of a camera is held, where not all cameras are found beyond
        doubt, or where this answer does not convince either.
    """
    held = (freedom or Freedom()).of
    if any(held(i) != NOTHING_HELD for i in range(len(photos))):
        return None
    best = tuple(cameras) if before is None else before.cameras
    cost = np.inf if before is None else before.cost
    placed = None
    for event in find_cameras(mesh, photos, seed=config.seed):
        if not isinstance(event, PlacingStep):
            placed = event
            continue
        yield Progress(
            phase="prepare",
            step=f"finding the cameras: {event.step}",
            fraction=event.fraction,
            generation=0,
            evaluations=0,
            best_cost=cost,
            median_cost=cost,
            elapsed_s=0.0 if before is None else before.elapsed_s,
            cameras=best,
        )
    if placed is None or placed.grade != "found":
        return None
    found = [one.candidates[0] for one in placed.placements]
    last = yield from _attempt(
        mesh, photos, found, config, freedom, before, "from found cameras"
    )
    return last if last.verdict is not None and last.verdict.is_credible else None


def _attempt(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig,
    freedom: Freedom | None,
    before: Finished | None = None,
    words: str = "second attempt",
) -> Generator[Event, None, Finished]:
    """Yields all events but the last, which it returns.

    Args:
        mesh: See ``refine``.
        photos: See ``refine``.
        cameras: See ``refine``.
        config: See ``refine``.
        freedom: See ``refine``.
        before: How the attempt before ended, whose cameras are the best so far.
        words: What to call this attempt.
    """
    for event in refine(mesh, photos, cameras, config, freedom):
        if isinstance(event, Finished):
            return event
        if before is not None:
            event = dataclasses.replace(
                event,
                step=f"{words}: {event.step}",
                cameras=before.cameras,
                checkpoint=None,
            )
        yield event
    raise AssertionError("A refinement ended without its last event.")
