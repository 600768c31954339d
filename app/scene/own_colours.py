"""The colours that a scan came with, as a model for the page."""

import numpy as np
from jaxtyping import UInt8
from scipy.spatial import KDTree

from app.engine.glb_file import GlbFile
from app.model.camera_moves import DisplayFrame
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.colour import LINEAR_OF_BYTE
from photoreg.imaging.encoding import encode_jpeg

TEXTURE_SIDE_PX = 4096
"""Texels of the longer side at most; software WebGL ends at 8192."""
QUALITY = 88


def has_own_colours(mesh: Mesh) -> bool:
    """Whether the scan's file had a texture or colours at its vertices."""
    has_texture = mesh.own_texture is not None and mesh.corner_uv is not None
    return has_texture or mesh.vertex_colours is not None


def own_colours_glb(mesh: Mesh, display: Mesh, frame: DisplayFrame) -> bytes:
    """The mesh with its own colours in page axes, a GLB file, drawn without light.

    Args:
        mesh: The scan; it has colours.
        display: The scan as it is drawn: itself, or thinned. A thinned one has no
            texture coordinates, and is coloured at its vertices.
        frame: The page's axes.
    """
    file = GlbFile()
    texture, uv = mesh.own_texture, mesh.corner_uv
    if display is mesh and texture is not None and uv is not None:
        corners = frame.to_page(mesh.vertices)[mesh.faces].reshape(-1, 3)
        flat = uv.reshape(-1, 2)
        attributes = {
            "POSITION": file.positions(corners),
            # glTF's v runs downwards.
            "TEXCOORD_0": file.floats(np.column_stack([flat[:, 0], 1.0 - flat[:, 1]])),
        }
        material = file.picture(encode_jpeg(texture, QUALITY, TEXTURE_SIDE_PX))
        faces = np.arange(len(corners)).reshape(-1, 3)
    else:
        colours = _at_vertices(mesh)
        if display is not mesh:
            colours = colours[KDTree(mesh.vertices).query(display.vertices)[1]]
        linear = LINEAR_OF_BYTE[colours]
        attributes = {
            "POSITION": file.positions(frame.to_page(display.vertices)),
            "COLOR_0": file.shares(np.column_stack([linear, np.ones(len(linear))])),
        }
        material, faces = file.plain((255, 255, 255)), display.faces
    file.primitive(attributes, faces, material)
    return file.content()


def _at_vertices(mesh: Mesh) -> UInt8[np.ndarray, "n 3"]:
    """A colour for each vertex: its own, or that of the texture at one of its corners."""
    if mesh.own_texture is None or mesh.corner_uv is None:
        assert mesh.vertex_colours is not None
        return mesh.vertex_colours
    height, width = mesh.own_texture.shape[:2]
    u, v = (mesh.corner_uv.reshape(-1, 2) % 1.0).T
    column = np.minimum((u * width).astype(int), width - 1)
    row = np.minimum(((1.0 - v) * height).astype(int), height - 1)
    colours = np.full((len(mesh.vertices), 3), 128, np.uint8)
    colours[mesh.faces.ravel()] = mesh.own_texture[row, column]
    return colours
