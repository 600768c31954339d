"""Cameras and photos of tests of camera files: nothing symmetric, names not plain."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import CameraSet, Saved
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from photoreg.geometry.camera import Camera

PLACES = {
    "photoreg": "out.json",
    "colmap": "model",
    "colmap-text": "model",
    "nerfstudio": "transforms.json",
    "meshlab": "out.mlp",
    "texrecon": "scene",
    "opencv": "out.yml",
    "bundler": "bundle.out",
    "blender": "setup.py",
    "realityscan": "sidecars",
    "alicevision": "cameras.sfm",
}
"""Format to where a test writes it."""

NAMES = ("left view.png", "rechts Ä 写真.jpg", 'it\'s "over" 50% <&>.jpg')


def general_cameras(skew: float = 0.0) -> dict[str, Camera]:
    """Three cameras: landscape, portrait and nearly square; general poses.

    The principal points are 4 to 13 px off the middle, fx and fy differ by 1 to 6 per
    cent.
    """
    rng = np.random.default_rng(7)
    cameras = {}
    sizes = ((160, 97), (88, 131), (121, 120))
    for i, (name, (width, height)) in enumerate(zip(NAMES, sizes, strict=True)):
        fx = (1.7 + 0.2 * i) * width
        K = np.array(
            [
                [fx, skew, 0.5 * (width - 1) + 7.37 - 4 * i],
                [0.0, fx * (1.01 + 0.02 * i), 0.5 * (height - 1) - 9.81 + 7 * i],
                [0.0, 0.0, 1.0],
            ]
        )
        R = Rotation.from_rotvec([0.4 - 0.5 * i, 2.1 + 0.3 * i, -0.7]).as_matrix()
        t = np.array([0.2, -0.1 + 0.2 * i, 4.0 + i]) + 0.1 * rng.standard_normal(3)
        cameras[name] = Camera(K, R, t, width, height)
    return cameras


def write_photos(folder: Path, cameras: dict[str, Camera]) -> dict[str, Path]:
    """A photo of noise for each camera."""
    rng = np.random.default_rng(8)
    paths = {}
    for name, camera in cameras.items():
        paths[name] = folder / name
        pixels = rng.integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(paths[name])
    return paths


def camera_set(folder: Path, skew: float = 0.0) -> CameraSet:
    """The cameras with their photos in ``folder``."""
    cameras = general_cameras(skew)
    return CameraSet(cameras, write_photos(folder, cameras))


def points_before(camera: Camera, n: int = 200) -> np.ndarray:
    """World points (n, 3) at many depths, all over the photo."""
    rng = np.random.default_rng(9)
    pixels = rng.uniform(0.0, 1.0, (n, 2)) * [
        camera.width - 1,
        camera.height - 1,
    ]
    center, directions = camera.rays(pixels)
    return center + directions * rng.uniform(2.0, 9.0, (n, 1))


def largest_error_px(camera: Camera, other: Camera) -> float:
    """The largest distance of projections of points all over the photo."""
    points = points_before(camera)
    error = np.linalg.norm(other.project(points) - camera.project(points), axis=1)
    return float(error.max())


def write(tmp_path: Path, name: str, cameras: CameraSet) -> tuple[Path, Saved]:
    """Writes the cameras in the format ``name``; where, and what was said."""
    path = tmp_path / PLACES[name]
    return path, write_cameras(path, cameras, name)


def refused(path: Path, name: str | None = None, **more: Any) -> str:
    """The one sentence with which a camera file is refused."""
    with pytest.raises(InputError) as caught:
        read_cameras(path, name, **more)
    message = str(caught.value)
    assert "\n" not in message.strip(), message
    return message
