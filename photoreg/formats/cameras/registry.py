"""Every camera format: its name, its place, what it keeps and loses, out and in."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.alicevision import load_alicevision, save_alicevision
from photoreg.formats.cameras.alicevision import notes_of as alicevision_notes
from photoreg.formats.cameras.blender import save_blender
from photoreg.formats.cameras.bundler import load_bundler, save_bundler
from photoreg.formats.cameras.camera_set import CameraSet, FormatName, Saved
from photoreg.formats.cameras.cameras_json import (
    FORMAT,
    CameraFile,
    WorldMove,
    load_cameras,
    save_cameras,
)
from photoreg.formats.cameras.colmap import (
    load_colmap_binary,
    load_colmap_text,
    model_folder,
    save_colmap_binary,
    save_colmap_text,
)
from photoreg.formats.cameras.meshlab import load_meshlab, save_meshlab
from photoreg.formats.cameras.metashape import load_metashape
from photoreg.formats.cameras.metashape import notes_of as metashape_notes
from photoreg.formats.cameras.nerfstudio import (
    load_nerfstudio,
    notes_of,
    save_nerfstudio,
    world_move,
)
from photoreg.formats.cameras.opencv_yaml import load_opencv, save_opencv
from photoreg.formats.cameras.orientation import cameras_as_displayed, cameras_as_stored
from photoreg.formats.cameras.realityscan import (
    is_realityscan,
    load_realityscan,
    save_realityscan,
)
from photoreg.formats.cameras.realityscan import notes_of as realityscan_notes
from photoreg.formats.cameras.texrecon import load_texrecon, save_texrecon
from photoreg.formats.parsing import read_json
from photoreg.geometry.camera import Camera
from photoreg.names import presentable
from photoreg.words import nfc


@dataclasses.dataclass(frozen=True, kw_only=True)
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
    """What it cannot hold, in one sentence; empty where it holds all."""
    save: Callable[[Path, CameraSet, bool], Saved] | None
    """Writes cameras to a path, over files that are not photoreg's or not; None: it is
    read only."""
    load: Callable[[Path, dict[str, Path]], Mapping[str, Camera]] | None
    """Reads cameras from a path, given photos by name, to which it adds those that it
    finds beside the file; None: it is written only."""
    suffixes: tuple[str, ...] = ()
    """Of its files, in small letters; of a folder, those of the files in it."""
    is_one_file_a_photo: bool = False
    """Whether each file of its folder is a camera by itself."""
    is_beside_photos: bool = True
    """Whether its programs look for the photos where the cameras are."""
    is_of_stored_pixels: bool = True
    """Whether its programs pass over EXIF's orientation of photos."""
    notes_of: Callable[[Path], list[str]] = lambda _: []
    """A sentence for each thing in a file that is ignored."""
    move_of: Callable[[Path], WorldMove | None] = lambda _: None
    """How the cameras of a file were moved from the world where they were found."""

    @property
    def in_words(self) -> str:
        """What it keeps and loses."""
        return f"{self.keeps} {self.loses}".rstrip()

    @property
    def is_folder(self) -> bool:
        """Whether a path of this format is a folder."""
        return self.place == "folder"


def _save_photoreg(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    save_cameras(path, CameraFile(cameras.cameras), overwrite)
    return Saved([path])


_POSE = "It keeps poses, both focal lengths and the principal point."
_LENS = "It keeps poses, both focal lengths, the principal point and the lens."


CAMERA_FORMATS: dict[str, CameraFormat] = {
    camera_format.name: camera_format
    for camera_format in (
        CameraFormat(
            name="photoreg",
            label="photoreg (JSON)",
            place=".json",
            keeps="Keeps everything.",
            loses="",
            save=_save_photoreg,
            load=lambda path, _: load_cameras(path).cameras,
            is_beside_photos=False,
            is_of_stored_pixels=False,
            suffixes=(".json",),
        ),
        CameraFormat(
            name="colmap",
            label="COLMAP (binary)",
            place="folder",
            keeps=_LENS,
            loses="It loses skew.",
            save=save_colmap_binary,
            load=lambda path, _: load_colmap_binary(path),
            suffixes=(".bin",),
        ),
        CameraFormat(
            name="colmap-text",
            label="COLMAP (text)",
            place="folder",
            keeps=_LENS,
            loses="It loses skew, and photo names after their first space.",
            save=save_colmap_text,
            load=lambda path, _: load_colmap_text(path),
            suffixes=(".txt",),
        ),
        CameraFormat(
            name="nerfstudio",
            label="nerfstudio (transforms.json)",
            place="transforms.json",
            keeps=_LENS,
            loses="It loses skew.",
            save=save_nerfstudio,
            load=load_nerfstudio,
            notes_of=notes_of,
            move_of=world_move,
            suffixes=(".json",),
        ),
        CameraFormat(
            name="meshlab",
            label="MeshLab (.mlp)",
            place=".mlp",
            keeps="It keeps poses, both focal lengths and, by padded copies of the photos, "
            "the principal point to the pixel.",
            loses="It loses skew and the lens, and turns the camera to make up for the rest of a pixel.",
            save=save_meshlab,
            load=load_meshlab,
            suffixes=(".mlp",),
        ),
        CameraFormat(
            name="texrecon",
            label="texrecon (.cam)",
            place="folder",
            keeps=_POSE,
            loses="It loses skew and the lens; sizes and full names come from the photos.",
            save=save_texrecon,
            load=load_texrecon,
            suffixes=(".cam",),
            is_one_file_a_photo=True,
        ),
        CameraFormat(
            name="opencv",
            label="OpenCV (YAML)",
            place=".yml",
            keeps="Keeps everything.",
            loses="",
            save=save_opencv,
            load=lambda path, _: load_opencv(path),
            is_beside_photos=False,
            is_of_stored_pixels=False,
            suffixes=(".yml", ".yaml"),
        ),
        CameraFormat(
            name="bundler",
            label="Bundler (.out)",
            place=".out",
            keeps="It keeps the camera's place, one focal length and k1 and k2 of the lens.",
            loses="It loses skew, the second focal length, the lens's other terms and the "
            "principal point, for which cameras are turned; sizes come from the photos.",
            save=save_bundler,
            load=load_bundler,
            suffixes=(".out",),
        ),
        CameraFormat(
            name="blender",
            label="Blender (script)",
            place=".py",
            keeps=_POSE,
            loses="It loses skew and the lens, and cannot be read back.",
            save=save_blender,
            load=None,
            suffixes=(".py",),
        ),
        CameraFormat(
            name="metashape",
            label="Metashape (XML)",
            place=".xml",
            keeps="Keeps everything.",
            loses="It is read only.",
            save=None,
            load=load_metashape,
            notes_of=metashape_notes,
            suffixes=(".xml",),
        ),
        CameraFormat(
            name="realityscan",
            label="RealityScan (.xmp)",
            place="folder",
            keeps=_LENS,
            loses="It loses skew; sizes and full names come from the photos.",
            save=save_realityscan,
            load=load_realityscan,
            notes_of=realityscan_notes,
            suffixes=(".xmp",),
            is_one_file_a_photo=True,
        ),
        CameraFormat(
            name="alicevision",
            label="AliceVision, Meshroom (.sfm)",
            place=".sfm",
            keeps=_LENS,
            loses="It loses skew.",
            save=save_alicevision,
            load=load_alicevision,
            notes_of=alicevision_notes,
            suffixes=(".sfm", ".json"),
        ),
    )
}
WRITTEN_FORMATS = {
    name: known for name, known in CAMERA_FORMATS.items() if known.save is not None
}
"""Those of the formats that can be written."""
_COLMAP_SUFFIXES = (".txt", ".bin")
_READ = [known for known in CAMERA_FORMATS.values() if known.load is not None]
CAMERA_SUFFIXES = tuple(
    dict.fromkeys(
        suffix
        for known in sorted(_READ, key=lambda known: known.is_folder)
        for suffix in known.suffixes
    )
)
"""Suffixes of all files that a set of cameras may consist of, those of single files first."""
SINGLE_FILE_SUFFIXES = tuple(
    suffix
    for suffix in CAMERA_SUFFIXES
    if any(suffix in known.suffixes for known in _READ if not known.is_folder)
)
"""Suffixes of the files that hold a whole set of cameras."""


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
        InputError: if it does not exist or is not a format that photoreg reads.
    """
    if not path.exists():
        raise InputError(f"The cameras {path} do not exist. Check the path.")
    if path.is_dir():
        return CAMERA_FORMATS[_name_of_folder(path)]
    suffix = path.suffix.lower()
    if suffix in _COLMAP_SUFFIXES:
        raise InputError(
            f"{path.name} is a part of a COLMAP model; give its folder {path.parent}."
        )
    known = [each for each in _READ if suffix in each.suffixes]
    if not known:
        raise InputError(
            f"{path.name} is not a camera file that photoreg reads: the suffix should be "
            f"one of {', '.join(s for s in CAMERA_SUFFIXES if s not in _COLMAP_SUFFIXES)}."
        )
    if suffix == ".json":
        return CAMERA_FORMATS[format_of_json(path) or "photoreg"]
    return known[0]


def _name_of_folder(folder: Path) -> FormatName:
    if model_folder(folder, ".bin"):
        return "colmap"
    if model_folder(folder, ".txt"):
        return "colmap-text"
    if any(folder.glob("*.cam")):
        return "texrecon"
    if any(map(is_realityscan, folder.glob("*.xmp"))):
        return "realityscan"
    raise InputError(
        f"The folder {folder} holds no cameras: neither a COLMAP model (cameras and "
        "images, .bin or .txt) nor texrecon's .cam or RealityScan's .xmp files."
    )


def format_of_json(path: Path) -> FormatName | None:
    """Whose cameras a JSON file holds; None if it is not JSON, or holds none."""
    try:
        document = read_json(path, "camera file")
    except (InputError, OSError):
        return None
    if not isinstance(document, dict):
        return None
    if document.get("format") == FORMAT:
        return "photoreg"
    if "frames" in document:
        return "nerfstudio"
    return "alicevision" if {"views", "poses"} <= set(document) else None


def format_to_write(path: Path) -> CameraFormat:
    """The format for a path to be written, by its suffix.

    Raises:
        OutputError: if the suffix does not decide it.
    """
    if path.name == "transforms.json":
        return CAMERA_FORMATS["nerfstudio"]
    if path.is_dir():
        try:
            return CAMERA_FORMATS[_name_of_folder(path)]
        except InputError:
            pass
    known = [
        each
        for each in WRITTEN_FORMATS.values()
        if path.suffix.lower() in each.suffixes and not each.is_folder
    ]
    if not known or path.is_dir():
        raise OutputError(
            f"The path {path} does not show its format; name it, one of "
            f"{', '.join(WRITTEN_FORMATS)}."
        )
    return known[0]


def read_cameras(
    path: Path | str,
    name: str | None = None,
    photos: Sequence[Path] | Mapping[str, Path] = (),
) -> CameraFile:
    """Reads cameras of any format.

    Args:
        path: A file, or a folder for COLMAP, texrecon and RealityScan.
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
    if chosen.is_folder and not (chosen.is_one_file_a_photo or path.is_dir()):
        raise InputError(f"{path} should be a folder, for the format {chosen.name}.")
    known = dict(photos) if isinstance(photos, Mapping) else photos_by_name(photos)
    cameras = chosen.load(path, known)
    if not chosen.is_of_stored_pixels:
        return CameraFile(cameras)
    cameras, notes = cameras_as_displayed(cameras, known, chosen.label)
    return CameraFile(
        cameras,
        notes=(*chosen.notes_of(path), *notes),
        moved=chosen.move_of(path),
    )


def write_cameras(
    path: Path | str,
    cameras: CameraSet,
    name: str | None = None,
    overwrite: bool = False,
) -> Saved:
    """Writes cameras in any format.

    Args:
        path: A file, or a folder for COLMAP, texrecon and RealityScan.
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
    if chosen.save is None:
        raise InputError(f"photoreg reads {chosen.name} files, but cannot write them.")
    cameras, losses = for_programs(chosen, cameras, cameras.photos)
    saved = chosen.save(path, cameras, overwrite)
    saved.losses.extend(losses)
    return saved


def for_programs(
    chosen: CameraFormat, cameras: CameraSet, photos: Mapping[str, Path]
) -> tuple[CameraSet, list[str]]:
    """The cameras as a format's programs want them of photos that EXIF turns.

    Returns:
        The cameras, and a sentence about photos for which there is no such camera.
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
