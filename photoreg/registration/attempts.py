"""A second attempt, with a wider search, where the first answer does not convince."""

import dataclasses
from collections.abc import Generator, Sequence

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Event, Finished
from photoreg.registration.refinement import refine


def refine_in_attempts(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig | None = None,
    freedom: Freedom | None = None,
) -> Generator[Event, None, None]:
    """Refines as ``refine`` does, and once more where the answer does not convince.

    The second attempt begins at the same cameras and searches as
    ``RegistrationConfig.searching_wider`` has it. Its answer counts where nothing speaks against it; until then, every event
    holds the cameras of the first.

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
    first = yield from _attempt(mesh, photos, cameras, config, freedom, None)
    if first.verdict is None or first.verdict.is_credible:
        yield first
        return
    second = yield from _attempt(
        mesh, photos, cameras, config.searching_wider(), freedom, first
    )
    assert second.verdict is not None
    chosen, outcome = first, "A wider search did not convince either."
    if second.verdict.is_credible:
        chosen, outcome = second, "It is the answer of a second, wider search."
    phases = first.seconds_by_phase | second.seconds_by_phase
    yield dataclasses.replace(
        chosen,
        reason=f"{chosen.reason} {outcome}",
        elapsed_s=first.elapsed_s + second.elapsed_s,
        generations=first.generations + second.generations,
        evaluations=first.evaluations + second.evaluations,
        seconds_by_phase={
            phase: sum(one.seconds_by_phase.get(phase, 0.0) for one in (first, second))
            for phase in phases
        },
    )


def _attempt(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig,
    freedom: Freedom | None,
    before: Finished | None,
) -> Generator[Event, None, Finished]:
    """Yields all events but the last, which it returns.

    Args:
        mesh: See ``refine``.
        photos: See ``refine``.
        cameras: See ``refine``.
        config: See ``refine``.
        freedom: See ``refine``.
        before: How the attempt before ended, whose cameras are the best so far.
    """
    for event in refine(mesh, photos, cameras, config, freedom):
        if isinstance(event, Finished):
            return event
        if before is not None:
            event = dataclasses.replace(
                event,
                step=f"second attempt: {event.step}",
                cameras=before.cameras,
                checkpoint=None,
            )
        yield event
    raise AssertionError("A refinement ended without its last event.")
