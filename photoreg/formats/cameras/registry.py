"""Every camera format: its name, its place, what it keeps and loses, out and in."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.blender import save_blender
from photoreg.formats.cameras.bundler import load_bundler, save_bundler
from photoreg.formats.cameras.camera_set import CameraSet, Saved
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras, save_cameras
from photoreg.formats.cameras.colmap import (
    load_colmap_binary,
    load_colmap_text,
    model_folder,
    save_colmap_binary,
    save_colmap_text,
)
from photoreg.formats.cameras.meshlab import load_meshlab, save_meshlab
from photoreg.formats.cameras.nerfstudio import load_nerfstudio, save_nerfstudio
from photoreg.formats.cameras.opencv_yaml import load_opencv, save_opencv
from photoreg.formats.cameras.orientation import cameras_as_displayed, cameras_as_stored
from photoreg.formats.cameras.texrecon import load_texrecon, save_texrecon
from photoreg.formats.parsing import read_json
from photoreg.geometry.camera import Camera
from photoreg.names import presentable
from photoreg.words import nfc

FormatName = Literal[
    "photoreg",
    "colmap",
    "colmap-text",
    "nerfstudio",
    "meshlab",
    "texrecon",
    "opencv",
    "bundler",
    "blender",
]


@dataclasses.dataclass(frozen=True)
class CameraFormat:
    """A format of camera files."""

    name: FormatName
    """By which it is chosen."""
    label: str
    """What people call it."""
    place: str
    """What to give as a path: a suffix, a file name, or "folder"."""
    keeps: str
    """What it holds, in one sentence."""
    loses: str
    """What it cannot hold, in one sentence."""
    save: Callable[[Path, CameraSet, bool], Saved]
    """Writes cameras to a path, over files that are not photoreg's or not."""
    load: Callable[[Path, dict[str, Path]], Mapping[str, Camera]] | None
    """Reads cameras from a path, given photos by name, to which it adds those that it
    finds beside the file; None: it is written only."""
    is_beside_photos: bool = True
    """Whether its programs look for the photos where the cameras are."""
    is_of_stored_pixels: bool = True
    """Whether its programs pass over EXIF's orientation of photos."""

    @property
    def is_folder(self) -> bool:
        """Whether a path of this format is a folder."""
        return self.place == "folder"


def _save_photoreg(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    save_cameras(path, CameraFile(cameras.cameras), overwrite)
    return Saved([path])


_POSE = "It keeps poses, both focal lengths and the principal point."

CAMERA_FORMATS: dict[str, CameraFormat] = {
    camera_format.name: camera_format
    for camera_format in (
        CameraFormat(
            "photoreg",
            "photoreg (JSON)",
            ".json",
            "It keeps everything.",
            "It loses nothing.",
            _save_photoreg,
            lambda path, _: load_cameras(path).cameras,
            is_beside_photos=False,
            is_of_stored_pixels=False,
        ),
        CameraFormat(
            "colmap",
            "COLMAP (binary)",
            "folder",
            _POSE,
            "It loses skew.",
            save_colmap_binary,
            lambda path, _: load_colmap_binary(path),
        ),
        CameraFormat(
            "colmap-text",
            "COLMAP (text)",
            "folder",
            _POSE,
            "It loses skew, and photo names after their first space.",
            save_colmap_text,
            lambda path, _: load_colmap_text(path),
        ),
        CameraFormat(
            "nerfstudio",
            "nerfstudio (transforms.json)",
            "transforms.json",
            _POSE,
            "It loses skew.",
            save_nerfstudio,
            load_nerfstudio,
        ),
        CameraFormat(
            "meshlab",
            "MeshLab (.mlp)",
            ".mlp",
            "It keeps poses, both focal lengths and, by padded copies of the photos, "
            "the principal point to the pixel.",
            "It loses skew, and turns the camera by the rest of a pixel.",
            save_meshlab,
            load_meshlab,
        ),
        CameraFormat(
            "texrecon",
            "texrecon (.cam)",
            "folder",
            _POSE,
            "It loses skew; sizes and full names are the photos'.",
            save_texrecon,
            load_texrecon,
        ),
        CameraFormat(
            "opencv",
            "OpenCV (YAML)",
            ".yml",
            "It keeps everything.",
            "It loses nothing.",
            save_opencv,
            lambda path, _: load_opencv(path),
            is_beside_photos=False,
            is_of_stored_pixels=False,
        ),
        CameraFormat(
            "bundler",
            "Bundler (.out)",
            ".out",
            "It keeps the camera's place and one focal length.",
            "It loses skew, the second focal length and the principal point, for which "
            "cameras are turned; sizes are the photos'.",
            save_bundler,
            load_bundler,
        ),
        CameraFormat(
            "blender",
            "Blender (script)",
            ".py",
            _POSE,
            "It loses skew, and cannot be read back.",
            save_blender,
            None,
        ),
    )
}
_BY_SUFFIX: dict[str, FormatName] = {
    ".json": "photoreg",
    ".mlp": "meshlab",
    ".yml": "opencv",
    ".yaml": "opencv",
    ".out": "bundler",
    ".py": "blender",
    ".cam": "texrecon",
}


def camera_format(name: str) -> CameraFormat:
    """The format called ``name``.

    Raises:
        InputError: if there is none.
    """
    if name not in CAMERA_FORMATS:
        raise InputError(
            f"There is no camera format {name!r}; there are {', '.join(CAMERA_FORMATS)}."
        )
    return CAMERA_FORMATS[name]


def format_to_read(path: Path) -> CameraFormat:
    """The format of an existing file or folder, by its suffix and contents.

    Raises:
        InputError: if it does not exist or is none that photoreg reads.
    """
    if not path.exists():
        raise InputError(f"The cameras {path} do not exist. Check the path.")
    if path.is_dir():
        return CAMERA_FORMATS[_name_of_folder(path)]
    name = _BY_SUFFIX.get(path.suffix.lower())
    if name == "photoreg" and _is_nerfstudio(path):
        name = "nerfstudio"
    if path.suffix.lower() in (".txt", ".bin"):
        raise InputError(
            f"{path.name} is a part of a COLMAP model; give its folder {path.parent}."
        )
    if name is None or CAMERA_FORMATS[name].load is None:
        raise InputError(
            f"{path.name} is not a camera file that photoreg reads: the suffix should be "
            f"one of {', '.join(s for s in _BY_SUFFIX if s != '.py')}."
        )
    return CAMERA_FORMATS[name]


def _name_of_folder(folder: Path) -> FormatName:
    if model_folder(folder, ".bin"):
        return "colmap"
    if model_folder(folder, ".txt"):
        return "colmap-text"
    if any(folder.glob("*.cam")):
        return "texrecon"
    raise InputError(
        f"The folder {folder} holds no cameras: neither a COLMAP model (cameras and "
        "images, .bin or .txt) nor texrecon's .cam files."
    )


def _is_nerfstudio(path: Path) -> bool:
    try:
        document = read_json(path, "camera file")
    except (InputError, OSError):
        return False
    return isinstance(document, dict) and "frames" in document


def format_to_write(path: Path) -> CameraFormat:
    """The format for a path to be written, by its suffix.

    Raises:
        OutputError: if the suffix does not tell.
    """
    if path.name == "transforms.json":
        return CAMERA_FORMATS["nerfstudio"]
    if path.is_dir():
        try:
            return CAMERA_FORMATS[_name_of_folder(path)]
        except InputError:
            pass
    name = _BY_SUFFIX.get(path.suffix.lower())
    if name is None or path.is_dir() or CAMERA_FORMATS[name].is_folder:
        raise OutputError(
            f"The path {path} does not tell its format; name it, one of "
            f"{', '.join(CAMERA_FORMATS)}."
        )
    return CAMERA_FORMATS[name]


def read_cameras(
    path: Path | str,
    name: str | None = None,
    photos: Sequence[Path] | Mapping[str, Path] = (),
) -> CameraFile:
    """Reads cameras of any format.

    Args:
        path: A file, or a folder for COLMAP and texrecon.
        name: The format; None: by suffix and contents.
        photos: The photos, for formats that leave out sizes or names; or by name, where
            that is not the file's.

    Raises:
        InputError: if the cameras cannot be read; one sentence says why.
    """
    path = Path(path)
    chosen = format_to_read(path) if name is None else camera_format(name)
    if chosen.load is None:
        raise InputError(f"photoreg writes {chosen.name} files, but cannot read them.")
    if chosen.name == "photoreg":
        return load_cameras(path)  # With the keys that only this format has.
    if chosen.is_folder and path.suffix.lower() != ".cam" and not path.is_dir():
        raise InputError(f"{path} should be a folder, for the format {chosen.name}.")
    known = dict(photos) if isinstance(photos, Mapping) else photos_by_name(photos)
    cameras = chosen.load(path, known)
    if not chosen.is_of_stored_pixels:
        return CameraFile(cameras)
    cameras, notes = cameras_as_displayed(cameras, known, chosen.label)
    return CameraFile(cameras, notes=tuple(notes))


def write_cameras(
    path: Path | str,
    cameras: CameraSet,
    name: str | None = None,
    overwrite: bool = False,
) -> Saved:
    """Writes cameras in any format.

    Args:
        path: A file, or a folder for COLMAP and texrecon.
        cameras: The cameras, and the photos and the mesh as far as known.
        name: The format; None: by the path.
        overwrite: Whether files without photoreg's mark may be replaced.

    Returns:
        The files, and a sentence for each thing that these cameras lose.

    Raises:
        InputError: if the format needs a photo that is not there.
        OutputError: if the files cannot be written there, or others are there.
    """
    path = Path(path)
    chosen = format_to_write(path) if name is None else camera_format(name)
    cameras, losses = for_programs(chosen, cameras, cameras.photos)
    saved = chosen.save(path, cameras, overwrite)
    saved.losses.extend(losses)
    return saved


def for_programs(
    chosen: CameraFormat, cameras: CameraSet, photos: Mapping[str, Path]
) -> tuple[CameraSet, list[str]]:
    """The cameras as a format's programs want them of photos that EXIF turns.

    Returns:
        The cameras, and a sentence where there is none such.
    """
    # MeshLab's writer makes upright copies of such photos.
    if not chosen.is_of_stored_pixels or chosen.name == "meshlab":
        return cameras, []
    stored, losses = cameras_as_stored(cameras.cameras, photos)
    return dataclasses.replace(cameras, cameras=stored), losses


def photos_by_name(photos: Iterable[Path]) -> dict[str, Path]:
    """Photos by file name.

    Raises:
        InputError: if two have the same.
    """
    by_name: dict[str, Path] = {}
    for path in photos:
        name = presentable(nfc(path.name))
        if name in by_name:
            raise InputError(
                f"{name} was given twice. Photos are told apart by file name."
            )
        by_name[name] = path
    return by_name
