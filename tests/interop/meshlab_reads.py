"""Run by the tests in a process of its own: PyMeshLab loads a project.

Usage: meshlab_reads.py PROJECT SAVED.mlp [COLOURS.npz]; with the last, the photo is
projected onto the mesh, which needs OpenGL and a display.
"""

import importlib
import sys

import numpy as np

meshes = importlib.import_module("pymeshlab").MeshSet()
meshes.load_project(sys.argv[1])
if len(sys.argv) > 3:
    # With depth, so that the way through OpenGL is tested too.
    meshes.compute_color_from_current_raster_projection(usedepth=True)
    mesh = meshes.current_mesh()
    np.savez(
        sys.argv[3], colours=mesh.vertex_color_matrix(), vertices=mesh.vertex_matrix()
    )
meshes.save_project(sys.argv[2])
