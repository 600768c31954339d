"""One refinement in a process of its own: `python -m tests.bench.probe TASK`.

Prints cameras to the last bit, time and peak memory as one line of JSON.
"""

import dataclasses
import json
import sys
from typing import Any

import cv2
import numba as nb
import numpy as np
import trimesh

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.registration.config import RegistrationConfig
from tests.bench.outcomes import Outcome, run
from tests.bench.worlds import World, world
from tests.robustness.memory import peak_memory_gb

SCALED_FROM = 1500
"""Large photos are drawn at this width and enlarged: the renderer is not what is
measured, and draws 24 million pixels in minutes."""


def main(task: dict[str, Any]) -> dict[str, Any]:
    """Makes the scene, refines it once to compile on a small one, then for real."""
    settings = task.get("settings", {})
    if "threads" in task:
        nb.set_num_threads(task["threads"])
    small = world(task["kind"], 0)
    _refined(small)
    scene = small
    if settings:
        ratio = settings["width"] / SCALED_FROM
        drawn = {
            "width": SCALED_FROM,
            "height": round(settings["height"] / ratio),
            "error_px": (22.0, 36.0),
        }
        scene = _enlarged(world(task["kind"], 0, **drawn), ratio)
    mesh = _with_faces(scene.mesh, task.get("n_faces", 0))
    scene = dataclasses.replace(scene, mesh=mesh, true_mesh=mesh)
    outcome = _refined(scene)
    return {
        "elapsed_s": outcome.elapsed_s,
        "cpu_s": outcome.cpu_s,
        "start_px": outcome.start_px,
        "end_px": outcome.end_px,
        "phases": {
            phase: round(seconds, 2)
            for phase, seconds in outcome.finished.seconds_by_phase.items()
        },
        "peak_gb": peak_memory_gb(),
        "n_faces": len(mesh.faces),
        "cameras": [_bits(camera) for camera in outcome.finished.cameras],
    }


def _refined(scene: World) -> Outcome:
    return run(
        scene.mesh,
        scene.photos,
        scene.cameras,
        scene.rough_cameras,
        RegistrationConfig.preset("default", seed=scene.seed),
    )


def _bits(camera: Camera) -> str:
    parts = (camera.K, camera.R_cam_world, camera.t_cam_world)
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts).hex()


def _enlarged(scene: World, ratio: float) -> World:
    width, height = (
        round(side * ratio) for side in scene.photos[0].pixels.shape[1::-1]
    )
    return dataclasses.replace(
        scene,
        photos=tuple(
            Photo(
                photo.name,
                cv2.resize(
                    photo.pixels, (width, height), interpolation=cv2.INTER_CUBIC
                ),
            )
            for photo in scene.photos
        ),
        cameras=tuple(camera.resized(width, height) for camera in scene.cameras),
        rough_cameras=tuple(
            camera.resized(width, height) for camera in scene.rough_cameras
        ),
    )


def _with_faces(mesh: Mesh, n_faces: int) -> Mesh:
    """The same surface in just about ``n_faces`` faces, if it has fewer."""
    vertices, faces = mesh.vertices, mesh.faces
    while 4 * len(faces) <= n_faces:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)[:2]
    n_split = (n_faces - len(faces)) // 2
    if n_split <= 0:
        return dataclasses.replace(mesh, vertices=vertices, faces=faces)
    # Each face that is split at its middle becomes three.
    split, whole = faces[:n_split], faces[n_split:]
    middles = vertices[split].mean(axis=1)
    middle = np.arange(len(vertices), len(vertices) + n_split)
    a, b, c = split.T
    parts = [(a, b, middle), (b, c, middle), (c, a, middle)]
    return dataclasses.replace(
        mesh,
        vertices=np.concatenate([vertices, middles]),
        faces=np.concatenate([*(np.column_stack(part) for part in parts), whole]),
    )


if __name__ == "__main__":
    print(json.dumps(main(json.loads(sys.argv[1]))))
