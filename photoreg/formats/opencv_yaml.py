"""OpenCV's FileStorage, YAML: K, R, t and P of each photo, nothing lost.

A list "cameras" of {photo, width, height, K, R, t, P}. The axes and the pixel (0, 0)
are those of `cv2.projectPoints`, which are photoreg's own.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from photoreg.camera import Camera
from photoreg.errors import InputError
from photoreg.formats.camera_set import CameraSet, Saved, cameras_by_name
from photoreg.formats.parsing import camera_of, read_text, refuse_distortion, size_px
from photoreg.formats.writing import write_files


def save_opencv(path: Path, cameras: CameraSet) -> Saved:
    """Writes YAML that `cv2.FileStorage` reads.

    Raises:
        OutputError: if it cannot be written there.
    """
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.startWriteStruct("cameras", cv2.FILE_NODE_SEQ)
    for name, camera in cameras.cameras.items():
        storage.startWriteStruct("", cv2.FILE_NODE_MAP)
        storage.write("photo", name)
        storage.write("width", camera.width)
        storage.write("height", camera.height)
        storage.write("K", camera.K.copy())
        storage.write("R", camera.R_cam_world.copy())
        storage.write("t", camera.t_cam_world.reshape(3, 1).copy())
        storage.write("P", camera.P)
        storage.endWriteStruct()
    storage.endWriteStruct()
    return Saved(write_files({path: storage.releaseAndGetString()}))


def load_opencv(path: Path) -> dict[str, Camera]:
    """Reads what `save_opencv` wrote, or a program that keeps to its keys.

    "distortion", where there is one, must be zero; R may also be a rotation vector.

    Raises:
        InputError: if it is not such a file or a camera in it is not valid.
    """
    text = read_text(path, "camera file")
    if re.match(r"%YAML[: ]\d+\.\d+\s*\n", text) is None or "\n%" in text:
        # OpenCV looks for the end of any other directive for ever.
        raise InputError(
            f"{path.name} is not a YAML file that OpenCV reads; it should begin with "
            "%YAML and be complete."
        )
    storage = cv2.FileStorage()
    try:
        storage.open(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        node = storage.getNode("cameras")
        if not node.isSeq():
            raise InputError(f'{path.name} should hold a list "cameras".')
        return cameras_by_name(_cameras(path, node), path.name)
    except (cv2.error, SystemError) as error:
        raise InputError(
            f"{path.name} is not a YAML file that OpenCV reads; it should begin with "
            "%YAML and be complete."
        ) from error
    finally:
        storage.release()


def _cameras(path: Path, cameras: cv2.FileNode) -> Iterator[tuple[str, Camera]]:
    for i in range(cameras.size()):
        where, entry = f"{path.name}, camera {i + 1}", cameras.at(i)
        if not entry.isMap():
            raise InputError(f"{where} should be a map with photo, K, R and t.")
        name = entry.getNode("photo")
        if not name.isString():
            raise InputError(f'{where}: "photo" should be a file name.')
        where = f"{where} ({name.string()})"
        sides = [entry.getNode(key) for key in ("width", "height")]
        if not all(side.isInt() or side.isReal() for side in sides):
            raise InputError(f"{where} lacks the photo's width and height.")
        K, R, t = (_matrix(entry, key, where) for key in ("K", "R", "t"))
        if not entry.getNode("distortion").empty():
            refuse_distortion(_matrix(entry, "distortion", where).ravel(), where)
        if R.size == 3:
            R = cv2.Rodrigues(R.reshape(3, 1))[0]
        size = size_px(sides[0].real(), sides[1].real(), where)
        yield name.string(), camera_of(where, K, R, t.ravel(), *size)


def _matrix(entry: cv2.FileNode, key: str, where: str) -> np.ndarray:
    node = entry.getNode(key)
    # FileNode.mat() writes past its memory where rows or cols are missing or wrong, so
    # the numbers are taken one by one.
    sides = [node.getNode(side) for side in ("rows", "cols")] if node.isMap() else []
    data = node.getNode("data") if node.isMap() else None
    if data is None or not data.isSeq() or not all(side.isInt() for side in sides):
        raise InputError(f'{where}: "{key}" should be a matrix.')
    shape = tuple(int(side.real()) for side in sides)
    values = [data.at(i) for i in range(data.size())]
    if min(shape) < 1 or shape[0] * shape[1] != len(values):
        raise InputError(
            f'{where}: "{key}" should have {shape[0]} x {shape[1]} numbers, but has '
            f"{len(values)}."
        )
    if not all(value.isInt() or value.isReal() for value in values):
        raise InputError(f'{where}: "{key}" should hold numbers only.')
    return np.reshape([value.real() for value in values], shape)
