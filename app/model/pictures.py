"""What the worker draws for the page: what it is asked for, and what comes of it."""

import dataclasses
from typing import Literal

import numpy as np

from photoreg.geometry.camera import Camera
from photoreg.report.photo_comparison import PhotoComparison

OverlayStyle = Literal["blend", "checkerboard", "difference", "edges", "blink", "swipe"]
"""How two photos are laid over each other."""
ThroughStyle = Literal["surface", "wireframe", "lines", "normals", "photo"]
"""What lies over a photo that is looked through: the mesh, drawn in one of four ways,
or another photo, in the overlay style."""
Surface = Literal["clay", "photos", "disagreement"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class OverlayView:
    """How the overlay picture is drawn."""

    style: OverlayStyle
    onto: int
    """Index of the photo that stays; the next one is carried over into it."""
    share: float = 0.5
    """Share of the carried photo in a blend; where the line of a swipe is."""
    through: ThroughStyle = "surface"
    """What a view through the photo needs beside the overlay."""
    mesh_opacity: float = 0.5
    """How much of the normals is mixed into the photo."""
    start_line: float | None = None
    """Where the start ends and the overlay now begins, as a share of the width."""
    surface: Surface = "clay"
    """What the object shows in the 3-D view."""


@dataclasses.dataclass(frozen=True, eq=False)
class Compare:
    """Draw the overlays of two sets of cameras, and where their photos disagree."""

    before: tuple[Camera, ...]
    after: tuple[Camera, ...]
    style: OverlayStyle
    surface: Surface
    """What the object is to show with the cameras after."""


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """The overlay drawn for the newest cameras."""

    jpeg: bytes
    error_px: float | None
    """Mean projection error of those cameras, where the truth is known."""
    other_jpeg: bytes | None = None
    """What a blink shows in turn with ``jpeg``."""
    onto: str = ""
    """Name of the photo that the picture was drawn upon."""
    normals_jpeg: bytes | None = None
    """The surface's normals over that photo, where asked for."""
    lines: np.ndarray | None = None
    """Silhouette and creases that it sees, (s, 2, 3), where asked for."""


@dataclasses.dataclass(frozen=True, eq=False)
class Compared:
    """Two sets of cameras beside each other, in every photo."""

    asked: Compare
    """What was compared."""
    photos: tuple[PhotoComparison, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Cloud:
    """Where the best individuals of a search's population have their cameras."""

    centers: np.ndarray
    """(n, c, 3), in world axes."""
