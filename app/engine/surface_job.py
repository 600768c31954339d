"""The object with its photos, or their disagreement, laid on, a few times a second.

Each face takes the photo that sees it most squarely, at the place where the camera of
the moment puts it. That needs no unwrapping and no baking, and the seams between the
photos close as the cameras come right. The photos themselves are named by address: a
browser fetches them once.
"""

import json
import struct
from collections.abc import Sequence

import numpy as np

from app.model.camera_moves import DisplayFrame
from app.model.messages import SMALL_PX
from app.model.state import Surface
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.overlay.disagreement_map import CLAY, SurfaceSight, vertex_colours

FLOAT, UINT, USHORT = 5126, 5125, 5123
LINEAR, CLAMP_TO_EDGE = 9729, 33071
DTYPES = {FLOAT: "<f4", UINT: "<u4", USHORT: "<u2"}


class LiveSurface:
    """Draws the surface under changing cameras; what does not change is kept."""

    def __init__(
        self,
        mesh: Mesh,
        photos: Sequence[Photo],
        addresses: Sequence[str],
        frame: DisplayFrame,
    ) -> None:
        """Makes ready.

        Args:
            mesh: The surface in few faces: a browser must read them while the picture
                lasts.
            photos: The photos.
            addresses: Where a page finds them.
            frame: The page's, that of the whole mesh.
        """
        self._sight = SurfaceSight(mesh, photos, SMALL_PX)
        self._addresses = addresses
        shown = self._sight.mesh
        self._positions = frame.to_page(shown.vertices).astype("<f4")
        self._faces = shown.faces

    def glb(self, cameras: Sequence[Camera], surface: Surface) -> bytes:
        """The surface in page axes as a GLB file, drawn without light."""
        if surface == "photos":
            return self._with_photos(cameras)
        levels = self._sight.disagreement(cameras)
        return self._with_colours(vertex_colours(levels))

    def _with_photos(self, cameras: Sequence[Camera]) -> bytes:
        pixels, cosines = self._sight.look(cameras)
        # A face belongs to a photo that sees all its corners.
        squarely = cosines[:, self._faces].min(axis=2)
        choice = np.argmax(squarely, axis=0)
        choice[squarely.max(axis=0) <= 0.0] = -1
        file = GlbFile()
        position = file.array(self._positions, FLOAT, bounds=True)
        for i, photo in enumerate(self._sight.photos):
            faces = self._faces[choice == i]
            if len(faces) == 0:
                continue
            # glTF's (0, 0) is the corner of the first pixel, ours its centre.
            uv = (pixels[i] + 0.5) / (photo.width, photo.height)
            # Beyond the photo lie only vertices of faces that are not its.
            share = np.nan_to_num(np.clip(uv, 0.0, 1.0), nan=0.0)
            file.primitive(
                {"POSITION": position, "TEXCOORD_0": file.shares(share)},
                faces,
                file.textured(self._addresses[i]),
            )
        rest = self._faces[choice < 0]
        if len(rest):
            file.primitive({"POSITION": position}, rest, file.plain(CLAY))
        return file.content()

    def _with_colours(self, colours: np.ndarray) -> bytes:
        file = GlbFile()
        # Colours of vertices are linear in glTF.
        linear = (colours / 255.0) ** 2.2
        rgba = np.column_stack([linear, np.ones(len(linear))])
        file.primitive(
            {
                "POSITION": file.array(self._positions, FLOAT, bounds=True),
                "COLOR_0": file.array(rgba, FLOAT),
            },
            self._faces,
            file.plain((255, 255, 255)),
        )
        return file.content()


class GlbFile:
    """A binary glTF file of one mesh, put together part by part.

    References:
        glTF 2.0 specification, section 4.4 (GLB), and KHR_materials_unlit.
    """

    def __init__(self) -> None:
        self._body = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, object]] = []
        self._primitives: list[dict[str, object]] = []
        self._materials: list[dict[str, object]] = []
        self._images: list[dict[str, object]] = []

    def array(self, values: np.ndarray, kind: int, bounds: bool = False) -> int:
        """Adds an array (n,) or (n, k); returns its accessor."""
        plain = np.ascontiguousarray(values, DTYPES[kind])
        shape = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
        width = 1 if plain.ndim == 1 else plain.shape[1]
        accessor: dict[str, object] = {
            "bufferView": self._add(plain.tobytes()),
            "componentType": kind,
            "count": len(plain),
            "type": shape[width],
        }
        if bounds:
            accessor["min"] = plain.min(axis=0).tolist()
            accessor["max"] = plain.max(axis=0).tolist()
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def shares(self, values: np.ndarray) -> int:
        """Adds an array of values in [0, 1], to 1 / 65,535; returns its accessor."""
        accessor = self.array(np.rint(65535.0 * values), USHORT)
        self._accessors[accessor]["normalized"] = True
        return accessor

    def textured(self, address: str) -> int:
        """Adds a material that shows the picture at an address as it is."""
        self._images.append({"uri": address})
        texture = {"index": len(self._images) - 1}
        return self._material({"baseColorTexture": texture})

    def plain(self, colour: tuple[int, int, int]) -> int:
        """Adds a material of one sRGB colour."""
        linear = [*((value / 255.0) ** 2.2 for value in colour), 1.0]
        return self._material({"baseColorFactor": linear})

    def primitive(
        self, attributes: dict[str, int], faces: np.ndarray, material: int
    ) -> None:
        """Adds faces (m, 3) drawn with a material."""
        # The largest of 16 bits has a meaning of its own.
        kind = USHORT if faces.size == 0 or faces.max() < 65535 else UINT
        self._primitives.append(
            {
                "attributes": attributes,
                "indices": self.array(faces.ravel(), kind),
                "material": material,
            }
        )

    def content(self) -> bytes:
        """The file."""
        document: dict[str, object] = {
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
            document["textures"] = [
                {"source": i, "sampler": 0} for i in range(len(self._images))
            ]
            # Smaller copies would be made anew for each state of the surface.
            document["samplers"] = [
                {
                    "minFilter": LINEAR,
                    "magFilter": LINEAR,
                    "wrapS": CLAMP_TO_EDGE,
                    "wrapT": CLAMP_TO_EDGE,
                }
            ]
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + len(self._body)
        return b"".join(
            [
                struct.pack("<4sII", b"glTF", 2, length),
                struct.pack("<I4s", len(text), b"JSON"),
                text,
                struct.pack("<I4s", len(self._body), b"BIN\0"),
                bytes(self._body),
            ]
        )

    def _material(self, look: dict[str, object]) -> int:
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
