"""The table of a camera's parameters: one row per number, in the polish's order.

A number's name, what locks it, how its size is displayed, its prior and how far it may
move are defined here and nowhere else.
"""

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np

from photoreg.geometry.camera import MAX_FOCAL_PX, Camera
from photoreg.geometry.lens import N_TERMS, TERMS, Distortion
from photoreg.parameters.bounds import (
    LENS_SIGMAS,
    MAX_FOCAL_FACTOR,
    MAX_LENS_TERM,
    MAX_PRINCIPAL_SHARE,
    MAX_SHIFT_SHARE,
    MAX_TURN_RAD,
    PriorScales,
)

Part = Literal["pose", "focal", "principal_point", "lens"]
"""What of a camera can be held by itself."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number of a camera that may move."""

    name: str
    """In plain words."""
    part: Part
    """What it is a part of: held with it, and shared with it."""
    sigma: Callable[[PriorScales, Camera, float], float]
    """One standard deviation of its prior, in the units of the increments, for a base
    camera and its distance from the pivot: radians, model units, a logarithm, pixels."""
    limit: Callable[[Camera, float], float]
    """How far it may go from its base, in the same units."""
    words: str = "{:.2g} px"
    """How a size is displayed, in the units of ``plain``."""
    plain: Callable[[PriorScales, Camera], float] | None = None
    """One sigma in the units shown to users: degrees, percent; None: unchanged."""

    @property
    def is_shared(self) -> bool:
        """Whether photos of one camera and zoom have it in common."""
        return self.part in ("focal", "lens")


def _rotation(name: str) -> Parameter:
    return Parameter(
        name,
        "pose",
        lambda s, _base, _distance: float(np.deg2rad(s.rotation_deg)),
        lambda _base, _distance: MAX_TURN_RAD,
        "{:.2g}°",
        lambda s, _base: s.rotation_deg,
    )


def _position(name: str) -> Parameter:
    return Parameter(
        name,
        "pose",
        lambda s, _base, distance: s.translation * distance,
        lambda _base, distance: MAX_SHIFT_SHARE * distance,
        "{:.2g} %",
        lambda s, _base: 100.0 * s.translation,
    )


def _principal(name: str, side: Literal["width", "height"]) -> Parameter:
    return Parameter(
        name,
        "principal_point",
        lambda s, base, _distance: s.principal_point * getattr(base, side),
        lambda base, _distance: MAX_PRINCIPAL_SHARE * getattr(base, side),
    )


def _lens(term: str) -> Parameter:
    return Parameter(
        f"lens term {term}",
        "lens",
        lambda _s, _base, _distance: LENS_SIGMAS[term],
        lambda _base, _distance: MAX_LENS_TERM,
        "{:.2g}",
    )


def _most_focal(base: Camera, _distance: float) -> float:
    # No base comes near to the largest number but one that is absurd already.
    largest = MAX_FOCAL_PX / float(np.abs(base.K[:2, :2]).max())
    return float(np.log(min(MAX_FOCAL_FACTOR, largest)))


PARAMETERS = (
    _rotation("rotation about the photo's x axis"),
    _rotation("rotation about the photo's y axis"),
    _rotation("rotation in the photo's plane"),
    _position("sideways position"),
    _position("vertical position"),
    _position("distance"),
    Parameter(
        "focal length",
        "focal",
        lambda s, _base, _distance: s.focal,
        _most_focal,
        "{:.2g} %",
        lambda s, _base: 100.0 * s.focal,
    ),
    _principal("principal point x", "width"),
    _principal("principal point y", "height"),
    *(_lens(term) for term in TERMS),
)
"""All of them; the terms of the lens last, and only those count that are solved."""

ROTATION, POSITION = slice(0, 3), slice(3, 6)
FOCAL = 6
PRINCIPAL = slice(7, 9)
N_PINHOLE = len(PARAMETERS) - len(TERMS)
LENS_TERMS = slice(N_PINHOLE, None)
"""Where each part is among the numbers of a camera."""


def camera_parameters(distortion: Distortion = "none") -> tuple[Parameter, ...]:
    """What moves in a camera where so much of its lens is solved."""
    return PARAMETERS[: N_PINHOLE + N_TERMS[distortion]]
