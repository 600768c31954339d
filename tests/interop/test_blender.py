"""Blender, by bpy in an environment of its own, runs our script and opens our GLB and OBJ.

bpy wants another numpy than ours: `make test-interop` keeps it in .venv/blender, and
PHOTOREG_BLENDER names another Python that has it.
"""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from photoreg.formats.cameras.registry import write_cameras
from photoreg.formats.models.glb import save_textured_glb
from photoreg.formats.models.obj import save_textured_obj
from photoreg.texture.bake import bake_texture
from photoreg.texture.config import TextureConfig
from tests.formats.camera_files import camera_set, points_before
from tests.painted import ball_and_moon, cameras_around, photograph

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
BLENDER = os.environ.get("PHOTOREG_BLENDER", str(ROOT / ".venv/blender/bin/python"))


def test_blender_projects_points_and_opens_the_model_as_photoreg_does(tmp_path):
    cameras = camera_set(tmp_path)
    write_cameras(tmp_path / "setup.py", cameras)
    points = {name: points_before(c) for name, c in cameras.cameras.items()}
    (tmp_path / "points.json").write_text(
        json.dumps({name: p.tolist() for name, p in points.items()}), encoding="utf-8"
    )
    mesh, views = ball_and_moon(1), cameras_around(2)
    photos = [photograph(mesh, c, f"{i}.png") for i, c in enumerate(views)]
    textured = bake_texture(mesh, photos, views, TextureConfig(size=256))
    save_textured_glb(tmp_path / "model.glb", textured)
    save_textured_obj(tmp_path / "model.obj", textured)

    reader = Path(__file__).with_name("blender_reads.py")
    files = [
        tmp_path / n for n in ("setup.py", "points.json", "model.glb", "model.obj")
    ]
    files.append(tmp_path / "out.json")
    done = subprocess.run(
        [BLENDER, str(reader), *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr + done.stdout
    found = json.loads(files[-1].read_text(encoding="utf-8"))
    for name, camera in cameras.cameras.items():
        read = found["cameras"][name]
        error = np.abs(np.array(read["pixels"]) - camera.project(points[name])).max()
        # Blender computes in single precision.
        assert error < 0.05, (name, error)
        assert read["photo"] == [camera.width, camera.height]

    for kind in ("glb", "obj"):
        model = found[kind]
        assert model["n_faces"] == len(textured.faces)
        assert model["texture"] == list(textured.texture.shape[1::-1])
        # Both are y up, and Blender turns them to its own z up: (x, y, z) to (x, -z, y).
        x, y, z = np.array(model["vertices"])[: len(textured.vertices)].T
        back = np.column_stack([x, z, -y])
        error = np.abs(back - textured.vertices).max()
        assert error < 1e-5, (kind, error)
        uv = np.array(model["uv"]).reshape(-1, 3, 2)
        error = np.abs(np.sort(uv, axis=1) - np.sort(textured.corner_uv, axis=1)).max()
        assert error < 1e-5, (kind, error)
