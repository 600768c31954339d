"""What every camera format is given and gives: cameras by photo, and what is lost."""

import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import scipy.optimize
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from photoreg.errors import InputError, OutputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import TERMS, Lens
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
    "metashape",
    "realityscan",
    "alicevision",
]
"""The formats of cameras, as they are named on the command line."""

MAX_SIDE_PX = 1_000_000
OPENGL_AXES = np.diag([1.0, -1.0, -1.0])
"""Between OpenCV's camera axes and OpenGL's (y up, looking along -z), both ways."""


@dataclasses.dataclass(frozen=True)
class CameraSet:
    """Cameras to write, and the files that other programs want beside them."""

    cameras: Mapping[str, Camera]
    """Photo file name to camera."""
    photos: Mapping[str, Path] = dataclasses.field(default_factory=dict)
    """Photo file name to where the photo lies, as far as known."""
    mesh: Path | None = None
    """The mesh that the cameras look at, for formats that name it."""

    def __post_init__(self) -> None:
        if not self.cameras:
            raise InputError("There are no cameras to write.")
        for name in self.cameras:
            if not name or photo_name(name) != name or not name.isprintable():
                raise InputError(
                    f"Cameras are written by photo file name, but {name!r} is not a "
                    "plain file name."
                )

    @property
    def files(self) -> list[Path]:
        """The files that the cameras are about, which stay as they are."""
        return [*self.photos.values(), *([] if self.mesh is None else [self.mesh])]

    def copies_in(self, folder: Path) -> dict[Path, Path]:
        """Copies to make of the known photos so that all are in ``folder``: to, from."""
        return {
            folder / name: self.photos[name]
            for name in self.cameras
            if name in self.photos
            and self.photos[name].resolve().parent != folder.resolve()
        }


@dataclasses.dataclass(frozen=True)
class Saved:
    """What writing a set of cameras did."""

    files: list[Path]
    """The files written, the one to open first."""
    losses: list[str] = dataclasses.field(default_factory=list)
    """A sentence for each thing that this very set loses in this format."""


def photo_name(path: str) -> str:
    """The file name in a path of any system, in Unicode's composed form.

    Photos are matched by it.
    """
    return nfc(re.split(r"[/\\]", path.strip())[-1])


def files_by_stem(
    folder: Path, cameras: CameraSet, suffix: str, program: str
) -> dict[Path, str]:
    """A file for each photo, of its name but for the suffix, to the photo's name.

    Raises:
        OutputError: if two photos differ in their suffix only.
    """
    files: dict[Path, str] = {}
    for name in cameras.cameras:
        path = folder / f"{Path(name).stem}{suffix}"
        if path in files:
            raise OutputError(
                f"{program} tells photos apart by their name without suffix, but two are "
                f"called {path.stem}. Rename one."
            )
        files[path] = name
    return files


def cameras_by_name(
    entries: Iterable[tuple[str, Camera]], where: str
) -> dict[str, Camera]:
    """Cameras by the file name of their photo, folders taken off.

    Raises:
        InputError: if a name is empty, two are the same, or there is none at all.
    """
    cameras: dict[str, Camera] = {}
    for path, camera in entries:
        name = photo_name(path)
        if not name:
            raise InputError(f"{where} has a camera without the name of a photo.")
        if name in cameras:
            raise InputError(
                f"{where} has two cameras for {name}; photos are matched by file name, "
                "whatever their folder. Rename one."
            )
        cameras[name] = camera
    if not cameras:
        raise InputError(f"{where} has no cameras.")
    return cameras


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> Float[np.ndarray, "3 3"]:
    """K in pixels, without skew."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def without(
    name: str,
    camera: Camera,
    program: str,
    *features: str,
    lens_terms: Sequence[str] = TERMS,
) -> tuple[Camera, list[str]]:
    """The camera nearest to ``camera`` that lacks ``features``, and what that costs.

    Args:
        name: The photo, for the sentence.
        camera: The camera.
        program: Whose file it is, for the sentence.
        *features: Of "skew", "aspect" (fx != fy) and "principal point" (off the
            middle), those that the file cannot hold. Where the principal point goes,
            the camera is turned to make up for it as far as that can be.
        lens_terms: Those that the file can hold.

    Returns:
        The camera as it can be written, and no sentence or one.
    """
    K, lost = camera.K.copy(), []
    middle = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    smallest = 1e-9 * max(camera.width, camera.height)
    if "skew" in features and abs(K[0, 1]) > smallest:
        lost.append(
            f"its skew of {K[0, 1]:.3g} px, which cannot be folded into the rest"
        )
        K[0, 1] = 0.0
    if "aspect" in features and abs(K[0, 0] - K[1, 1]) > smallest:
        lost.append(f"its two focal lengths, {K[0, 0]:.6g} and {K[1, 1]:.6g} px")
        K[0, 0] = K[1, 1] = np.sqrt(K[0, 0] * K[1, 1])
    R, t = camera.R_cam_world, camera.t_cam_world
    off = K[0, 2] - middle[0], K[1, 2] - middle[1]
    is_turned = "principal point" in features and max(map(abs, off)) > smallest
    if is_turned:
        lost.append(
            f"its principal point, ({off[0]:.3g}, {off[1]:.3g}) px off the middle, for "
            "which the camera is turned a little"
        )
        K[:2, 2] = middle
    lens = Lens(**{term: getattr(camera.lens, term) for term in lens_terms})
    if lens != camera.lens:
        lost.append(
            f"its lens distortion ({camera.lens.in_words()}), so give that program "
            "undistorted photos (photoreg undistort)"
        )
    if not lost:
        return camera, []
    if is_turned:
        turn = compensating_turn(camera, K)
        R, t = turn @ R, turn @ t
    reduced = Camera(K, R, t, camera.width, camera.height, lens)
    moved = largest_shift_px(camera, reduced)
    return reduced, [
        f"{name} loses {'; and '.join(lost)}: {program} has no place for it. Points "
        f"move by up to {moved:.2g} px."
    ]


def compensating_turn(
    camera: Camera, K: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "3 3"]:
    """The turn of the camera that keeps its pixels best once it has ``K``.

    Least squares over a grid of the photo's pixels; the camera centre stays.
    """
    pixels = _grid_px(camera)
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T

    def residuals(rotation_vector: np.ndarray) -> np.ndarray:
        turned = rays @ Rotation.from_rotvec(rotation_vector).as_matrix().T @ K.T
        return (turned[:, :2] / turned[:, 2:] - pixels).ravel()

    solved = scipy.optimize.least_squares(residuals, np.zeros(3), xtol=1e-15)
    return Rotation.from_rotvec(solved.x).as_matrix()


def largest_shift_px(camera: Camera, other: Camera) -> float:
    """How far a point of the photo moves, at most, from ``camera`` to ``other``.

    Both stand at the same place; over the points of a grid of the photo.
    """
    pixels = _grid_px(camera)
    center, directions = camera.rays(pixels)
    moved = other.project(center + directions * max(1.0, np.abs(center).max()))
    return float(np.nanmax(np.linalg.norm(moved - pixels, axis=1)))


def _grid_px(camera: Camera) -> Float[np.ndarray, "n 2"]:
    x = np.linspace(0.0, camera.width - 1.0, 9)
    y = np.linspace(0.0, camera.height - 1.0, 9)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
