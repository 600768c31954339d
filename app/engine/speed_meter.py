"""How fast this machine refines the scene: measured on the scene itself."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

from app.model.durations import Speed
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.refinement import refine

PRESETS: tuple[PresetName, ...] = ("fast", "default", "thorough", "paper")
MEASURED_GENERATIONS = 6


def measure_speed(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    must_stop: Callable[[], bool],
) -> Speed | None:
    """Times a few generations of each preset and one polish, on the scene itself.

    Args:
        mesh: The surface.
        photos: The photos.
        cameras: Cameras that see it.
        must_stop: Asked after each step; true ends the measurement.

    Returns:
        The speed; None where it was stopped.

    Raises:
        PhotoregError: if these cameras cannot be refined.
    """
    rates: list[tuple[PresetName, float]] = []
    for preset in PRESETS:
        timed = _timed(mesh, photos, cameras, _short_search(preset), must_stop)
        if timed is None:
            return None
        first, last = timed[0], timed[-1]
        seconds = last.elapsed_s - first.elapsed_s
        rates.append(
            (preset, (last.evaluations - first.evaluations) / max(seconds, 1e-6))
        )
    config = RegistrationConfig()
    config = dataclasses.replace(
        config,
        genetic=dataclasses.replace(config.genetic, population=20, generations=1),
    )
    polish_s, prepare_s = 0.0, 0.0
    for event in refine(mesh, photos, cameras, config):
        if must_stop():
            return None
        if isinstance(event, Finished):
            prepare_s = event.seconds_by_phase["prepare"]
            polish_s = event.seconds_by_phase["polish"]
    return Speed(prepare_s, tuple(rates), polish_s)


def _short_search(preset: PresetName) -> RegistrationConfig:
    config = RegistrationConfig.preset(preset)
    return dataclasses.replace(
        config,
        polish_after=False,
        genetic=dataclasses.replace(
            config.genetic, generations=MEASURED_GENERATIONS, restarts=1
        ),
    )


def _timed(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: RegistrationConfig,
    must_stop: Callable[[], bool],
) -> list[Progress] | None:
    """The search's events, the first population's included."""
    events: list[Progress] = []
    for event in _progress(refine(mesh, photos, cameras, config)):
        if must_stop():
            return None
        if event.phase == "search":
            events.append(event)
    return events


def _progress(events: Iterator[Progress | Finished]) -> Iterator[Progress]:
    for event in events:
        if isinstance(event, Progress):
            yield event
