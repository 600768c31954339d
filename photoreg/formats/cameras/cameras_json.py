"""photoreg's own file of cameras.

{"format": "photoreg-cameras", "version": 1, "cameras": [{"photo": "a.jpg",
"width": W, "height": H, "K": [[fx, s, cx], [0, fy, cy], [0, 0, 1]], "R": [...],
"t": [...]}]}: OpenCV axes, x_cam = R X + t, pixel (0, 0) is the centre of the first
pixel, sizes as displayed. Unknown keys survive a round trip. Where a lens is not ideal
the version is 2, which a photoreg that knows no lenses refuses, and the camera has
"distortion": {"k1": ..., "k2": ..., "p1": ..., "p2": ..., "k3": ...}, OpenCV's terms.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import photo_name
from photoreg.formats.cameras.lens_terms import refuse_lens_terms
from photoreg.formats.parsing import read_json
from photoreg.formats.writing import check_suffix, write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL, TERMS, Lens
from photoreg.imaging.photo import Photo

FORMAT = "photoreg-cameras"
VERSION = 2
"""The newest version, of files with a lens; without one they are of version 1."""
KEY_OF_LENS = "distortion"
_KEYS = ("photo", "width", "height", "K", "R", "t")


@dataclasses.dataclass(frozen=True, eq=False)
class WorldMove:
    """How a program moved cameras from the world where it found them: turned, then enlarged."""

    turn: Float[np.ndarray, "3 3"]
    """Rotation from the world before."""
    shift: Float[np.ndarray, "3"]
    """What is added after it, in units of the world before."""
    scale: float
    """Of the new world's units."""
    note: str
    """The sentence about it among the file's notes."""

    def undone(self, camera: Camera) -> Camera:
        """A camera as it was before."""
        R = camera.R_cam_world
        return dataclasses.replace(
            camera,
            R_cam_world=R @ self.turn,
            t_cam_world=camera.t_cam_world / self.scale + R @ self.shift,
        )


@dataclasses.dataclass(frozen=True)
class CameraFile:
    """Cameras by photo name, in the file's order, and what else the file held."""

    cameras: Mapping[str, Camera]
    """Photo file name to camera."""
    extra: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Unknown keys of the file, kept."""
    camera_extra: Mapping[str, Mapping[str, Any]] = dataclasses.field(
        default_factory=dict
    )
    """Unknown keys of each camera, by photo name, kept."""
    notes: tuple[str, ...] = ()
    """A sentence for each thing that reading them had to assume."""
    moved: "WorldMove | None" = None
    """What happened to the cameras before they were written, where a file says so."""

    def of_photo(self, name: str) -> Camera | None:
        """The camera of a photo, by file name; without regard to case if need be."""
        if name in self.cameras:
            return self.cameras[name]
        alike = [n for n in self.cameras if n.casefold() == name.casefold()]
        return self.cameras[alike[0]] if len(alike) == 1 else None

    def of_photos(self, photos: Sequence[Photo]) -> list[Camera]:
        """The camera of each photo, matched by file name, in the photos' order.

        Raises:
            InputError: if a photo has no camera here, or the sizes differ.
        """
        found = []
        for photo in photos:
            camera = self.of_photo(photo.name)
            if camera is None:
                raise InputError(
                    f"The camera file has no camera for {photo.name}; it has "
                    f"{', '.join(self.cameras) or 'none at all'}. "
                    "Photos are matched by file name."
                )
            if (camera.width, camera.height) != (photo.width, photo.height):
                raise InputError(
                    f"{photo.name} is {photo.width}x{photo.height} px, but its camera "
                    f"is for {camera.width}x{camera.height} px."
                )
            found.append(camera)
        return found

    def with_cameras(self, cameras: Mapping[str, Camera]) -> "CameraFile":
        """The same file with these cameras replaced or added."""
        return dataclasses.replace(self, cameras={**self.cameras, **cameras})


def load_cameras(path: Path | str) -> CameraFile:
    """Reads a photoreg camera file.

    Raises:
        InputError: if the file is missing, is not JSON, is of another format or a
            newer version, or a camera in it is not valid; the message names it.
    """
    path = Path(path)
    document = read_json(path, "camera file")
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(
            f'{path.name} is not a photoreg camera file: it should hold "format": '
            f'"{FORMAT}".'
        )
    version = document.get("version")
    if version not in (1, VERSION):
        raise InputError(
            f"{path.name} is version {version} of the camera file; this photoreg reads "
            f"versions 1 and {VERSION}. Update photoreg."
        )
    entries = document.get("cameras")
    if not isinstance(entries, list):
        raise InputError(f'{path.name} should hold a list "cameras".')
    cameras: dict[str, Camera] = {}
    camera_extra: dict[str, dict[str, Any]] = {}
    for number, entry in enumerate(entries, start=1):
        where = f"{path.name}, camera {number}"
        name, camera = _parse_camera(entry, where, version)
        everywhere = {k: v for k, v in document.items() if k != "cameras"}
        own = {k: v for k, v in entry.items() if k != KEY_OF_LENS or version == 1}
        refuse_lens_terms({**everywhere, **own}, where)
        if name in cameras:
            raise InputError(f"{path.name} has two cameras for {name}.")
        cameras[name] = camera
        camera_extra[name] = {
            k: v for k, v in entry.items() if k not in (*_KEYS, KEY_OF_LENS)
        }
    extra = {
        k: v for k, v in document.items() if k not in ("format", "version", "cameras")
    }
    return CameraFile(cameras, extra, camera_extra)


def _parse_camera(entry: object, where: str, version: int) -> tuple[str, Camera]:
    if not isinstance(entry, dict):
        raise InputError(f"{where} should be an object with {', '.join(_KEYS)}.")
    missing = [key for key in _KEYS if key not in entry]
    if missing:
        raise InputError(f"{where} lacks {', '.join(missing)}.")
    name, size = entry["photo"], (entry["width"], entry["height"])
    if not isinstance(name, str) or not photo_name(name) or not name.isprintable():
        raise InputError(
            f'{where}: "photo" should be a file name, but is {name!r:.80}.'
        )
    if not all(type(side) is int and 0 < side < 1_000_000 for side in size):
        raise InputError(
            f"{where} ({name}): width and height should be positive whole numbers, but "
            f"are {size[0]!r} and {size[1]!r}."
        )
    name = photo_name(name)
    try:
        lens = IDEAL if version == 1 else _parse_lens(entry.get(KEY_OF_LENS, {}))
        return name, Camera(entry["K"], entry["R"], entry["t"], *size, lens)
    except InputError as error:
        raise InputError(f"{where} ({name}): {error}") from error


def _parse_lens(terms: object) -> Lens:
    if not isinstance(terms, dict) or not set(terms) <= set(TERMS):
        raise InputError(
            f'"{KEY_OF_LENS}" should be an object with {", ".join(TERMS)}, but is {terms!r:.80}.'
        )
    for term, value in terms.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(
                f"The lens term {term} should be a number, but is {value!r:.40}."
            )
    return Lens(**terms)


def dump_cameras(file: CameraFile) -> str:
    """The file's text. Numbers are written with all digits (round trip exact)."""
    entries = [
        {
            "photo": name,
            "width": camera.width,
            "height": camera.height,
            "K": camera.K.tolist(),
            "R": camera.R_cam_world.tolist(),
            "t": camera.t_cam_world.tolist(),
            **_lens_entry(camera.lens),
            **file.camera_extra.get(name, {}),
        }
        for name, camera in file.cameras.items()
    ]
    document = {
        "format": FORMAT,
        "version": 1
        if all(c.lens.is_ideal for c in file.cameras.values())
        else VERSION,
        **file.extra,
        "cameras": entries,
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _lens_entry(lens: Lens) -> dict[str, dict[str, float]]:
    return (
        {}
        if lens.is_ideal
        else {KEY_OF_LENS: dict(zip(TERMS, lens.terms, strict=True))}
    )


def save_cameras(path: Path | str, file: CameraFile, overwrite: bool = False) -> None:
    """Writes a photoreg camera file, whole or not at all.

    Args:
        path: Where it goes (.json).
        file: The cameras.
        overwrite: Whether a file that is no photoreg camera file may be replaced.

    Raises:
        OutputError: if it cannot be written there, or another file is there.
    """
    path = check_suffix(path, (".json",))
    write_files({path: dump_cameras(file)}, overwrite=overwrite)
