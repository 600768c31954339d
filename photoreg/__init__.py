"""photoreg lays photographs onto a scanned 3-D surface, precisely.

>>> mesh = load_mesh("shell.ply")
>>> photos = [load_photo("left.jpg"), load_photo("right.jpg")]
>>> rough = load_cameras("rough.json").of_photos(photos)
>>> for event in refine(mesh, photos, rough):
...     print(event)
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from photoreg.errors import PhotoregError as PhotoregError
    from photoreg.formats.cameras.cameras_json import CameraFile as CameraFile
    from photoreg.formats.cameras.cameras_json import load_cameras as load_cameras
    from photoreg.formats.cameras.cameras_json import save_cameras as save_cameras
    from photoreg.formats.meshes.read import load_mesh as load_mesh
    from photoreg.formats.photos.read import load_photo as load_photo
    from photoreg.geometry.camera import Camera as Camera
    from photoreg.geometry.mesh import Mesh as Mesh
    from photoreg.geometry.projection_error import projection_error as projection_error
    from photoreg.imaging.photo import Photo as Photo
    from photoreg.registration.config import RegistrationConfig as RegistrationConfig
    from photoreg.registration.events import Finished as Finished
    from photoreg.registration.events import Progress as Progress
    from photoreg.registration.refinement import refine as refine

__version__ = "0.2.0"

_MODULES = {
    "Camera": "photoreg.geometry.camera",
    "PhotoregError": "photoreg.errors",
    "projection_error": "photoreg.geometry.projection_error",
    "CameraFile": "photoreg.formats.cameras.cameras_json",
    "load_cameras": "photoreg.formats.cameras.cameras_json",
    "save_cameras": "photoreg.formats.cameras.cameras_json",
    "Mesh": "photoreg.geometry.mesh",
    "load_mesh": "photoreg.formats.meshes.read",
    "Photo": "photoreg.imaging.photo",
    "load_photo": "photoreg.formats.photos.read",
    "Finished": "photoreg.registration.events",
    "Progress": "photoreg.registration.events",
    "RegistrationConfig": "photoreg.registration.config",
    "refine": "photoreg.registration.refinement",
}
"""Where each name is: imported when asked for, so that a command is heard from at once."""


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
