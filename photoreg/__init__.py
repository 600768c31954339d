"""photoreg lays photographs onto a scanned 3-D surface, precisely.

>>> mesh = load_mesh("shell.ply")
>>> photos = [load_photo("left.jpg"), load_photo("right.jpg")]
>>> rough = load_cameras("rough.json").of_photos(photos)
>>> for event in refine(mesh, photos, rough):
...     print(event)
"""

from photoreg.camera import Camera as Camera
from photoreg.errors import PhotoregError as PhotoregError
from photoreg.evaluate import projection_error as projection_error
from photoreg.formats.cameras_json import CameraFile as CameraFile
from photoreg.formats.cameras_json import load_cameras as load_cameras
from photoreg.formats.cameras_json import save_cameras as save_cameras
from photoreg.mesh import Mesh as Mesh
from photoreg.mesh import load_mesh as load_mesh
from photoreg.photo import Photo as Photo
from photoreg.photo import load_photo as load_photo
from photoreg.registration import Finished as Finished
from photoreg.registration import Progress as Progress
from photoreg.registration import RegistrationConfig as RegistrationConfig
from photoreg.registration import refine as refine

__version__ = "0.1.0"
