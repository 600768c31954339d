"""COLMAP's sparse model: a folder of cameras, images and points, as text or binary.

Poses are world to camera, a quaternion w x y z and t, in OpenCV's axes. COLMAP puts
the centre of the first pixel at (0.5, 0.5), so 0.5 is added to the principal point.
PINHOLE is written, and OPENCV or FULL_OPENCV where there is a lens; SIMPLE_PINHOLE,
SIMPLE_RADIAL, RADIAL and they are read.

References:
    https://colmap.github.io/format.html
"""

import dataclasses
import io
import math
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from scipy.spatial.transform import Rotation

from photoreg.checks import check_input_file
from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import (
    CameraSet,
    Saved,
    cameras_by_name,
    intrinsics,
    without,
)
from photoreg.formats.cameras.lens_models import opencv_lens
from photoreg.formats.cameras.lens_terms import refuse_distortion
from photoreg.formats.mark import COMMENT
from photoreg.formats.parsing import (
    camera_of,
    lens_of,
    numbers,
    read_text,
    size_px,
    whole,
)
from photoreg.formats.writing import make_folder, write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL, Lens
from photoreg.sources import open_for_reading

PINHOLE_ID, OPENCV_ID, FULL_OPENCV_ID = 1, 4, 6
MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    PINHOLE_ID: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
}
"""COLMAP's number of each camera model, its name, and how many parameters it has."""

ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
TWO_FOCALS = ("PINHOLE", "OPENCV", "FULL_OPENCV")
SUBFOLDERS = (".", "sparse/0", "sparse", "0")
"""Where, in the folder of a project, COLMAP keeps its model."""

_POINTS = re.compile(r"[-+.\deEinfa\s]*")
"""What a line of points is made of."""


@dataclasses.dataclass(frozen=True)
class _Lens:
    """A line of the file of cameras."""

    model: str
    width: int
    height: int
    parameters: Sequence[float]


@dataclasses.dataclass(frozen=True)
class _Image:
    """A line of the file of images."""

    name: str
    quaternion: Sequence[float]
    t: Sequence[float]
    lens: int
    where: str


def model_folder(folder: Path, suffix: str) -> Path | None:
    """The folder with cameras and images of ``suffix`` in a project; None: it has none."""
    for place in SUBFOLDERS:
        if all(
            (folder / place / f"{n}{suffix}").is_file() for n in ("cameras", "images")
        ):
            return folder / place
    return None


def save_colmap_text(
    folder: Path, cameras: CameraSet, overwrite: bool = False
) -> Saved:
    """Writes cameras.txt, images.txt and an empty points3D.txt.

    Raises:
        OutputError: if they cannot be written there.
    """
    mark = f"# {COMMENT}\n"
    lenses = [mark, "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"]
    images = [mark, "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"]
    images.append("#   POINTS2D[] as (X, Y, POINT3D_ID)\n")
    losses = []
    for i, (name, camera) in enumerate(cameras.cameras.items(), start=1):
        camera, lost = without(name, camera, "COLMAP", "skew")
        losses += lost
        if " " in name:
            losses.append(
                f"{name} loses all after its first space when COLMAP reads the text; "
                "write the binary model instead."
            )
        model, parameters = _model(camera)
        lens = " ".join(map(repr, parameters))
        pose = " ".join(map(repr, [*_quaternion(camera), *camera.t_cam_world.tolist()]))
        lenses.append(f"{i} {MODELS[model][0]} {camera.width} {camera.height} {lens}\n")
        images.append(f"{i} {pose} {i} {name}\n\n")
    make_folder(folder)
    files = write_files(
        {
            folder / "images.txt": "".join(images),
            folder / "cameras.txt": "".join(lenses),
            folder
            / "points3D.txt": f"{mark}# 3D point list: empty, the mesh is the surface\n",
        },
        cameras.files,
        overwrite,
    )
    return Saved(files, losses)


def save_colmap_binary(
    folder: Path, cameras: CameraSet, overwrite: bool = False
) -> Saved:
    """Writes cameras.bin, images.bin and a points3D.bin without points.

    The format has no place for a mark.

    Raises:
        OutputError: if they cannot be written there.
    """
    count = struct.pack("<Q", len(cameras.cameras))
    lenses, images, losses = [count], [count], []
    for i, (name, camera) in enumerate(cameras.cameras.items(), start=1):
        camera, lost = without(name, camera, "COLMAP", "skew")
        losses += lost
        model, parameters = _model(camera)
        lenses.append(struct.pack("<IiQQ", i, model, camera.width, camera.height))
        lenses.append(struct.pack(f"<{len(parameters)}d", *parameters))
        pose = [*_quaternion(camera), *camera.t_cam_world.tolist()]
        images.append(struct.pack("<I7dI", i, *pose, i))
        images.append(name.encode() + b"\0" + struct.pack("<Q", 0))
    make_folder(folder)
    files = write_files(
        {
            folder / "images.bin": b"".join(images),
            folder / "cameras.bin": b"".join(lenses),
            folder / "points3D.bin": struct.pack("<Q", 0),
        },
        cameras.files,
        overwrite,
    )
    return Saved(files, losses)


def load_colmap_text(folder: Path) -> dict[str, Camera]:
    """Reads cameras.txt and images.txt, also in sparse/0 of a project.

    Raises:
        InputError: if one is missing or not as it should be, or a camera that an
            image uses has a lens that photoreg does not know.
    """
    folder = model_folder(folder, ".txt") or folder
    lenses = {}
    for where, line in _lines(folder / "cameras.txt"):
        words = line.split()
        if len(words) < 5:
            raise InputError(f"{where} should be CAMERA_ID MODEL WIDTH HEIGHT PARAMS.")
        parameters = numbers(words[4:], len(words) - 4, where, "its parameters")
        size = size_px(words[2], words[3], where)
        number = whole(words[0], where, "the camera's number")
        if number in lenses:
            raise InputError(f"{where} is a second camera {number}. Remove one.")
        lenses[number] = _Lens(words[1], *size, parameters)
    return cameras_by_name(_cameras(lenses, _text_images(folder)), "images.txt")


def load_colmap_binary(folder: Path) -> dict[str, Camera]:
    """Reads cameras.bin and images.bin, also in sparse/0 of a project.

    Raises:
        InputError: if one is missing, truncated or not as it should be, or a camera
            that an image uses has a lens that photoreg does not know.
    """
    folder = model_folder(folder, ".bin") or folder
    lenses = {}
    path = check_input_file(folder / "cameras.bin", "file of cameras")
    with open_for_reading(path) as file:
        reader = _Reader(file, path)
        for _ in range(reader.count(48)):
            number, model, width, height = reader.unpack("<IiQQ")
            where = f"cameras.bin, camera {number}"
            if model not in MODELS:
                raise InputError(
                    f"{where}: COLMAP's camera model {model} is not one that photoreg "
                    "knows; undistort the photos in COLMAP (image_undistorter)."
                )
            name, n_parameters = MODELS[model]
            parameters = reader.unpack(f"<{n_parameters}d")
            lenses[number] = _Lens(name, *size_px(width, height, where), parameters)
    return cameras_by_name(_cameras(lenses, _binary_images(folder)), "images.bin")


def _text_images(folder: Path) -> Iterator[_Image]:
    lines = _lines(folder / "images.txt", keep_blank_after_data=True)
    for where, line in lines:
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise InputError(
                f"{where} should be IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME."
            )
        pose = numbers(words[1:8], 7, where, "the pose")
        lens = whole(words[8], where, "the camera's number")
        yield _Image(words[9], pose[:4], pose[4:], lens, where)
        # The image's points, x y and a number each; an empty line if it has none.
        where, points = next(lines, (where, ""))
        if _POINTS.fullmatch(points[-100:]) is None or len(points.split()) % 3 != 0:
            raise InputError(
                f"{where} should be the points of {words[9]}, three numbers each, or an "
                f"empty line, but is {points!r:.60}. COLMAP has two lines an image."
            )


def _binary_images(folder: Path) -> Iterator[_Image]:
    path = check_input_file(folder / "images.bin", "file of images")
    with open_for_reading(path) as file:
        reader = _Reader(file, path)
        for _ in range(reader.count(73)):
            number, *pose, lens = reader.unpack("<I7dI")
            name = reader.text()
            yield _Image(name, pose[:4], pose[4:], lens, f"images.bin, image {number}")
            reader.skip(reader.count(24) * 24)


def _cameras(
    lenses: Mapping[int, _Lens], images: Iterator[_Image]
) -> Iterator[tuple[str, Camera]]:
    for image in images:
        where = f"{image.where} ({image.name})"
        lens = lenses.get(image.lens)
        if lens is None:
            raise InputError(
                f"{where} names camera {image.lens}, which does not exist."
            )
        norm = math.hypot(*image.quaternion)
        if not abs(norm - 1.0) < 1e-2:
            raise InputError(
                f"{where}: its rotation should be a unit quaternion, but is "
                f"{norm:.3g} long."
            )
        w, x, y, z = image.quaternion
        R = Rotation.from_quat([x, y, z, w]).as_matrix()
        K, distortion = _intrinsics(lens, where)
        size = lens.width, lens.height
        yield image.name, camera_of(where, K, R, image.t, *size, distortion)


def _intrinsics(lens: _Lens, where: str) -> tuple[np.ndarray, Lens]:
    expected = dict(MODELS.values()).get(lens.model)
    if expected is not None and len(lens.parameters) != expected:
        raise InputError(
            f"{where}: a camera of model {lens.model} should have {expected} "
            f"parameters, but has {len(lens.parameters)}."
        )
    if lens.model in ONE_FOCAL:
        (f, cx, cy), rest = lens.parameters[:3], lens.parameters[3:]
        fx = fy = f
    elif lens.model in TWO_FOCALS:
        (fx, fy, cx, cy), rest = lens.parameters[:4], lens.parameters[4:]
    else:
        (fx, fy, cx, cy), rest = (1.0, 1.0, 0.0, 0.0), (1.0,)
    where = f"{where}: its camera, of COLMAP's model {lens.model},"
    K = intrinsics(fx, fy, cx - 0.5, cy - 0.5)
    if lens.model in ONE_FOCAL:
        return K, lens_of(where, *rest)  # Nothing, k, or k1 and k2.
    if lens.model in TWO_FOCALS:
        return K, opencv_lens(rest, K, (lens.width, lens.height), where)
    refuse_distortion(rest, where)
    return K, IDEAL


def _model(camera: Camera) -> tuple[int, list[float]]:
    """COLMAP's model that holds the camera, and its parameters."""
    K, (k1, k2, p1, p2, k3) = camera.K, camera.lens.terms
    pinhole = [float(v) for v in (K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5)]
    if camera.lens.is_ideal:
        return PINHOLE_ID, pinhole
    if k3 == 0.0:
        return OPENCV_ID, [*pinhole, k1, k2, p1, p2]
    return FULL_OPENCV_ID, [*pinhole, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]


def _quaternion(camera: Camera) -> list[float]:
    # A copy: older scipy takes no read-only array.
    rotation = Rotation.from_matrix(camera.R_cam_world.copy())
    x, y, z, w = rotation.as_quat(canonical=True).tolist()
    return [w, x, y, z]


def _lines(
    path: Path, keep_blank_after_data: bool = False
) -> Iterator[tuple[str, str]]:
    """Each line that is not a comment, and where it stands."""
    text = io.StringIO(read_text(path, f"file of {path.stem}"))
    after_data = False
    for number, line in enumerate(text, start=1):
        line = line.strip()
        if line.startswith("#") or not (line or (keep_blank_after_data and after_data)):
            continue
        after_data = bool(line) and not after_data
        yield f"{path.name}, line {number}", line


class _Reader:
    """A binary file read piece by piece, never past its end."""

    def __init__(self, file: IO[bytes], path: Path) -> None:
        self._file, self._name = file, path.name
        self._left = path.stat().st_size

    def unpack(self, layout: str) -> tuple:
        """The next values, laid out as `struct` says."""
        return struct.unpack(layout, self._read(struct.calcsize(layout)))

    def count(self, least_bytes_each: int) -> int:
        """A count of what follows, which the rest of the file must be able to hold."""
        (count,) = self.unpack("<Q")
        if count * least_bytes_each > self._left:
            raise self._truncated()
        return count

    def text(self) -> str:
        """Text up to a zero byte."""
        letters = bytearray()
        while (letter := self._read(1)) != b"\0":
            letters += letter
            if len(letters) > 10_000:
                raise InputError(f"{self._name} has a photo name without an end.")
        try:
            return letters.decode()
        except UnicodeDecodeError as error:
            raise InputError(
                f"{self._name} has a photo name that is not UTF-8."
            ) from error

    def skip(self, n_bytes: int) -> None:
        """Passes over what is not needed."""
        self._left -= n_bytes
        self._file.seek(n_bytes, io.SEEK_CUR)

    def _read(self, n_bytes: int) -> bytes:
        if n_bytes > self._left:
            raise self._truncated()
        self._left -= n_bytes
        return self._file.read(n_bytes)

    def _truncated(self) -> InputError:
        return InputError(
            f"{self._name} ends before all that it announces; it is truncated, or not "
            "a COLMAP file."
        )
