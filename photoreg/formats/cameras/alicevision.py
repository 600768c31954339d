"""AliceVision's .sfm (Meshroom's cameras.sfm, StructureFromMotion): JSON, numbers as texts.

A view names its photo, its intrinsics and its pose. A pose has the camera's center and its
rotation R, *column by column*: a point X of the world stands at R (X - center) before the
camera, in OpenCV's axes. (0, 0) is the centre of the first pixel, and principal points are
relative to (width / 2, height / 2), which is half a pixel off the photo's middle. Lenses
are Brown's: k1; k1 k2 k3; or k1 k2 k3 p1 p2 in OpenCV's terms. By the file's version:

    before 1.2.1       principal points are relative to (0, 0)
    before 1.2.2       pxFocalLength: one number, or two from 1.2.0 on
    from 1.2.2 on      focalLength in mm: fx = focalLength / sensorWidth * width
    from 1.2.11 on     the same is fy
    before 1.2.5       pixelRatio is fx / fy
    from 1.2.5 on      pixelRatio is fy / fx
    from 1.2.7 on      distortionType says what type said before

Between 1.2.8 and 1.2.11, a pixelRatio other than 1 is refused.

References:
    AliceVision: jsonIO.cpp and viewIO.cpp (versions up to 1.2.8), sceneSample.cpp with the
    files made of it (compatibilityData, versions up to 1.2.14), DistortionRadial.cpp and
    DistortionBrown.cpp, cameraUndistortImage.hpp and ImagesCache.cpp (where pixels are).
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import (
    CameraSet,
    Saved,
    cameras_by_name,
    intrinsics,
    photo_name,
    without,
)
from photoreg.formats.cameras.lens_terms import refuse_lens_terms
from photoreg.formats.mark import GENERATOR
from photoreg.formats.parsing import (
    camera_of,
    finite,
    lens_of,
    numbers,
    read_json,
    size_px,
    whole,
)
from photoreg.formats.writing import write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL, Lens
from photoreg.words import some_of

SENSOR_MM = 36.0
"""Width of the sensor where a file gives none, and in those that are written."""
NEWEST = (1, 2, 14)
"""Latest version whose files were looked at."""
WRITTEN = (1, 2, 6)
"""Version of the files that are written: the last before types of distortion."""

N_TERMS = {
    "pinhole": 0, "none": 0,
    "radial1": 1, "radialk1": 1,
    "radial3": 3, "radialk3": 3,
    "brown": 5,
}  # fmt: skip
"""The number of distortionParams of each type that is understood."""
_SETTINGS = ("distortionType", "distortionParams", "distortionInitializationMode",
             "distortionLocked")  # fmt: skip
"""Of the intrinsics, keys about distortion that are read, or say nothing about pixels."""


def save_alicevision(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    """Writes a .sfm; photos beside it by name, others by their absolute path.

    Raises:
        OutputError: if it cannot be written there.
    """
    views, all_intrinsics, poses, losses = [], [], [], []
    for number, (name, camera) in enumerate(cameras.cameras.items(), start=1):
        camera, lost = without(name, camera, "AliceVision", "skew")
        losses += lost
        key = str(number)
        size = {"width": str(camera.width), "height": str(camera.height)}
        photo = cameras.photos.get(name, path.with_name(name)).resolve()
        is_beside = photo.parent == path.parent.resolve()
        views.append(
            {
                "viewId": key,
                "poseId": key,
                "intrinsicId": key,
                "path": name if is_beside else photo.as_posix(),
                **size,
            }
        )
        all_intrinsics.append({"intrinsicId": key, **size, **_intrinsics_of(camera)})
        transform = {
            "rotation": _texts(camera.R_cam_world.ravel("F")),
            "center": _texts(camera.center),
        }
        poses.append({"poseId": key, "pose": {"transform": transform, "locked": "0"}})
    document = {
        "generator": GENERATOR,
        "version": [str(part) for part in WRITTEN],
        "views": views,
        "intrinsics": all_intrinsics,
        "poses": poses,
    }
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    return Saved(write_files({path: text}, cameras.files, overwrite), losses)


def _intrinsics_of(camera: Camera) -> dict[str, Any]:
    K, lens = camera.K, camera.lens
    focal_mm = repr(float(K[0, 0] / camera.width * SENSOR_MM))
    radial = [lens.k1, lens.k2, lens.k3]
    if lens.is_ideal:
        kind, terms = "pinhole", []
    elif lens.p1 == lens.p2 == 0.0:
        kind, terms = "radial3", radial
    else:
        kind, terms = "brown", [*radial, lens.p1, lens.p2]
    return {
        "sensorWidth": str(SENSOR_MM),
        "sensorHeight": repr(SENSOR_MM * camera.height / camera.width),
        "serialNumber": "",
        "type": kind,
        "initializationMode": "calibrated",
        "initialFocalLength": focal_mm,
        "focalLength": focal_mm,
        "pixelRatio": repr(float(K[1, 1] / K[0, 0])),
        "pixelRatioLocked": "true",
        "principalPoint": _texts(
            (K[0, 2] - 0.5 * camera.width, K[1, 2] - 0.5 * camera.height)
        ),
        "distortionInitializationMode": "calibrated",
        "distortionParams": _texts(terms),
        "undistortionOffset": ["0", "0"],
        "undistortionParams": [],
        "locked": "false",
    }


def _texts(values: Any) -> list[str]:
    return [repr(float(value)) for value in values]


def load_alicevision(path: Path, _photos: dict[str, Path]) -> dict[str, Camera]:
    """Reads the cameras of all views that have a pose.

    Raises:
        InputError: if it is not such a file, or a camera is of a kind that photoreg does
            not know; it is named.
    """
    document = _document(path)
    poses = _by_id(path, document, "poses", "poseId")
    if not poses:
        raise InputError(
            f"{path.name} has no poses, so StructureFromMotion has not run, or found no "
            "camera; give the cameras.sfm or sfmData.sfm that it wrote."
        )
    return cameras_by_name(_cameras(path, document, poses), path.name)


def notes_of(path: Path) -> list[str]:
    """Which views have no pose, and whether the version is a new one, in a sentence."""
    document = _document(path)
    poses = _by_id(path, document, "poses", "poseId")
    lost = [
        photo_name(str(view.get("path")))
        for view in _entries(path, document, "views")
        if str(view.get("poseId")) not in poses
    ]
    notes = []
    if lost:
        notes.append(
            f"Meshroom found no pose of {len(lost)} photos of {path.name} "
            f"({some_of(lost)}); they have no "
            "camera."
        )
    version = _version(path, document)
    if version > NEWEST:
        notes.append(
            f"{path.name} is of AliceVision's version {_dotted(version)}, which is newer "
            f"than those that photoreg knows ({_dotted(NEWEST)}): look whether the photos "
            "lie right on the surface."
        )
    return notes


def _document(path: Path) -> dict[str, Any]:
    document = read_json(path, "camera file")
    if not isinstance(document, dict) or "views" not in document:
        raise InputError(f'{path.name} should hold a list "views".')
    return document


def _entries(path: Path, document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    entries = document.get(key) or []
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise InputError(f"{path.name}: {key} should be a list of objects.")
    return entries


def _by_id(
    path: Path, document: dict[str, Any], key: str, id_key: str
) -> dict[str, dict[str, Any]]:
    return {str(entry.get(id_key)): entry for entry in _entries(path, document, key)}


def _version(path: Path, document: dict[str, Any]) -> tuple[int, int, int]:
    given = document.get("version")
    if not isinstance(given, list) or len(given) != 3:
        raise InputError(f"{path.name}: version should be three numbers.")
    major, minor, revision = (whole(part, path.name, "version") for part in given)
    if (major, minor) > NEWEST[:2] or major < 1:
        raise InputError(
            f"{path.name} is of AliceVision's version {major}.{minor}.{revision}, but "
            f"photoreg knows those up to {_dotted(NEWEST)}; export as COLMAP (Meshroom's "
            "ExportColmap)."
        )
    return major, minor, revision


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


def _cameras(
    path: Path, document: dict[str, Any], poses: dict[str, dict[str, Any]]
) -> Iterator[tuple[str, Camera]]:
    version = _version(path, document)
    by_id = _by_id(path, document, "intrinsics", "intrinsicId")
    for view in _entries(path, document, "views"):
        pose = poses.get(str(view.get("poseId")))
        if pose is None:
            continue
        name = photo_name(str(view.get("path", "")))
        where = f"{path.name}, view {view.get('viewId')} ({name})"
        if "rigId" in view:
            raise InputError(
                f"{where} is of a rig of several cameras (rigId), which photoreg does not "
                "read; export as COLMAP (Meshroom's ExportColmap)."
            )
        given = by_id.get(str(view.get("intrinsicId")))
        if given is None:
            raise InputError(f"{where}: its intrinsics are not in the file.")
        K, lens, size = _calibration(given, version, where)
        transform = _part(_part(pose, "pose", where), "transform", where)
        values = _numbers(transform, "rotation", 9, where)
        R = np.reshape(values, (3, 3), order="F")
        center = np.array(_numbers(transform, "center", 3, where))
        yield name, camera_of(where, K, R, -R @ center, *size, lens)


def _part(entry: dict[str, Any], key: str, where: str) -> dict[str, Any]:
    part = entry.get(key)
    if not isinstance(part, dict):
        raise InputError(f"{where}: its {key} should be an object.")
    return part


def _numbers(entry: dict[str, Any], key: str, count: int, where: str) -> list[float]:
    values = entry.get(key)
    # Its library writes an empty list as an empty text.
    values = [] if values == "" else values
    return numbers(values if isinstance(values, list) else [values], count, where, key)


def _calibration(
    given: dict[str, Any], version: tuple[int, int, int], where: str
) -> tuple[np.ndarray, Lens, tuple[int, int]]:
    size = size_px(given.get("width"), given.get("height"), where)
    lens = _lens(given, where)
    cx, cy = _numbers(given, "principalPoint", 2, where)
    if version >= (1, 2, 1):
        cx, cy = cx + 0.5 * size[0], cy + 0.5 * size[1]
    fx, fy = _focal_px(given, version, size[0], where)
    return intrinsics(fx, fy, cx, cy), lens, size


def _focal_px(
    given: dict[str, Any], version: tuple[int, int, int], width: int, where: str
) -> tuple[float, float]:
    if version < (1, 2, 2):
        focal = given.get("pxFocalLength")
        if not isinstance(focal, list):
            focal = [focal, focal]
        fx, fy = numbers(focal, 2, where, "pxFocalLength")
        return fx, fy
    sensor_mm = finite(given.get("sensorWidth", SENSOR_MM), where, "sensorWidth")
    ratio = finite(given.get("pixelRatio", 1.0), where, "pixelRatio")
    if not (sensor_mm > 0.0 and ratio > 0.0):
        raise InputError(f"{where}: sensorWidth and pixelRatio should be positive.")
    focal_px = finite(given.get("focalLength"), where, "focalLength")
    focal_px *= width / sensor_mm
    if version < (1, 2, 5):
        return focal_px, focal_px / ratio
    if version <= (1, 2, 8):
        return focal_px, focal_px * ratio
    if version < (1, 2, 11) and abs(ratio - 1.0) > 1e-9:
        raise InputError(
            f"{where} has a pixelRatio of {ratio:g}, of which versions 1.2.9 and 1.2.10 do "
            "not say what it is; export as COLMAP (Meshroom's ExportColmap)."
        )
    return focal_px / ratio, focal_px


def _lens(given: dict[str, Any], where: str) -> Lens:
    refuse_lens_terms({k: v for k, v in given.items() if k not in _SETTINGS}, where)
    for key in ("type", "distortionType"):
        kind = given.get(key, "none")
        if kind not in N_TERMS:
            raise InputError(
                f"{where} has lens distortion ({key}: {kind!s:.40}) that photoreg does not "
                "know; undistort the photos in Meshroom (ExportImages, or "
                "PrepareDenseScene) and give those with pinhole cameras."
            )
    n_terms = max(N_TERMS[given.get(k, "none")] for k in ("type", "distortionType"))
    if n_terms == 0:
        return IDEAL
    terms = _numbers(given, "distortionParams", n_terms, where)
    k1, k2, k3, p1, p2 = [*terms, 0.0, 0.0, 0.0, 0.0][:5]
    return lens_of(where, k1, k2, p1, p2, k3)
