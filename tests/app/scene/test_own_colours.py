"""The colours that a scan came with, as the page shows them."""

import dataclasses
import io
from typing import Any

import numpy as np
import pytest
import trimesh

from app.model.camera_moves import DisplayFrame
from app.scene.own_colours import has_own_colours, own_colours_glb
from photoreg.formats.meshes.read import load_mesh
from photoreg.geometry.mesh import Mesh
from photoreg.synthetic.rock import rock_mesh


@pytest.fixture
def coloured() -> Mesh:
    """Red where x is large, blue where it is small; the texture says the same."""
    mesh = rock_mesh(1, subdivisions=4)
    share = (mesh.vertices[:, 0] - mesh.bounds[0, 0]) / np.ptp(mesh.bounds[:, 0])
    ramp = np.linspace(0.0, 255.0, 256)
    texture = np.stack([ramp, 0.0 * ramp, 255.0 - ramp], axis=1)[None].repeat(4, axis=0)
    uv = np.stack([share[mesh.faces], np.full(mesh.faces.shape, 0.5)], axis=2)
    return dataclasses.replace(
        mesh, own_texture=texture.astype(np.uint8), corner_uv=np.clip(uv, 0.002, 0.998)
    )


def loaded(mesh: Mesh, display: Mesh) -> Any:
    glb = own_colours_glb(mesh, display, DisplayFrame.of(mesh))
    return trimesh.load(io.BytesIO(glb), file_type="glb", force="mesh", process=False)


def test_a_scan_that_is_drawn_whole_wears_its_texture(coloured):
    shown = loaded(coloured, coloured)
    assert len(shown.faces) == len(coloured.faces)
    picture = np.asarray(shown.visual.material.baseColorTexture.convert("RGB"))
    assert picture.shape == (4, 256, 3)
    places = np.clip((np.asarray(shown.visual.uv)[:, 0] * 256).astype(int), 0, 255)
    red = picture[2, places, 0].astype(float)
    assert np.corrcoef(red, shown.vertices[:, 0])[0, 1] > 0.99


@pytest.mark.parametrize("by_vertex", [False, True])
def test_a_thinned_scan_is_coloured_at_its_vertices(coloured, by_vertex, tmp_path):
    if by_vertex:
        share = np.ptp(coloured.bounds[:, 0])
        red = 255.0 * (coloured.vertices[:, 0] - coloured.bounds[0, 0]) / share
        colours = np.stack([red, 0.0 * red, 255.0 - red], axis=1).astype(np.uint8)
        coloured = dataclasses.replace(
            coloured, own_texture=None, corner_uv=None, vertex_colours=colours
        )
    thin = coloured.decimated(600)
    path = tmp_path / "shown.glb"
    path.write_bytes(own_colours_glb(coloured, thin, DisplayFrame.of(coloured)))
    shown = load_mesh(path)
    assert len(shown.faces) == len(thin.faces) < len(coloured.faces)
    assert shown.vertex_colours is not None
    red = shown.vertex_colours[:, 0].astype(float)
    assert np.corrcoef(red, shown.vertices[:, 0])[0, 1] > 0.98
    assert red.min() < 40.0 < 215.0 < red.max()


def test_a_scan_without_colours_has_none():
    assert not has_own_colours(rock_mesh(1, subdivisions=2))
