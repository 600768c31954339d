"""What is asked for an object: how it is refined, and what comes of it."""

import dataclasses
import functools
import hashlib
import json
from typing import Literal

from photoreg.formats.models.encode_texture import PictureKind
from photoreg.registration.config import RegistrationConfig
from photoreg.texture.config import TextureConfig

ModelKind = Literal["glb", "obj", "ply", "none"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ObjectSettings:
    """All that decides, beside the files, what comes of an object."""

    config: RegistrationConfig = dataclasses.field(default_factory=RegistrationConfig)
    lock: tuple[str, ...] = ()
    """Photos, by file name, whose cameras stay as they are; so on as `photoreg refine`."""
    lock_focal: tuple[str, ...] = ()
    lock_principal_point: tuple[str, ...] = ()
    lock_pose: tuple[str, ...] = ()
    lock_distortion: tuple[str, ...] = ()
    share_focal: tuple[tuple[str, ...], ...] = ()
    """Groups of photos with one focal length; an empty group: all photos."""
    cropped: tuple[str, ...] = ()
    model: ModelKind = "glb"
    picture: PictureKind = "png"
    texture: TextureConfig = TextureConfig()
    report: bool = True


@functools.cache
def fingerprint(settings: ObjectSettings) -> str:
    """The same for the same settings, whatever the process: a SHA-256."""
    text = json.dumps(dataclasses.asdict(settings), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
