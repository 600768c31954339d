"""One refinement as the app shows and keeps it: running, or ended.

No viser here.
"""

import dataclasses
from typing import Literal

from photoreg.checks import Measured
from photoreg.geometry.camera import Camera
from photoreg.parameters.freedom import Freedom
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.verdict import Grade
from photoreg.report.cost_curve import CurvePoint

Status = Literal["idle", "starting", "running", "paused", "stopping", "review"]

PRESET_NAMES: dict[PresetName, str] = {
    "fast": "Quick",
    "default": "Standard",
    "thorough": "Thorough",
    "paper": "Paper's method (for comparison)",
}
"""What the presets are called on the page, the quickest first."""


@dataclasses.dataclass(frozen=True, eq=False)
class KeptSearch:
    """From where a run can go on, to the answer it would have had without a break."""

    run: int
    """The run's number."""
    step: int
    """The last step of its curve that is done."""
    content: bytes
    """A ``photoreg.registration.checkpoint.Checkpoint`` as bytes."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """A refinement: running, or ended and waiting to be accepted or reverted."""

    status: Status = "idle"
    number: int = 0
    """Which run of this document it is, from 1; 0 while there is none."""
    began: str = ""
    """When, as local date and time."""
    preset: PresetName = "default"
    config: RegistrationConfig | None = None
    """Its settings."""
    photo_names: tuple[str, ...] = ()
    start: tuple[Camera, ...] = ()
    cameras: tuple[Camera, ...] = ()
    """The best so far, in the order of ``photo_names``."""
    freedom: Freedom = dataclasses.field(default_factory=Freedom)
    """What it may move, of ``photo_names``."""
    phase: str = ""
    step: str = ""
    fraction: Measured = 0.0
    elapsed_s: Measured = 0.0
    """Seconds at work: without pauses."""
    generation: int = 0
    evaluations: int = 0
    evaluations_per_s: Measured | None = None
    """Speed of the search."""
    time_left_s: Measured | None = None
    """Seconds to the end, as far as measurements tell."""
    curve: tuple[CurvePoint, ...] = ()
    start_cost: Measured | None = None
    """Photo-inconsistency of the start; known at the end."""
    cost: Measured | None = None
    """The same of the answer, measured in the same way."""
    start_error_px: Measured | None = None
    """Mean projection error against the truth, where it is known."""
    error_px: Measured | None = None
    expected_errors_px: tuple[Measured | None, ...] = ()
    """How far off each camera is to be expected, in pixels; empty where unknown."""
    polish_error_px: Measured | None = None
    """Mean of the same while the run goes on, as its polish tells; None before."""
    grade: Grade | None = None
    """How far the answer is to be believed; None where nothing is known of it."""
    verdict: str = ""
    """The same in a sentence."""
    is_unwanted: bool = False
    """Stopped to be reverted: it is kept in the list only."""
    outcome: str = ""
    """How it ended, in words."""
    warnings: tuple[str, ...] = ()
    standard_errors: tuple[str, ...] = ()
    """How sure each camera is, one sentence a photo, and how wrong the scan seems."""
    undetermined: tuple[str, ...] = ()
    """What the photos leave open, the weakest first."""

    @property
    def is_active(self) -> bool:
        """Whether the worker is at it, or waits in the middle of it."""
        return self.status in ("starting", "running", "paused", "stopping")

    @property
    def is_cut_short(self) -> bool:
        """Whether it ended, but not by itself."""
        return self.status == "review" and self.start_cost is None

    @property
    def is_changed(self) -> bool:
        """Whether its settings are not quite the preset's; the seed does not count."""
        if self.config is None:
            return False
        return self.config != RegistrationConfig.preset(self.preset, self.config.seed)

    @property
    def settings_name(self) -> str:
        """Its settings, in a word or two."""
        name = PRESET_NAMES[self.preset]
        return f"{name}, changed" if self.is_changed else name

    @property
    def expected_error_px(self) -> float | None:
        """Mean of the expected errors, None where nothing is known."""
        known = [error for error in self.expected_errors_px if error is not None]
        return sum(known) / len(known) if known else self.polish_error_px

    @property
    def told_error_px(self) -> float | None:
        """The expected error, as far as it says something.

        What is expected of a right answer would mislead about one that is not believed.
        """
        return None if self.grade == "unconvincing" else self.expected_error_px
