"""The textured model: baked step by step, packed for download, and previewed."""

import json
import struct
from collections.abc import Generator, Sequence
from pathlib import Path

import cv2
import numpy as np

from app.model.camera_moves import DisplayFrame
from app.model.messages import Baked, Download, Working
from app.model.state import ModelChoice, Texture
from photoreg.errors import InputError
from photoreg.formats.models.registry import textured_download
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.texture.atlas import Atlas, make_atlas
from photoreg.texture.bake import BakingStep, TexturedMesh, baking
from photoreg.texture.blend import TextureConfig

PREVIEW_SIDE_PX = 4096
"""Texels of the preview's longer side at most; software WebGL ends at 8192."""

PREVIEW_QUALITY = 90
COVERAGE_SIDE_PX = 560
"""Twice the width of the panel, for screens of fine pixels."""


class BakeJob:
    """Bakes textures; keeps the last, and the charts of the mesh, which take longest."""

    def __init__(self) -> None:
        self._mesh: Mesh | None = None
        self._keep_uv = True
        self._atlas: Atlas | None = None
        self._textured: TexturedMesh | None = None

    def bake(
        self,
        mesh: Mesh,
        photos: Sequence[Photo],
        cameras: Sequence[Camera],
        config: TextureConfig | None = None,
    ) -> Generator[Working | Baked]:
        """Bakes, telling what comes next; the last event is the model.

        Whoever stops iterating ends it; the model made before is then still there.
        """
        config = config or TextureConfig()
        made_for = self._mesh, self._keep_uv
        if self._atlas is None or made_for != (mesh, config.keep_uv):
            yield Working("Unfolding the surface", 0.02)
            self._atlas = make_atlas(mesh, config.keep_uv)
            self._mesh, self._keep_uv = mesh, config.keep_uv
        for step in baking(mesh, photos, cameras, config, self._atlas):
            if isinstance(step, BakingStep):
                yield Working(step.title, step.fraction)
            else:
                yield Working("Making the preview", 0.95)
                self._textured = step
                yield Baked(_texture(step, photos, cameras, config))

    def pack(self, choice: ModelChoice) -> Download:
        """The model made last as one file for download.

        Raises:
            InputError: if there is none, as after the process was started again.
        """
        textured = self._textured
        if textured is None:
            raise InputError(
                "The engine was started again since the texture was made. Make it anew."
            )
        at_vertices = choice.format == "coloured ply"
        suffix = ".ply" if at_vertices else f".{choice.format}"
        name = f"{Path(textured.mesh.name).stem or 'model'}{suffix}"
        return Download(*textured_download(name, textured, at_vertices, choice.picture))


def _texture(
    textured: TexturedMesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: TextureConfig,
) -> Texture:
    height, width = textured.texture.shape[:2]
    filled = {
        "diffuse": "filled from its neighbours",
        "colour": "in the colour chosen",
        "own": "in the model's own colours",
    }[config.unseen]
    summary = (
        f"Texture of {width} × {height} px, {textured.layout_in_words}. The photos cover "
        f"{100 * textured.seen_share:.0f} % of the surface; the rest is {filled}."
    )
    coverage = tuple(
        (photo.name, share, colour)
        for photo, share, colour in zip(
            photos, textured.seen_share_by_photo, textured.coverage_colours, strict=True
        )
    )
    picture = _jpeg(textured.coverage_picture(), COVERAGE_SIDE_PX)
    return Texture(
        preview_glb(textured), tuple(cameras), config, summary, picture, coverage
    )


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
        _jpeg(textured.texture, PREVIEW_SIDE_PX),
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


def _jpeg(picture: np.ndarray, max_side_px: int) -> bytes:
    scale = max_side_px / max(picture.shape[:2])
    if scale < 1.0:
        picture = cv2.resize(
            picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
        )
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, PREVIEW_QUALITY])
    assert done
    return data.tobytes()
