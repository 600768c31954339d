"""MeshLab, by PyMeshLab, reads our projects as we mean them, and we read its own."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from photoreg.geometry.camera import Camera
from tests.formats.camera_files import camera_set, largest_error_px

pytestmark = pytest.mark.slow

READER = Path(__file__).with_name("meshlab_reads.py")


def run(*words: Path) -> None:
    """Runs the reader, under a virtual display where there is none."""
    command = [sys.executable, str(READER), *map(str, words)]
    if len(words) > 2 and "DISPLAY" not in os.environ:
        command = ["xvfb-run", "-a", *command]
    done = subprocess.run(
        command, env=environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (
        f"{done.stderr}\nThe Makefile names the libraries that MeshLab's OpenGL needs."
    )


def environment() -> dict[str, str]:
    """With Qt's platform plugins, which PyMeshLab looks for but does not bring."""
    plugins = Path(sysconfig.get_path("purelib")) / "PyQt5" / "Qt5" / "plugins"
    paths = {
        "QT_PLUGIN_PATH": str(plugins),
        "QT_QPA_PLATFORM_PLUGIN_PATH": str(plugins / "platforms"),
    }
    return {**(paths if plugins.is_dir() else {}), **os.environ}


def test_what_meshlab_makes_of_a_project_and_saves_is_read(tmp_path):
    cameras = camera_set(tmp_path)
    write_cameras(tmp_path / "a.mlp", cameras)
    run(tmp_path / "a.mlp", tmp_path / "b.mlp")
    ours = read_cameras(tmp_path / "a.mlp").cameras
    theirs = read_cameras(tmp_path / "b.mlp").cameras
    assert set(theirs) == set(cameras.cameras)
    for name, camera in cameras.cameras.items():
        # MeshLab writes six digits.
        error = largest_error_px(ours[name], theirs[name])
        assert error < 0.005, (name, error)
        error = largest_error_px(camera, theirs[name])
        assert error < 0.05, (name, error)


@pytest.mark.skipif(
    "DISPLAY" not in os.environ and shutil.which("xvfb-run") is None,
    reason="MeshLab projects photos with OpenGL: needs a display or xvfb-run",
)
def test_meshlab_projects_surface_points_where_photoreg_does(tmp_path):
    """Each pixel's colour is its place; nearest pixels show a bias of hundredths."""
    width, height = 481, 360
    camera = Camera.look_at(
        [3, 1.2, 0.7], [0.1, 0, 0], [0.1, 0.05, 1], 700, width, height
    )
    K = camera.K + np.array([[0, 0, 23.37], [0, 21, -11.81], [0, 0, 0]])
    camera = Camera(K, camera.R_cam_world, camera.t_cam_world, width, height)
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    place = np.stack([x % 256, y % 256, x // 256 + 2 * (y // 256)], axis=-1)
    photo, mesh = tmp_path / "fötö 1.png", tmp_path / "mesh.ply"
    Image.fromarray(place.astype(np.uint8)).save(photo)
    trimesh.creation.icosphere(subdivisions=6).export(mesh)
    cameras = CameraSet({photo.name: camera}, {photo.name: photo}, mesh)
    write_cameras(tmp_path / "a.mlp", cameras)
    run(tmp_path / "a.mlp", tmp_path / "b.mlp", tmp_path / "c.npz")

    found = np.load(tmp_path / "c.npz")
    vertices, colours = found["vertices"], np.rint(255 * found["colours"]).astype(int)
    towards = camera.center - vertices
    cosine = (vertices * towards).sum(1) / np.linalg.norm(towards, axis=1)
    truth = camera.project(vertices)
    facing = (cosine > 0.15) & camera.contains(truth)
    coloured = facing & (colours[:, :3].sum(axis=1) > 0)
    # Its depth test agrees: a camera read wrong loses a fifth of the surface.
    share = coloured.sum() / facing.sum()
    assert share > 0.98, share
    column = colours[:, 0] + 256 * (colours[:, 2] % 2)
    row = colours[:, 1] + 256 * (colours[:, 2] // 2)
    error = (np.column_stack([column, row]) - truth)[coloured]
    assert np.abs(error).max() < 0.55, np.abs(error).max()
    bias = np.abs(error.mean(axis=0)).max()
    # The mean of some 9,000 roundings to the pixel is good to 0.003 px.
    assert bias < 0.02, bias
