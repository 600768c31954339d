"""How long a texture takes and what memory, beside Open3D's projection of photos.

Each measurement is a process of its own, so that its peak of memory is its own:
`python -m tests.bench.texture FACES WIDTH HEIGHT SIZE` prints one as JSON.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.synthetic.rock import rock_mesh
from photoreg.texture.atlas import Atlas, make_atlas
from photoreg.texture.bake import bake_texture, baking
from photoreg.texture.config import TextureConfig
from tests.bench.metrics import Metric, Setting, bench
from tests.robustness.memory import peak_memory_gb

ROOT = Path(__file__).parents[2]
INTEROP = ROOT / ".venv" / "interop" / "bin" / "python"
"""The environment of `make test-interop`, which has Open3D."""
USUAL = (100_000, 4000, 3000, 4096)
LARGEST = (2_000_000, 8660, 5773, 8192)
"""Faces, width and height of two photos, texels on a side: 50 megapixels each."""


@bench
def texture(setting: Setting) -> Iterator[Metric]:
    """A usual model, the largest, and a usual one by Open3D on our coordinates."""
    del setting
    with tempfile.TemporaryDirectory(prefix="photoreg-") as folder:
        scene = Path(folder) / "scene.npz"
        yield from _figures("texture.usual", _measure(*USUAL, scene), 6.0, 4.0)
        if INTEROP.is_file():
            program = "tests.bench.open3d_texture"
            theirs = _run([str(INTEROP), "-m", program, str(scene)])
            note = "Open3D, project_images_to_albedo, the same mesh, UVs and cameras"
            for name, key, unit in (
                ("time", "bake_s", "s"),
                ("cpu", "bake_cpu_s", "s"),
                ("memory", "peak_gb", "GB"),
            ):
                yield Metric(
                    f"texture.open3d.{name}",
                    theirs[key],
                    unit,
                    "lower",
                    None,
                    1.0,
                    note,
                )
        else:
            print("No row of Open3D: `make test-interop` would install it.")
    yield from _figures("texture.largest", _measure(*LARGEST), 120.0, 12.0)


def _figures(
    name: str, found: dict[str, float], bar_s: float, bar_gb: float
) -> Iterator[Metric]:
    yield Metric(f"{name}.time", found["bake_s"], "s", "lower", bar_s, 1.0)
    yield Metric(f"{name}.cpu", found["bake_cpu_s"], "s", "lower", None, 1.0)
    yield Metric(f"{name}.unfolding", found["atlas_s"], "s", "lower", None, 1.0)
    yield Metric(
        f"{name}.memory", found["peak_gb"], "GB", "lower", bar_gb, 0.2, "of the process"
    )


def _measure(
    faces: int, width: int, height: int, size: int, scene: Path | None = None
) -> dict[str, float]:
    words = [str(n) for n in (faces, width, height, size)]
    extra = [] if scene is None else [str(scene)]
    return _run([sys.executable, "-m", "tests.bench.texture", *words, *extra])


def _run(command: list[str]) -> dict[str, float]:
    done = subprocess.run(
        command, cwd=ROOT, check=True, capture_output=True, text=True, env=os.environ
    )
    return json.loads(done.stdout.splitlines()[-1])


def scene_of(
    faces: int, width: int, height: int
) -> tuple[Mesh, list[Photo], list[Camera]]:
    """A rock of so many faces and two photos of noise; what they show does not matter."""
    subdivisions = int(np.ceil(np.log(faces / 20) / np.log(4)))
    mesh = rock_mesh(3, subdivisions).decimated(faces)
    rng = np.random.default_rng(5)
    cameras, photos = [], []
    for i, angle in enumerate((-0.2, 0.3)):
        center = mesh.centroid + 5.0 * np.array([np.cos(angle), np.sin(angle), 0.2])
        cameras.append(
            Camera.look_at(
                center, mesh.centroid, [0, 0, 1], 1.7 * height, width, height
            )
        )
        coarse = rng.integers(60, 200, (height // 8 + 1, width // 8 + 1, 3), np.uint8)
        pixels = np.repeat(np.repeat(coarse, 8, axis=0), 8, axis=1)
        photos.append(Photo(f"{i}.png", pixels[:height, :width].copy()))
    return mesh, photos, cameras


def once(faces: int, width: int, height: int, size: int, scene: str | None) -> None:
    """Bakes once, compiled before, and prints seconds and memory as JSON."""
    _warm_up()
    mesh, photos, cameras = scene_of(faces, width, height)
    began = time.perf_counter()
    atlas = make_atlas(mesh)
    atlas_s = time.perf_counter() - began
    if scene is not None:
        _save(Path(scene), mesh, photos, cameras, atlas, size)
    steps = []
    began, began_cpu = time.perf_counter(), time.process_time()
    for step in baking(mesh, photos, cameras, TextureConfig(size=size), atlas):
        spent = round(time.process_time() - began_cpu, 2)
        peak = round(peak_memory_gb(), 2)
        steps.append((getattr(step, "title", "done"), spent, peak))
    figures: dict[str, Any] = {
        "faces": len(mesh.faces),
        "charts_aspect": atlas.aspect,
        "atlas_s": atlas_s,
        "bake_s": time.perf_counter() - began,
        "bake_cpu_s": time.process_time() - began_cpu,
        "peak_gb": peak_memory_gb(),
        "cpu_s_and_peak_gb_before_step": steps,
    }
    print(json.dumps(figures))


def _warm_up() -> None:
    mesh, photos, cameras = scene_of(1280, 320, 240)
    bake_texture(mesh, photos, cameras, TextureConfig(size=256))


def _save(
    path: Path,
    mesh: Mesh,
    photos: list[Photo],
    cameras: list[Camera],
    atlas: Atlas,
    size: int,
) -> None:
    np.savez(
        path,
        vertices=mesh.vertices,
        faces=mesh.faces,
        corner_uv=atlas.uv[atlas.uv_faces],
        photos=np.stack([photo.pixels for photo in photos]),
        K=np.stack([camera.K for camera in cameras]),
        R=np.stack([camera.R_cam_world for camera in cameras]),
        t=np.stack([camera.t_cam_world for camera in cameras]),
        size=size,
    )


if __name__ == "__main__":
    n_faces, photo_width, photo_height, side = map(int, sys.argv[1:5])
    npz = sys.argv[5] if len(sys.argv) > 5 else None
    once(n_faces, photo_width, photo_height, side, npz)
