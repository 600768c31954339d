"""What a refinement costs in time, scaled from how fast this machine was measured."""

import dataclasses
from collections.abc import Sequence

from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.events import Progress


@dataclasses.dataclass(frozen=True)
class Speed:
    """How fast this machine refines the scene that is open."""

    prepare_s: float
    """Seconds until the search begins."""
    evaluations_per_s: tuple[tuple[PresetName, float], ...]
    """Individuals that the search values a second, by preset."""
    polish_s: float
    """Seconds of one polish with the usual settings."""

    def rate(self, preset: PresetName) -> float:
        """Evaluations a second with a preset's settings."""
        return dict(self.evaluations_per_s)[preset]


def search_evaluations(config: RegistrationConfig) -> int:
    """Individuals that the whole search values."""
    genetic = config.genetic
    return genetic.restarts * (
        genetic.population + genetic.generations * genetic.n_children
    )


def polish_work(config: RegistrationConfig) -> float:
    """Work of the polish relative to the usual settings."""
    usual = RegistrationConfig().polish

    def work(points: Sequence[int], rounds: Sequence[int], iterations: int) -> float:
        return iterations * sum(
            n * turns for n, turns in zip(points, rounds, strict=True)
        )

    polish = config.polish
    return work(polish.points, polish.rounds, polish.iterations) / work(
        usual.points, usual.rounds, usual.iterations
    )


def polish_seconds(speed: Speed, config: RegistrationConfig) -> float:
    """Seconds of the polish; 0 where none follows."""
    return speed.polish_s * polish_work(config) if config.polish_after else 0.0


def search_seconds(
    speed: Speed, preset: PresetName, config: RegistrationConfig
) -> float:
    """Seconds of the whole search."""
    usual = RegistrationConfig.preset(preset)
    rate = speed.rate(preset) * usual.samples / config.samples
    return search_evaluations(config) / rate


def expected_seconds(
    speed: Speed, preset: PresetName, config: RegistrationConfig
) -> float:
    """Seconds of a whole refinement with these settings, which come from ``preset``."""
    return (
        speed.prepare_s
        + search_seconds(speed, preset, config)
        + polish_seconds(speed, config)
    )


def seconds_left(
    speed: Speed | None,
    preset: PresetName,
    config: RegistrationConfig,
    progress: Progress,
    rate: float | None,
    elapsed_s: float,
) -> float | None:
    """Seconds until a running refinement ends; None where nothing is known yet.

    Args:
        speed: What was measured before.
        preset: Where its settings come from.
        config: Its settings.
        progress: Where it is.
        rate: Evaluations a second of this very search.
        elapsed_s: Seconds it has been at work.
    """
    if progress.phase == "polish" and progress.fraction > 0.4:
        return elapsed_s * (1.0 - progress.fraction) / progress.fraction
    if speed is None:
        return None
    remaining = max(0, search_evaluations(config) - progress.evaluations)
    if progress.phase == "polish":
        remaining = 0
    rate = rate or speed.rate(preset)
    return remaining / rate + polish_seconds(speed, config)
