"""nerfstudio's transforms.json: poses camera to world, in OpenGL's camera axes.

The centre of the first pixel is at (0.5, 0.5), as in COLMAP. Poses are taken as they
are. An "applied_transform" that led to them is reported: a mesh made from COLMAP's files
is in the world before it.

References:
    https://docs.nerf.studio/quickstart/data_conventions.html
"""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.checks import check_finite_array
from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import (
    OPENGL_AXES,
    CameraSet,
    Saved,
    cameras_by_name,
    intrinsics,
    photo_name,
    without,
)
from photoreg.formats.cameras.cameras_json import WorldMove
from photoreg.formats.cameras.lens_terms import refuse_lens_terms
from photoreg.formats.mark import GENERATOR
from photoreg.formats.parsing import (
    camera_of,
    finite,
    lens_of,
    read_json,
    size_px,
)
from photoreg.formats.photos.files import path_from, stored_size
from photoreg.formats.writing import write_files
from photoreg.geometry.camera import ORTHONORMAL_TOLERANCE, Camera
from photoreg.geometry.lens import TERMS

PERSPECTIVE = (
    "PINHOLE",
    "OPENCV",
    "SIMPLE_PINHOLE",
    "PERSPECTIVE",
    "SIMPLE_RADIAL",
    "RADIAL",
)
DISTORTION_PARAMS = ("k1", "k2", "k3", "k4", "p1", "p2")
"""In nerfstudio's order."""


def save_nerfstudio(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    """Writes transforms.json, with the size and the lens in each frame.

    Raises:
        OutputError: if it cannot be written there.
    """
    frames, losses = [], []
    for name, camera in cameras.cameras.items():
        camera, lost = without(name, camera, "nerfstudio", "skew")
        losses += lost
        pose = np.eye(4)
        pose[:3, :3] = camera.R_cam_world.T @ OPENGL_AXES
        pose[:3, 3] = camera.center
        photo = cameras.photos.get(name)
        terms = zip(TERMS, camera.lens.terms, strict=True)
        frames.append(
            {
                "file_path": path_from(path.parent, photo) if photo else name,
                "w": camera.width,
                "h": camera.height,
                "fl_x": float(camera.K[0, 0]),
                "fl_y": float(camera.K[1, 1]),
                "cx": float(camera.K[0, 2] + 0.5),
                "cy": float(camera.K[1, 2] + 0.5),
                **({} if camera.lens.is_ideal else dict(terms)),
                "transform_matrix": pose.tolist(),
            }
        )
    is_ideal = all(camera.lens.is_ideal for camera in cameras.cameras.values())
    model = "PINHOLE" if is_ideal else "OPENCV"
    document = {"generator": GENERATOR, "camera_model": model, "frames": frames}
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    return Saved(write_files({path: text}, cameras.files, overwrite), losses)


def load_nerfstudio(path: Path, photos: dict[str, Path]) -> dict[str, Camera]:
    """Reads transforms.json; sizes that it leaves out are taken from the photos.

    Raises:
        InputError: if it is not such a file, a frame lacks something, or a lens is of
            a kind that photoreg does not know.
    """
    document = read_json(path, "camera file")
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list):
        raise InputError(f'{path.name} should hold a list "frames".')
    return cameras_by_name(_cameras(path, document, frames, photos), path.name)


def world_move(path: Path) -> WorldMove | None:
    """What nerfstudio did to the poses of a transforms.json when it made it.

    None where it did nothing, or something else than to turn, shift and enlarge.
    """
    document = read_json(path, "camera file")
    if not _is_moved(document):
        return None
    try:
        scale = finite(document.get("applied_scale", 1.0), path.name, "applied_scale")
        matrix = check_finite_array(
            document.get("applied_transform", np.eye(4).tolist())[:3], (3, 4), "it"
        )
    except (InputError, TypeError):
        return None
    turn = matrix[:, :3]
    is_turn = np.abs(turn.T @ turn - np.eye(3)).max() < ORTHONORMAL_TOLERANCE
    if not is_turn or np.linalg.det(turn) < 0.0 or not scale > 0.0:
        return None
    return WorldMove(turn, matrix[:, 3], scale, _moved_note(path))


def _is_moved(document: Mapping[str, Any]) -> bool:
    turn, scale = document.get("applied_transform"), document.get("applied_scale", 1.0)
    # Its last row, which says nothing, may be missing.
    return (isinstance(turn, list) and turn[:3] != np.eye(4)[:3].tolist()) or (
        scale != 1.0
    )


def _moved_note(path: Path) -> str:
    return (
        f"The poses in {path.name} were moved to another world when it was made, by "
        "its applied_transform, and are taken as they stand. The mesh should be of "
        "that world; one from COLMAP or OpenMVS is not: give COLMAP's own cameras "
        "with it."
    )


def notes_of(path: Path) -> list[str]:
    """What a transforms.json says that is ignored, a sentence each."""
    document = read_json(path, "camera file")
    notes = []
    if _is_moved(document):
        notes.append(_moved_note(path))
    if any("mask_path" in frame for frame in document["frames"]):
        notes.append(
            f"The masks that {path.name} names (mask_path) are not read; give photos "
            "with a transparent background instead, or mask them in the app."
        )
    return notes


def _cameras(
    path: Path, document: dict[str, Any], frames: list[Any], photos: dict[str, Path]
) -> Iterator[tuple[str, Camera]]:
    for number, frame in enumerate(frames, start=1):
        where = f"{path.name}, frame {number}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise InputError(f'{where} should be an object with a "file_path".')
        name = photo_name(frame["file_path"])
        where = f"{where} ({name})"
        values = _with_named_terms({**document, **frame})
        model = values.get("camera_model", "PINHOLE")
        if model not in PERSPECTIVE:
            raise InputError(
                f"{where}: camera_model {model!r:.40} is not a pinhole camera; undistort "
                "the photos first."
            )
        refuse_lens_terms({k: v for k, v in values.items() if k not in TERMS}, where)
        lens = lens_of(where, *(finite(values.get(k, 0.0), where, k) for k in TERMS))
        photo = _photo(path, frame["file_path"], photos)
        if photo is not None:
            photos[name] = photo
        width, height = _size(values, where, photo)
        if "fl_x" in values:
            fx = finite(values["fl_x"], where, "fl_x")
        elif "camera_angle_x" in values:
            angle = finite(values["camera_angle_x"], where, "camera_angle_x")
            if not 0.0 < angle < math.pi:
                raise InputError(f"{where}: camera_angle_x {angle:g} is not an angle.")
            fx = 0.5 * width / math.tan(0.5 * angle)
        else:
            raise InputError(f"{where} lacks fl_x, the focal length.")
        fy = finite(values.get("fl_y", fx), where, "fl_y")
        cx = finite(values.get("cx", 0.5 * width), where, "cx")
        cy = finite(values.get("cy", 0.5 * height), where, "cy")
        try:
            pose = check_finite_array(
                values.get("transform_matrix"), (4, 4), "transform_matrix"
            )
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        R = OPENGL_AXES @ pose[:3, :3].T
        K = intrinsics(fx, fy, cx - 0.5, cy - 0.5)
        yield name, camera_of(where, K, R, -R @ pose[:3, 3], width, height, lens)


def _with_named_terms(values: dict[str, Any]) -> dict[str, Any]:
    """The same, with each of "distortion_params" by its name, instead of any given there."""
    terms = values.get("distortion_params")
    if not isinstance(terms, list) or len(terms) != len(DISTORTION_PARAMS):
        return values
    del values["distortion_params"]
    return {**values, **dict(zip(DISTORTION_PARAMS, terms, strict=True))}


def _photo(path: Path, file_path: str, photos: dict[str, Path]) -> Path | None:
    given = photos.get(photo_name(file_path))
    beside = path.parent / file_path
    return given or (beside if "\0" not in file_path and beside.is_file() else None)


def _size(values: Mapping[str, Any], where: str, photo: Path | None) -> tuple[int, int]:
    if "w" in values and "h" in values:
        return size_px(values["w"], values["h"], where)
    if photo is None:
        raise InputError(
            f"{where}: the file does not give the photo's size (w, h), and the photo is "
            "not beside it. Give the photos too."
        )
    return stored_size(photo)
