"""OpenCV's FileStorage, YAML: K, R, t and P of each photo, nothing lost.

A list "cameras" of {photo, width, height, K, R, t, P} and, where there is a lens,
"distortion" (k1 k2 p1 p2 k3). The axes and the pixel (0, 0)
are those of `cv2.projectPoints`, which are photoreg's own.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import CameraSet, Saved, cameras_by_name
from photoreg.formats.cameras.lens_models import opencv_lens
from photoreg.formats.cameras.lens_terms import refuse_lens_terms
from photoreg.formats.mark import COMMENT
from photoreg.formats.parsing import (
    camera_of,
    numbers,
    read_text,
    size_px,
    whole,
)
from photoreg.formats.writing import write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL
from photoreg.limits import Limits

LOADER = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
"""Takes every number and name as text, and heeds no tag; libyaml's is ten times faster."""


def save_opencv(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    """Writes YAML that `cv2.FileStorage` reads.

    Raises:
        OutputError: if it cannot be written there.
    """
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.writeComment(COMMENT)
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
        if not camera.lens.is_ideal:
            storage.write("distortion", np.array([camera.lens.terms]))
        storage.endWriteStruct()
    storage.endWriteStruct()
    contents = {path: storage.releaseAndGetString()}
    return Saved(write_files(contents, cameras.files, overwrite))


def load_opencv(path: Path) -> dict[str, Camera]:
    """Reads what `save_opencv` wrote, or a program that keeps to its keys.

    "distortion" is OpenCV's vector, where there is one; R may also be a rotation vector.
    OpenCV's own reader is not used: on damaged files it hangs, or writes past its
    memory (5.0).

    Raises:
        InputError: if it is not such a file or a camera in it is not valid.
    """
    text = read_text(path, "camera file", Limits.of_environment().yaml_file_mb)
    document = _parsed(path.name, text)
    cameras = document.get("cameras") if isinstance(document, dict) else None
    if not isinstance(cameras, list):
        raise InputError(f'{path.name} should hold a list "cameras".')
    return cameras_by_name(_cameras(path, document, cameras), path.name)


def _parsed(name: str, text: str) -> Any:
    """What YAML holds, as dicts, lists and text."""
    # OpenCV's first line has a colon, which YAML's has not, and its texts have \'.
    if text.startswith("%YAML:"):
        text = f"#{text}"
    text = re.sub(r"\\(.)", lambda pair: "'" if pair[1] == "'" else pair[0], text)
    try:
        # A few aliases of aliases would be more than any memory holds.
        for event in yaml.parse(text, Loader=LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise InputError(f"{name} repeats parts by aliases; write them out.")
        return yaml.load(text, Loader=LOADER)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        line = f" at line {mark.line + 1}" if mark is not None else ""
        reason = f"{error.problem or error.context}{line}"
    except yaml.YAMLError:
        reason = "it holds characters that text does not have"
    except RecursionError:
        reason = "it is nested too deep"
    raise InputError(f"{name} is not a YAML file: {reason}.")


def _cameras(
    path: Path, document: dict[str, Any], cameras: list[Any]
) -> Iterator[tuple[str, Camera]]:
    for number, entry in enumerate(cameras, start=1):
        where = f"{path.name}, camera {number}"
        if not isinstance(entry, dict):
            raise InputError(f"{where} should be a map with photo, K, R and t.")
        name = entry.get("photo")
        if not isinstance(name, str):
            raise InputError(f'{where}: "photo" should be a file name.')
        where = f"{where} ({name:.80})"
        if "width" not in entry or "height" not in entry:
            raise InputError(f"{where} lacks the photo's width and height.")
        K, R, t = (_matrix(entry.get(key), key, where) for key in ("K", "R", "t"))
        others = {k: v for k, v in entry.items() if k != "distortion"}
        refuse_lens_terms({**document, **others}, where)
        if R.size == 3:
            R = cv2.Rodrigues(R.reshape(3, 1))[0]
        size = size_px(entry["width"], entry["height"], where)
        lens = IDEAL
        if "distortion" in entry:
            distortion = _matrix(entry["distortion"], "distortion", where).ravel()
            camera_of(where, K, R, t.ravel(), *size)  # K must be one.
            lens = opencv_lens(distortion.tolist(), K, size, where)
        yield name, camera_of(where, K, R, t.ravel(), *size, lens)


def _matrix(value: Any, key: str, where: str) -> np.ndarray:
    parts = value if isinstance(value, dict) else {}
    data = parts.get("data")
    if not ("rows" in parts and "cols" in parts and isinstance(data, list)):
        raise InputError(f'{where}: "{key}" should be a matrix.')
    n_rows, n_columns = (
        whole(parts[s], where, f"{key}'s {s}") for s in ("rows", "cols")
    )
    if min(n_rows, n_columns) < 1:
        raise InputError(f'{where}: "{key}" should have at least a row and a column.')
    values = numbers(data, n_rows * n_columns, where, f'"{key}"')
    return np.reshape(values, (n_rows, n_columns))
