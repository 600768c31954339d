"""What a person made of an object in its project."""

from collections.abc import Mapping
from pathlib import Path

from photoreg.batch.record import ObjectRecord, load_record
from photoreg.batch.run import CAMERAS
from photoreg.errors import InputError, PhotoregError
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras, save_cameras
from photoreg.formats.cameras.registry import photos_by_name, read_cameras
from photoreg.geometry.camera import Camera, same_camera
from photoreg.project.folder import holds_project
from photoreg.project.result import ProjectResult, read_result

PROJECT = "project"
"""The folder of the project, in the object's own."""
MENDED = "mended.json"
"""The cameras that came of it."""


def project_folder(folder: Path) -> Path:
    """Where the project of an object is, in the object's folder."""
    return folder / PROJECT


def mended_result(folder: Path, record: ObjectRecord | None) -> ProjectResult | None:
    """What a person mended in an object's project; None where nothing was.

    A camera that differs by rounding alone was looked at, not mended.

    Args:
        folder: The object's, among the results.
        record: Of the object.

    Raises:
        PhotoregError: if there is a project that cannot be read.
    """
    if not holds_project(project_folder(folder)):
        return None
    result = read_result(project_folder(folder))
    if result is None or not result.cameras:
        return None
    opened = _opened_with(folder, record)
    same = all(
        name in opened and same_camera(camera, opened[name])
        for name, camera in result.cameras.items()
    )
    return None if same else result


def keep_cameras(folder: Path, result: ProjectResult) -> None:
    """Writes the cameras of a mended object beside those of the batch."""
    save_cameras(folder / MENDED, CameraFile(result.cameras))


def opened_files(folder: Path) -> tuple[list[Path], Path]:
    """Mesh and photos of an object, and the cameras that the app opens it with.

    Args:
        folder: The object's, among the results.

    Raises:
        InputError: if the folder is none, or its files have moved.
    """
    record = load_record(folder)
    if record is None:
        raise InputError(
            f"{folder} is not an object's folder made by `photoreg batch`."
        )
    inputs = record.inputs()
    files = [inputs.mesh, *inputs.photos]
    for path in files:
        if not path.is_file():
            raise InputError(
                f"{path}, of which {folder.name} was made, is no longer there. Put it "
                "back, or run the batch again where the objects are now."
            )
    own = folder / CAMERAS
    return files, own if own.is_file() else inputs.cameras


def _opened_with(folder: Path, record: ObjectRecord | None) -> Mapping[str, Camera]:
    """The cameras that the app opens an object with."""
    try:
        if (folder / CAMERAS).is_file():
            return load_cameras(folder / CAMERAS).cameras
        if record is None:
            return {}
        inputs = record.inputs()
        return read_cameras(
            inputs.cameras, photos=photos_by_name(inputs.photos)
        ).cameras
    except PhotoregError:
        return {}
