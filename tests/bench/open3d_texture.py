"""Run by the bench in a process of its own: Open3D lays the same photos onto a mesh.

Usage: python -m tests.bench.open3d_texture SCENE.npz; prints seconds and memory as JSON.
"""

import importlib
import json
import sys
import time

import numpy as np

from tests.robustness.memory import peak_memory_gb

o3d = importlib.import_module("open3d")
scene = np.load(sys.argv[1])
mesh = o3d.t.geometry.TriangleMesh(
    o3d.core.Tensor(scene["vertices"].astype(np.float32)),
    o3d.core.Tensor(scene["faces"].astype(np.int64)),
)
mesh.triangle.texture_uvs = o3d.core.Tensor(scene["corner_uv"].astype(np.float32))
poses = []
for R, t in zip(scene["R"], scene["t"], strict=True):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, t
    poses.append(o3d.core.Tensor(pose))
photos = [o3d.t.geometry.Image(np.ascontiguousarray(p)) for p in scene["photos"]]
lenses = [o3d.core.Tensor(K) for K in scene["K"]]
began, began_cpu = time.perf_counter(), time.process_time()
mesh.project_images_to_albedo(photos, lenses, poses, int(scene["size"]))
seconds, cpu_s = time.perf_counter() - began, time.process_time() - began_cpu
figures = {"bake_s": seconds, "bake_cpu_s": cpu_s, "peak_gb": peak_memory_gb()}
print(json.dumps(figures))
