"""A collection: a folder of folders, or a table with a row an object."""

import csv
import dataclasses
import io
import os
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from photoreg.batch.settings import ObjectSettings
from photoreg.checks import check_input_file
from photoreg.errors import InputError
from photoreg.formats.cameras.find import find_camera_file
from photoreg.formats.meshes.read import MESH_SUFFIXES
from photoreg.formats.photos.registry import PHOTO_SUFFIXES
from photoreg.geometry.lens import Distortion
from photoreg.limits import Limits
from photoreg.names import presentable
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.sources import read_regular
from photoreg.words import listed, nfc

ROUGH_CAMERAS = "rough.json"
"""Cameras of this name are the start, as in the folders that `photoreg synthesize` makes."""

MAX_NAME_BYTES = 200

FileState = tuple[int, int]
"""Size in bytes, and when it was written last, in nanoseconds."""


@dataclasses.dataclass(frozen=True)
class Inputs:
    """The files of an object."""

    mesh: Path
    photos: tuple[Path, ...]
    cameras: Path
    """A file, or a folder of COLMAP, texrecon or RealityScan."""
    has_textures: bool = False
    """Whether the mesh's own texture may be among the photos."""


@dataclasses.dataclass(frozen=True)
class CollectionObject:
    """One object of a collection."""

    name: str
    """Of its folder among the results; unique."""
    base: Path
    """The folder that its files' paths are relative to."""
    settings: ObjectSettings
    given: Inputs | None = None
    """As a row has them; None: to be found in ``base``."""
    problem: str = ""
    """Why it cannot be used, in a sentence; empty where nothing speaks against it yet."""

    def inputs(self) -> Inputs:
        """Its files.

        Raises:
            InputError: if one is missing, or it is not clear which are meant.
        """
        if self.problem:
            raise InputError(self.problem)
        if self.given is None:
            return find_inputs(self.base)
        for path in (self.given.mesh, *self.given.photos, self.given.cameras):
            if not path.exists():
                raise InputError(f"{path} does not exist. Check the path.")
        return self.given

    def files(self) -> dict[str, FileState]:
        """All files that it may consist of, by path from ``base``, as they are now."""
        if self.given is None:
            start = (
                len(str(self.base)) + 1
            )  # Ten thousand times, paths as such are slow.
            return {path[start:]: state for path, state in _files_below(self.base)}
        found = {}
        for path in (self.given.mesh, *self.given.photos, self.given.cameras):
            if path.is_dir():
                inside = _files_below(path)
                found |= {self.told(Path(file)): state for file, state in inside}
            elif (state := state_of(path)) is not None:
                found[self.told(path)] = state
        return found

    def told(self, path: Path) -> str:
        """A path as it is kept: relative to ``base`` if it lies in there."""
        return told_from(self.base, path)


def told_from(base: Path, path: Path) -> str:
    """A path relative to a folder if it lies in there, else as it is."""
    path = Path(os.path.normpath(path.absolute()))
    return str(path.relative_to(base) if path.is_relative_to(base) else path)


def state_of(path: Path) -> FileState | None:
    """Size and time of a regular file; None if there is none."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    if not stat.S_ISREG(found.st_mode):
        return None
    return found.st_size, found.st_mtime_ns


def _files_below(folder: Path) -> Iterator[tuple[str, FileState]]:
    """Regular files in a folder and those in it, but for hidden ones."""
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith("."):
            continue
        if entry.is_dir(follow_symlinks=False):
            yield from _files_below(Path(entry.path))
            continue
        try:
            found = entry.stat()
        except OSError:
            continue
        if stat.S_ISREG(found.st_mode):
            yield entry.path, (found.st_size, found.st_mtime_ns)


def find_inputs(folder: Path) -> Inputs:
    """Mesh, photos and rough cameras somewhere in a folder, told by their suffixes.

    Raises:
        InputError: if there is no mesh, photo or set of cameras, or more than one mesh or
            set of cameras; it names them.
    """
    files = [Path(path) for path, _ in _files_below(folder)]

    def named(paths: Iterable[Path]) -> str:
        return listed([path.relative_to(folder).as_posix() for path in paths])

    meshes = [path for path in files if path.suffix.lower() in MESH_SUFFIXES]
    if not meshes:
        raise InputError(
            f"There is no mesh in {folder.name}: its suffix should be one of "
            f"{', '.join(MESH_SUFFIXES)}."
        )
    if len(meshes) > 1:
        raise InputError(
            f"There are {len(meshes)} meshes in {folder.name}: {named(meshes)}. Leave "
            "one, or name it in a table."
        )
    photos = [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES]
    if not photos:
        raise InputError(
            f"There are no photos in {folder.name}: their suffix should be one of "
            f"{', '.join(PHOTO_SUFFIXES)}."
        )
    rough = [path for path in files if path.name == ROUGH_CAMERAS]
    if len(rough) > 1:
        raise InputError(f"There are {len(rough)} rough cameras: {named(rough)}.")
    cameras = rough[0] if rough else find_camera_file(folder)
    return Inputs(meshes[0], tuple(photos), cameras, has_textures=True)


def read_collection(path: Path, settings: ObjectSettings) -> list[CollectionObject]:
    """The objects of a folder of folders, or of a table (CSV), in order.

    Args:
        path: The folder or the table.
        settings: What is asked where a row does not say otherwise.

    Raises:
        InputError: if it is neither, has no objects, or says what is not understood.
    """
    path = path.absolute()
    if path.is_dir():
        found = _read_folder(path, settings)
    elif path.suffix.lower() == ".csv":
        found = _read_table(path, settings)
    elif path.exists():
        raise InputError(
            f"{path} should be a folder with one folder per object, or a table (.csv)."
        )
    else:
        raise InputError(f"The collection {path} does not exist. Check the path.")
    if not found:
        raise InputError(f"There are no objects in {path}: it has no folders or rows.")
    return found


def _read_folder(folder: Path, settings: ObjectSettings) -> list[CollectionObject]:
    entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    entries = [entry for entry in entries if not entry.name.startswith(".")]
    folders = [Path(entry.path) for entry in entries if entry.is_dir()]
    if not folders and any(
        Path(e.name).suffix.lower() in MESH_SUFFIXES for e in entries
    ):
        raise InputError(
            f"{folder} holds a mesh and no folders. Give the folder that the objects' "
            "folders are in."
        )
    seen: dict[str, str] = {}
    found = []
    for each in folders:
        problem = _why_no_name(each.name, seen)
        name = presentable(nfc(each.name))
        found.append(CollectionObject(name, each, settings, None, problem))
    return found


def _why_no_name(name: str, seen: dict[str, str]) -> str:
    """Why this cannot be the name of a result's folder; empty if it can."""
    if not name or name.startswith(".") or {"/", "\\", "\0"} & set(name):
        return (
            f"{name!r} cannot be an object's name: it is the name of a folder, which "
            "begins with no dot and has no slash."
        )
    if presentable(name) != name or len(name.encode()) > MAX_NAME_BYTES:
        return (
            f"{presentable(name):.60} cannot be an object's name: it should be of "
            f"characters that can be shown, at most {MAX_NAME_BYTES} bytes."
        )
    key = nfc(name).casefold()
    if key in OWN_NAMES:
        return f"{name} cannot be an object's name: photoreg has a file of that name."
    if key in seen:
        return (
            f"{name} and {seen[key]} are the same name where capital and small letters are "
            "the same. Rename one."
        )
    seen[key] = name
    return ""


OWN_NAMES = frozenset(["summary.csv", "index.html", "project.lock"])
"""What lies among the results' folders."""


# Tables.

_NEEDED = ("object", "mesh", "photos", "cameras")
_NAMES = (
    "lock",
    "lock_focal",
    "lock_principal_point",
    "lock_pose",
    "lock_distortion",
    "cropped",
)
_SETTINGS = ("preset", "seed", "distortion", *_NAMES, "share_focal")
COLUMNS = (*_NEEDED, *_SETTINGS)
"""What a table may have, in any order; the first four it must have."""


def _read_table(path: Path, settings: ObjectSettings) -> list[CollectionObject]:
    check_input_file(path, "table", Limits.of_environment().camera_file_mb)
    try:
        text = read_regular(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path.name} should be text in UTF-8, but is not from byte {error.start} "
            "on. Save it as CSV UTF-8."
        ) from error
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = [column.strip().lower() for column in next(reader, [])]
        _check_header(header, path.name)
        found, seen = [], {}
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            where = f"{path.name}, line {reader.line_num}"
            if len(cells) != len(header):
                raise InputError(
                    f"{where}: there are {len(cells)} cells for {len(header)} columns."
                )
            row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
            found.append(_object_of(row, path.parent, where, settings, seen))
    except csv.Error as error:
        raise InputError(
            f"{path.name}, line {reader.line_num}: this is not CSV ({error})."
        ) from error
    return found


def _check_header(header: Sequence[str], name: str) -> None:
    unknown = [column for column in header if column not in COLUMNS]
    if unknown or len(set(header)) != len(header):
        twice = [column for column in header if header.count(column) > 1]
        wrong = listed([repr(column) for column in unknown or twice[:1]])
        raise InputError(
            f"{name}, line 1: there should be columns of {', '.join(COLUMNS)}, each "
            f"once and separated by commas, but there is {wrong}"
            f"{'' if unknown else ' twice'}."
        )
    missing = [column for column in _NEEDED if column not in header]
    if missing:
        raise InputError(f"{name}, line 1: there is no column {listed(missing)}.")


def _object_of(
    row: Mapping[str, str],
    folder: Path,
    where: str,
    settings: ObjectSettings,
    seen: dict[str, str],
) -> CollectionObject:
    if problem := _why_no_name(row["object"], seen):
        raise InputError(f"{where}: {problem}")
    for column in _NEEDED:
        if not row[column]:
            raise InputError(f"{where}: there is nothing in the column {column}.")
    photos: list[Path] = []
    problem = ""
    for name in _parts(row["photos"], ";"):
        path = folder / name
        if path.is_dir():
            inside = sorted(
                each for each in path.iterdir() if each.suffix.lower() in PHOTO_SUFFIXES
            )
            if not inside:
                problem = f"{where}: there are no photos in {path}."
            photos += inside
        else:
            photos.append(path)
    given = Inputs(folder / row["mesh"], tuple(photos), folder / row["cameras"])
    own = _settings_of(row, where, settings)
    return CollectionObject(nfc(row["object"]), folder, own, given, problem)


def _settings_of(
    row: Mapping[str, str], where: str, settings: ObjectSettings
) -> ObjectSettings:
    config = settings.config
    if preset := row.get("preset"):
        name = _choice(preset, get_args(PresetName), f"{where}, column preset")
        config = RegistrationConfig.preset(name, config.seed)
    changes: dict[str, Any] = {}
    if seed := row.get("seed"):
        if not seed.isdecimal():
            raise InputError(f"{where}, column seed: {seed!r} is not a whole number.")
        changes["seed"] = int(seed)
    if distortion := row.get("distortion"):
        changes["distortion"] = _choice(
            distortion, get_args(Distortion), f"{where}, column distortion"
        )
    try:
        config = dataclasses.replace(config, **changes)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    own: dict[str, Any] = {
        column: _parts(row[column], ";") for column in _NAMES if row.get(column)
    }
    if shared := row.get("share_focal"):
        groups = (() if g == "all" else _parts(g, ";") for g in _parts(shared, "|"))
        own["share_focal"] = tuple(groups)
    return dataclasses.replace(settings, config=config, **own)


def _choice(text: str, choices: Sequence[str], where: str) -> Any:
    if text not in choices:
        raise InputError(f"{where}: {text!r} is not one of {', '.join(choices)}.")
    return text


def _parts(text: str, mark: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(mark) if part.strip())
