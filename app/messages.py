"""What the app and its worker process tell each other: jobs down, events up."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from app.state import (
    Agreement,
    CurvePoint,
    OverlayStyle,
    PresetName,
    ThroughStyle,
)
from photoreg.camera import Camera
from photoreg.mesh import Mesh
from photoreg.photo import Photo


@dataclasses.dataclass(frozen=True, eq=False)
class SetScene:
    """The mesh and photos that later jobs are about; sent once, they are big."""

    mesh: Mesh
    photos: tuple[Photo, ...]
    mask_pngs: tuple[bytes | None, ...] = ()
    """The photos' masks, see ``app.masks``; empty if no photo has one."""


@dataclasses.dataclass(frozen=True)
class LoadMesh:
    """Read a mesh file."""

    path: Path


@dataclasses.dataclass(frozen=True)
class LoadPhoto:
    """Read a photo file."""

    path: Path


@dataclasses.dataclass(frozen=True)
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


@dataclasses.dataclass(frozen=True, eq=False)
class DrawOverlay:
    """Draw the overlay for these cameras, once."""

    cameras: tuple[Camera, ...]
    view: OverlayView
    truth: tuple[Camera, ...] | None


@dataclasses.dataclass(frozen=True, eq=False)
class Refine:
    """Refine these cameras of the scene's photos."""

    cameras: tuple[Camera, ...]
    preset: PresetName
    view: OverlayView
    truth: tuple[Camera, ...] | None


@dataclasses.dataclass(frozen=True)
class Stop:
    """End the refinement; the best so far is kept."""


@dataclasses.dataclass(frozen=True, eq=False)
class Bake:
    """Make the textured model."""

    cameras: tuple[Camera, ...]


@dataclasses.dataclass(frozen=True)
class Ready:
    """The worker has compiled its kernels and waits for work."""

    seconds: float


@dataclasses.dataclass(frozen=True, eq=False)
class MeshLoaded:
    """A mesh file was read."""

    mesh: Mesh
    display_mesh: Mesh


@dataclasses.dataclass(frozen=True, eq=False)
class PhotoLoaded:
    """A photo file was read."""

    photo: Photo


@dataclasses.dataclass(frozen=True, eq=False)
class Live:
    """The refinement goes on."""

    progress: Any
    """A ``photoreg.registration.Progress``."""
    curve: tuple[CurvePoint, ...]
    """The cost curve since the last of these."""


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
class Measured:
    """How well the photos agree under the newest cameras."""

    agreement: Agreement


@dataclasses.dataclass(frozen=True, eq=False)
class Refined:
    """The refinement ended; ``finished`` is None when the user stopped it."""

    cameras: tuple[Camera, ...]
    finished: Any
    """A ``photoreg.registration.Finished``, or None."""
    start_error_px: float | None
    error_px: float | None


@dataclasses.dataclass(frozen=True)
class Working:
    """A job goes on."""

    title: str
    fraction: float


@dataclasses.dataclass(frozen=True, eq=False)
class Baked:
    """The textured model, ready to be downloaded and shown."""

    archive: bytes
    glb: bytes
    cameras: tuple[Camera, ...]
    summary: str


@dataclasses.dataclass(frozen=True, eq=False)
class Failed:
    """A job could not be done; the sentence is for the user."""

    job: str
    message: str
    details: str = ""
    """The traceback of what nobody foresaw; empty for errors raised on purpose."""


@dataclasses.dataclass(frozen=True)
class Died:
    """The worker process is gone; a new one is on its way."""

    exit_code: int | None


Job = SetScene | LoadMesh | LoadPhoto | DrawOverlay | Refine | Bake | OverlayView | Stop
Event = (
    Ready
    | MeshLoaded
    | PhotoLoaded
    | Live
    | Picture
    | Measured
    | Refined
    | Working
    | Baked
    | Failed
    | Died
)
