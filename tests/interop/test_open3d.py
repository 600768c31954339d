"""Open3D reads our OBJ, GLB and PLY."""

import importlib
from typing import Any

import numpy as np
import pytest

from photoreg.formats.models.ply import save_coloured_ply
from photoreg.formats.models.registry import save_textured
from photoreg.formats.models.split_vertices import vertex_colours
from photoreg.texture.bake import TexturedMesh, bake_texture
from photoreg.texture.config import TextureConfig
from tests.painted import ball_and_moon, cameras_around, photograph

pytestmark = pytest.mark.slow


@pytest.fixture
def open3d() -> Any:
    return importlib.import_module("open3d")


@pytest.fixture(scope="module")
def textured() -> TexturedMesh:
    mesh, cameras = ball_and_moon(1), cameras_around(2)
    photos = [photograph(mesh, c, f"{i}.png") for i, c in enumerate(cameras)]
    return bake_texture(mesh, photos, cameras, TextureConfig(size=256))


@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_open3d_finds_surface_coordinates_and_texture(
    tmp_path, open3d, textured, suffix
):
    path = save_textured(tmp_path / f"model{suffix}", textured)[0]
    read = open3d.io.read_triangle_mesh(str(path), enable_post_processing=False)
    vertices, faces = np.asarray(read.vertices), np.asarray(read.triangles)
    corners = textured.vertices[textured.faces]
    error = np.abs(vertices[faces] - corners).max()
    assert error < 1e-5, error
    uv = np.asarray(read.triangle_uvs).reshape(-1, 3, 2)
    error = np.abs(uv - textured.corner_uv).max()
    assert error < 1e-5, error


def test_open3d_reads_colours_and_normals_at_the_vertices(tmp_path, open3d, textured):
    (path,) = save_coloured_ply(tmp_path / "model.ply", textured)
    read = open3d.io.read_triangle_mesh(str(path))
    np.testing.assert_array_equal(np.asarray(read.vertices), textured.vertices)
    np.testing.assert_array_equal(np.asarray(read.triangles), textured.faces)
    colours = np.rint(255 * np.asarray(read.vertex_colors))
    np.testing.assert_array_equal(colours, vertex_colours(textured))
    error = np.abs(np.asarray(read.vertex_normals) - textured.mesh.vertex_normals).max()
    assert error < 1e-6, error
