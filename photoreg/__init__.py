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
    from photoreg.camera import Camera as Camera
    from photoreg.errors import PhotoregError as PhotoregError
    from photoreg.evaluate import projection_error as projection_error
    from photoreg.formats.cameras_json import CameraFile as CameraFile
    from photoreg.formats.cameras_json import load_cameras as load_cameras
    from photoreg.formats.cameras_json import save_cameras as save_cameras
    from photoreg.formats.meshes import load_mesh as load_mesh
    from photoreg.mesh import Mesh as Mesh
    from photoreg.photo import Photo as Photo
    from photoreg.photo import load_photo as load_photo
    from photoreg.registration import Finished as Finished
    from photoreg.registration import Progress as Progress
    from photoreg.registration import RegistrationConfig as RegistrationConfig
    from photoreg.registration import refine as refine

__version__ = "0.1.0"

_MODULES = {
    "Camera": "photoreg.camera",
    "PhotoregError": "photoreg.errors",
    "projection_error": "photoreg.evaluate",
    "CameraFile": "photoreg.formats.cameras_json",
    "load_cameras": "photoreg.formats.cameras_json",
    "save_cameras": "photoreg.formats.cameras_json",
    "Mesh": "photoreg.mesh",
    "load_mesh": "photoreg.formats.meshes",
    "Photo": "photoreg.photo",
    "load_photo": "photoreg.photo",
    "Finished": "photoreg.registration",
    "Progress": "photoreg.registration",
    "RegistrationConfig": "photoreg.registration",
    "refine": "photoreg.registration",
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
