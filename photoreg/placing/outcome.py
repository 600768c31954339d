"""What placing tells while it runs, and how sure it is of where it put the cameras."""

import dataclasses
from typing import Literal

from photoreg.geometry.camera import Camera

PlacingGrade = Literal["found", "unsure", "not found"]

How = Literal["mask", "box", "plain", "clutter", "common points"]
"""What told the object from its background, by "clutter" a guess; or what several photos
show alike, which needs no background."""

Box = tuple[float, float, float, float]
"""Left, top, width and height in pixels of the photo."""

MOST_CANDIDATES = 3
"""Poses that a person is shown to pick from."""

WHAT_TO_DO = "Draw a box around the object, give a mask, or click the same points in photo and mesh."


@dataclasses.dataclass(frozen=True, eq=False)
class Placement:
    """Where the camera of one photo may be."""

    grade: PlacingGrade
    sentence: str
    """The grade, its reason, and what to do where it is not found."""
    candidates: tuple[Camera, ...] = ()
    """Up to ``MOST_CANDIDATES`` poses that differ, the best first; those of several photos
    at one place belong together. Empty where nothing was found."""
    overlap: float = 0.0
    """Common area over joint area of the object in the photo and the mesh as the best
    candidate sees it."""
    how: How | None = None
    """What told the object from its background; None where nothing did."""
    is_tied: bool = False
    """Whether other poses fit the outline as well."""
    about_axis: bool = False
    """Whether these are turns about one axis of the object."""


@dataclasses.dataclass(frozen=True, eq=False)
class PlacingStep:
    """One step of placing."""

    fraction: float
    """Share of the work done, in [0, 1]."""
    step: str
    """What is going on, in plain words."""
    cameras: tuple[Camera | None, ...]
    """The best poses so far, one a photo; None where there is none yet."""


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """How placing ended."""

    placements: tuple[Placement, ...]
    """One a photo."""

    @property
    def grade(self) -> PlacingGrade:
        """The worst grade of all photos."""
        grades = {placement.grade for placement in self.placements}
        for grade in ("not found", "unsure"):
            if grade in grades:
                return grade
        return "found"


PlacingEvent = PlacingStep | Placed
