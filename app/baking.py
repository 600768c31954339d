"""The textured model: baked, packed for download, and as GLB for the preview."""

import json
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from app.messages import Baked, Working
from app.placement import DisplayFrame
from photoreg.atlas import Atlas, make_atlas
from photoreg.camera import Camera
from photoreg.formats.textured import textured_download
from photoreg.mesh import Mesh
from photoreg.photo import Photo
from photoreg.texture import TexturedMesh, bake_texture

PREVIEW_SIDE_PX = 4096
"""Texels of the preview's longer side at most; software WebGL ends at 8192."""

PREVIEW_QUALITY = 90


class Baker:
    """Bakes textures; the charts of a mesh, which take the longest, are kept."""

    def __init__(self) -> None:
        self._mesh: Mesh | None = None
        self._atlas: Atlas | None = None

    def bake(
        self, mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
    ) -> Iterator[Working | Baked]:
        """Bakes, telling what goes on; the last event is the model."""
        if self._mesh is not mesh or self._atlas is None:
            yield Working("Unfolding the surface", 0.05)
            self._atlas = make_atlas(mesh)
            self._mesh = mesh
        yield Working("Painting the photos onto it", 0.4)
        textured = bake_texture(mesh, photos, cameras, atlas=self._atlas)
        yield Working("Packing the files", 0.8)
        archive = textured_download(f"{Path(mesh.name).stem or 'model'}.obj", textured)[
            1
        ]
        height, width = textured.texture.shape[:2]
        summary = (
            f"Texture of {width} × {height} px; the photos cover "
            f"{100 * textured.seen_share:.0f} % of the surface, the rest is filled from "
            "its neighbours."
        )
        glb = preview_glb(textured)
        yield Baked(archive, glb, tuple(cameras), summary)


def preview_glb(textured: TexturedMesh) -> bytes:
    """The model in page axes as a GLB file, with a JPEG texture, drawn without light.

    The photos hold the light of the place already; lit again they would look wrong.

    References:
        glTF 2.0 specification, section 4.4 (GLB), and KHR_materials_unlit.
    """
    atlas, frame = textured.atlas, DisplayFrame.of(textured.mesh)
    positions = frame.to_page(textured.mesh.vertices)[atlas.uv_vertex]
    positions = positions.astype("<f4")
    # glTF's v runs downwards.
    uv = np.column_stack([atlas.uv[:, 0], 1.0 - atlas.uv[:, 1]]).astype("<f4")
    indices = atlas.uv_faces.astype("<u4")
    parts = [
        positions.tobytes(),
        uv.tobytes(),
        indices.tobytes(),
        _texture_jpeg(textured.texture),
    ]
    body, views = bytearray(), []
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(part)})
        body += part + bytes(-len(part) % 4)
    document = {
        "asset": {"version": "2.0", "generator": "photoreg"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "primitives": [
                    {
                        "attributes": {"POSITION": 0, "TEXCOORD_0": 1},
                        "indices": 2,
                        "material": 0,
                    }
                ]
            }
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(positions),
                "type": "VEC3",
                "min": positions.min(axis=0).tolist(),
                "max": positions.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5126, "count": len(uv), "type": "VEC2"},
            {
                "bufferView": 2,
                "componentType": 5125,
                "count": indices.size,
                "type": "SCALAR",
            },
        ],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "metallicFactor": 0.0,
                    "roughnessFactor": 1.0,
                },
                "doubleSided": True,
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/jpeg"}],
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(body)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, length),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(body), b"BIN\0"),
            bytes(body),
        ]
    )


def _texture_jpeg(texture: np.ndarray) -> bytes:
    scale = PREVIEW_SIDE_PX / max(texture.shape[:2])
    if scale < 1.0:
        texture = cv2.resize(
            texture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
        )
    bgr = cv2.cvtColor(texture, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, PREVIEW_QUALITY])
    assert done
    return data.tobytes()
