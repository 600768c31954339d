"""What the app and its processes tell each other: jobs down, events up."""

import dataclasses
from pathlib import Path
from typing import Any

from app.model.durations import Speed
from app.model.pictures import Cloud, Compare, Compared, OverlayView, Picture
from app.model.run import KeptSearch
from app.model.state import Agreement, FoundCamera, ModelChoice, Texture
from photoreg.formats.cameras.cameras_json import CameraFile
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.gene_box import BoxReach
from photoreg.placing.outcome import Box
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.readiness import Readiness
from photoreg.report.cost_curve import CurvePoint
from photoreg.texture.config import TextureConfig

SPARE_TIME = "SpareTime"
"""What ``Failed`` calls what the worker does while nothing is asked of it."""


@dataclasses.dataclass(frozen=True, eq=False)
class SetScene:
    """The mesh and photos that later jobs are about; sent once, they are big."""

    mesh: Mesh
    photos: tuple[Photo, ...]
    mask_pngs: tuple[bytes | None, ...] = ()
    """The photos' masks, see ``app.model.masks``; empty if no photo has one."""
    addresses: tuple[str, ...] = ()
    """Where a page finds the photos, reduced; empty if no page is to show them on the
    surface."""


@dataclasses.dataclass(frozen=True)
class SetMask:
    """Another mask for one photo of the scene; what is big stays where it is."""

    photo: int
    """Index of the photo in the scene."""
    png: bytes | None
    """See ``app.model.masks``; None: the photo counts everywhere."""


@dataclasses.dataclass(frozen=True, eq=False)
class DrawOverlay:
    """Draw the overlay for these cameras, once."""

    cameras: tuple[Camera, ...]
    view: OverlayView
    truth: tuple[Camera, ...] | None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Refine:
    """Refine these cameras of the scene's photos."""

    cameras: tuple[Camera, ...]
    config: RegistrationConfig
    view: OverlayView
    truth: tuple[Camera, ...] | None
    freedom: Freedom = dataclasses.field(default_factory=Freedom)
    """What may move."""
    number: int = 0
    """The run's number."""
    kept: KeptSearch | None = None
    """Where it goes on; None: it begins."""
    level: float = 1.0
    """Where the cost curve was then."""


@dataclasses.dataclass(frozen=True)
class FindCameras:
    """Find the cameras of some of the scene's photos, which nobody has placed."""

    photos: tuple[int, ...]
    """By index in the scene."""
    boxes: tuple[Box | None, ...]
    """Around the object in each of these, where somebody drew one."""


@dataclasses.dataclass(frozen=True)
class MeasureReach:
    """Tell how far a search with these settings looks, from now on."""

    config: RegistrationConfig
    freedom: Freedom


@dataclasses.dataclass(frozen=True)
class Watch:
    """Whether anybody is watching; if not, a running refinement draws no pictures."""

    on: bool


@dataclasses.dataclass(frozen=True)
class Pause:
    """Halt the refinement where it is."""


@dataclasses.dataclass(frozen=True)
class Resume:
    """Go on with the refinement."""


@dataclasses.dataclass(frozen=True)
class Stop:
    """End the refinement, keeping the best so far, or the making of a texture."""


@dataclasses.dataclass(frozen=True, eq=False)
class Bake:
    """Make the textured model."""

    cameras: tuple[Camera, ...]
    config: TextureConfig = TextureConfig()
    masks: str = ""
    """Tells the masks of the scene from others, see ``app.model.masks.masks_stamp``."""


@dataclasses.dataclass(frozen=True)
class Pack:
    """Make a file for download of the textured model."""

    choice: ModelChoice
    made_with: Bake
    """What the model was made with; where the worker has it no more, it is made again."""
    can_be_made: bool = True
    """Whether that would be the same model: photos and settings are as they were."""


@dataclasses.dataclass(frozen=True)
class Ready:
    """The worker has compiled its kernels and waits for work."""

    seconds: float


@dataclasses.dataclass(frozen=True)
class Reading:
    """A file is being read."""

    title: str
    fraction: float
    """Of all the files that are read together."""


@dataclasses.dataclass(frozen=True)
class Unpacked:
    """Zips are unpacked, and each mesh is one file with what belongs to it."""

    paths: tuple[Path, ...]
    """What is to be read."""
    left_out: tuple[str, ...] = ()
    """A sentence for each file that is of a kind that is not read."""


@dataclasses.dataclass(frozen=True)
class ReadAll:
    """No more files come."""

    complete: bool
    """False: the reader died before its end."""


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
class CamerasLoaded:
    """Cameras were read."""

    name: str
    """Of their file, or of their format where that is a folder."""
    file: CameraFile


@dataclasses.dataclass(frozen=True, eq=False)
class Live:
    """The refinement goes on."""

    progress: Any
    """A ``photoreg.registration.refinement.Progress``."""
    curve: tuple[CurvePoint, ...]
    """The cost curve since the last of these."""
    paused_s: float = 0.0
    """Seconds of pauses so far."""
    cloud: Cloud | None = None
    """Of the population; None outside the search."""


@dataclasses.dataclass(frozen=True, eq=False)
class SearchKept:
    """The refinement can go on from here if it is cut short."""

    kept: KeptSearch


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """How well the photos agree under the newest cameras."""

    agreement: Agreement


@dataclasses.dataclass(frozen=True, eq=False)
class Refined:
    """The refinement ended; ``finished`` is None when the user stopped it."""

    cameras: tuple[Camera, ...]
    finished: Any
    """A ``photoreg.registration.refinement.Finished``, or None."""
    start_error_px: float | None
    error_px: float | None
    paused_s: float = 0.0
    """Seconds of pauses."""


@dataclasses.dataclass(frozen=True, eq=False)
class SurfaceDrawn:
    """The object with the photos, or their disagreement, on it."""

    glb: bytes


@dataclasses.dataclass(frozen=True, eq=False)
class Checked:
    """Whether a refinement from these cameras can work."""

    cameras: tuple[Camera, ...]
    readiness: Readiness


@dataclasses.dataclass(frozen=True, eq=False)
class Reached:
    """How far a search from the cameras on screen looks."""

    reach: BoxReach


@dataclasses.dataclass(frozen=True, eq=False)
class CamerasFound:
    """Where the cameras that were looked for may be."""

    found: tuple[FoundCamera, ...]


@dataclasses.dataclass(frozen=True)
class FindingStopped:
    """The search for cameras ended early, as asked."""


@dataclasses.dataclass(frozen=True)
class Timed:
    """How fast this machine is with the scene."""

    speed: Speed


@dataclasses.dataclass(frozen=True)
class Working:
    """A job goes on."""

    title: str
    fraction: float


@dataclasses.dataclass(frozen=True, eq=False)
class Baked:
    """The textured model, ready to be downloaded and shown."""

    texture: Texture


@dataclasses.dataclass(frozen=True)
class BakingStopped:
    """The making of the texture ended early, as asked."""


@dataclasses.dataclass(frozen=True, eq=False)
class Download:
    """A file for download."""

    name: str
    content: bytes


@dataclasses.dataclass(frozen=True, eq=False)
class Failed:
    """A job could not be done."""

    job: str
    """The name of its class, or ``SPARE_TIME``."""
    message: str
    """For the user: a sentence, or of what nobody foresaw the end of one, its cause."""
    details: str = ""
    """The traceback of what nobody foresaw; empty for errors raised on purpose."""


@dataclasses.dataclass(frozen=True)
class Died:
    """The worker process is gone; a new one is on its way."""

    exit_code: int | None


Job = (
    SetScene
    | SetMask
    | DrawOverlay
    | Refine
    | Compare
    | FindCameras
    | MeasureReach
    | Bake
    | Pack
    | OverlayView
    | Watch
    | Pause
    | Resume
    | Stop
)
Event = (
    Ready
    | Live
    | SearchKept
    | Picture
    | Measured
    | SurfaceDrawn
    | Refined
    | Compared
    | Checked
    | Reached
    | CamerasFound
    | FindingStopped
    | Timed
    | Working
    | Baked
    | BakingStopped
    | Download
    | Failed
    | Died
)
Loaded = MeshLoaded | PhotoLoaded | CamerasLoaded
ReadingEvent = Reading | Unpacked | Loaded | Failed | ReadAll
"""What the reader tells, which is a process beside the worker."""

Passing = Live | Picture | Measured | SurfaceDrawn
"""Events of which only the newest is worth telling."""


SMALL_PX = 768
"""Longer side of a photo as the object wears it while a run goes on."""
