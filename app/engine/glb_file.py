"""The GLB files that the page shows: drawn without light, small, quick to make."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from photoreg.formats.glb_container import glb_file

FLOAT, UINT, USHORT = 5126, 5125, 5123
LINEAR, CLAMP_TO_EDGE = 9729, 33071
DTYPES = {FLOAT: "<f4", UINT: "<u4", USHORT: "<u2"}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class GlbFile:
    """A binary glTF file of one mesh, put together part by part.

    trimesh, which writes the models that are exported, takes no picture by its address
    and no 16-bit coordinates, and rounds linear colours to bytes; a live surface of
    that kind would be nearly twice as large, several times a second.

    References:
        Khronos Group, glTF 2.0 Specification, 2021, and KHR_materials_unlit.
    """

    def __init__(self) -> None:
        self._body = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []
        self._primitives: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._textures: list[dict[str, int]] = []
        self._images: list[dict[str, Any]] = []

    def positions(self, places: Float[np.ndarray, "n 3"]) -> int:
        """Adds vertices; returns their accessor."""
        values = np.asarray(places, DTYPES[FLOAT])
        number = self._array(values, FLOAT)
        self._accessors[number]["min"] = values.min(axis=0).tolist()
        self._accessors[number]["max"] = values.max(axis=0).tolist()
        return number

    def floats(self, values: Float[np.ndarray, "n k"]) -> int:
        """Adds rows of numbers; returns their accessor."""
        return self._array(values, FLOAT)

    def shares(self, values: Float[np.ndarray, "n k"]) -> int:
        """Adds rows of numbers in [0, 1], to 1 / 65,535; returns their accessor."""
        accessor = self._array(np.rint(65535.0 * values), USHORT)
        self._accessors[accessor]["normalized"] = True
        return accessor

    def picture_at(self, address: str) -> int:
        """Adds a material that shows the picture at an address as it is."""
        # Smaller copies would be made anew for each state of the surface.
        return self._textured({"uri": address}, {"sampler": 0})

    def picture(self, jpeg: bytes) -> int:
        """Adds a material that shows a picture as it is; the picture goes in."""
        return self._textured(
            {"bufferView": self._add(jpeg), "mimeType": "image/jpeg"}, {}
        )

    def plain(self, colour: tuple[int, int, int]) -> int:
        """Adds a material of one sRGB colour."""
        linear = [*((value / 255.0) ** 2.2 for value in colour), 1.0]
        return self._material({"baseColorFactor": linear})

    def primitive(
        self, attributes: dict[str, int], faces: Int[np.ndarray, "m 3"], material: int
    ) -> None:
        """Adds faces drawn with a material."""
        # The largest of 16 bits has a meaning of its own.
        kind = USHORT if faces.size == 0 or faces.max() < 65535 else UINT
        self._primitives.append(
            {
                "attributes": attributes,
                "indices": self._array(faces.ravel(), kind),
                "material": material,
            }
        )

    def content(self) -> bytes:
        """The file."""
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "photoreg"},
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": self._primitives}],
            "accessors": self._accessors,
            "materials": self._materials,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._body)}],
        }
        if self._images:
            document["images"] = self._images
            document["textures"] = self._textures
            document["samplers"] = [
                {
                    "minFilter": LINEAR,
                    "magFilter": LINEAR,
                    "wrapS": CLAMP_TO_EDGE,
                    "wrapT": CLAMP_TO_EDGE,
                }
            ]
        return glb_file(document, bytes(self._body))

    def _array(self, values: np.ndarray, kind: int) -> int:
        plain = np.ascontiguousarray(values, DTYPES[kind])
        self._accessors.append(
            {
                "bufferView": self._add(plain.tobytes()),
                "componentType": kind,
                "count": len(plain),
                "type": SHAPES[1 if plain.ndim == 1 else plain.shape[1]],
            }
        )
        return len(self._accessors) - 1

    def _textured(self, image: dict[str, Any], sampler: dict[str, int]) -> int:
        self._textures.append({"source": len(self._images), **sampler})
        self._images.append(image)
        return self._material({"baseColorTexture": {"index": len(self._textures) - 1}})

    def _material(self, look: dict[str, Any]) -> int:
        self._materials.append(
            {
                "pbrMetallicRoughness": {
                    **look,
                    "metallicFactor": 0.0,
                    "roughnessFactor": 1.0,
                },
                "doubleSided": True,
                "extensions": {"KHR_materials_unlit": {}},
            }
        )
        return len(self._materials) - 1

    def _add(self, part: bytes) -> int:
        self._views.append(
            {"buffer": 0, "byteOffset": len(self._body), "byteLength": len(part)}
        )
        self._body += part + bytes(-len(part) % 4)
        return len(self._views) - 1
