"""Solve a camera from pairs of points: pixels of a photo, and places on the mesh.

Here the pairs come from a known camera, with an error as of a click, so that the answer
can be compared with the truth.
"""

import numpy as np

from photoreg import load_cameras, load_mesh, projection_error
from photoreg.geometry.sampling import sample_surface
from photoreg.resection import solve_camera

mesh = load_mesh("shell.ply")
truth = load_cameras("cameras.json").cameras["shell-left.jpg"]
samples = sample_surface(mesh, 2000, 0)
facing = np.einsum("ij,ij->i", samples.normals, truth.center - samples.points) > 0.0
points = samples.points[facing][::100]  # About ten, all over the object.
clicks = np.random.default_rng(1).normal(truth.project(points), 1.0)

solved = solve_camera(points, clicks, truth.width, truth.height)
print(solved.summary)
error = projection_error(mesh, [truth], [solved.camera])
print(f"It is {error.mean:.1f} px from the true camera.")
