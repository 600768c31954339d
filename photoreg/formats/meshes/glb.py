"""GLB (binary glTF 2.0): made plain, so that trimesh reads it right.

trimesh takes node transforms, materials and Draco (by DracoPy), but not normalised
integers, sparse accessors, texture transforms or a second set of texture coordinates,
and it takes colours, which are linear, for sRGB. What it does not take is worked in
here before, or the file is refused.

References:
    Khronos Group, glTF 2.0 Specification, 2021 (sections 3.6 to 3.9), and
    KHR_mesh_quantization, KHR_texture_transform.
"""

import importlib.util
import io
import json
import struct
import urllib.parse
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image
from trimesh.resolvers import FilePathResolver

from photoreg.errors import InputError
from photoreg.formats.glb_container import BINARY_CHUNK, glb_file
from photoreg.formats.meshes.beside import find_beside
from photoreg.formats.meshes.contents import MeshContents, Picture
from photoreg.formats.meshes.headers import check_counts
from photoreg.limits import Limits
from photoreg.sources import read_regular
from photoreg.words import listed

_TYPES = {
    5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32,
    5126: np.float32,
}  # fmt: skip
_WIDTHS = {
    "SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16
}  # fmt: skip
_TRIANGLES, _STRIP, _FAN = 4, 5, 6

_READ = ("KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp")
_OF_LIGHT = (
    "KHR_materials_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_xmp",
    "MSFT_texture_dds",
)
"""Extensions that say how the surface shines; its place and colours are the same."""
_CHANGES_GEOMETRY = {
    "EXT_mesh_gpu_instancing": "repeats meshes (instancing); apply the instances",
    "EXT_meshopt_compression": "is compressed by meshopt; export it without, or convert "
    "it with: gltf-transform copy IN.glb OUT.glb",
    "KHR_meshopt_compression": "is compressed by meshopt; export it without, or convert "
    "it with: gltf-transform copy IN.glb OUT.glb",
    "KHR_gaussian_splatting": "holds splats, not a surface; export a mesh",
    "CESIUM_RTC": "is placed relative to a centre of its own (CESIUM_RTC); apply it",
}
_NEVER_OPTIONAL = ("EXT_mesh_gpu_instancing", "CESIUM_RTC")
"""Of these, those that change geometry also where the file does not require them."""
_WITH_A_FALLBACK = (
    "KHR_draco_mesh_compression",
    "KHR_texture_basisu",
    "EXT_texture_avif",
)
"""Extensions beside which a file that does not require them holds what plain readers want."""


def read_glb(path: Path, limits: Limits) -> MeshContents:
    """Reads the default scene of a GLB file as one mesh, in the axes of the scene.

    Raises:
        InputError: if it needs what is not read, or is damaged.
    """
    document, body = _chunks(path)
    _check_features(path.name, document)
    plain = _Plain(path.name, document, body)
    notes = [*_left_out(document), *plain.make()]
    beside = _Beside(path, limits)
    scene: Any = trimesh.load_scene(
        io.BytesIO(plain.file()), file_type="glb", resolver=beside, process=False
    )
    # trimesh passes over pictures that it does not get.
    notes += dict.fromkeys(beside.notes)
    return _contents(path.name, scene, limits, notes)


class _Beside(FilePathResolver):
    """Buffers and pictures that a file names, from its folder only."""

    def __init__(self, path: Path, limits: Limits) -> None:
        super().__init__(str(path))
        self._path, self._limits = path, limits
        self.notes: list[str] = []
        """A sentence for each file that was asked for and is not read."""

    def get(self, name: str) -> bytes:
        """The content of a file beside the mesh."""
        # A URI's %20 is a space, but not every program writes URIs.
        plain = urllib.parse.unquote(name)
        found, note = find_beside(self._path, plain, "file", self._limits)
        if found is None:
            found, _ = find_beside(self._path, name, "file", self._limits)
        if found is None:
            self.notes.append(note)
            raise InputError(note)
        return read_regular(found)


def _chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    content = read_regular(path)
    json_length = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20 : 20 + json_length])
    at = 20 + json_length
    if len(content) < at + 8:
        return document, b""
    length, kind = struct.unpack_from("<II", content, at)
    return document, content[at + 8 : at + 8 + length] if kind == BINARY_CHUNK else b""


def _check_features(name: str, document: dict[str, Any]) -> None:
    required = document.get("extensionsRequired", [])
    used = [*required, *document.get("extensionsUsed", [])]
    for extension, what in _CHANGES_GEOMETRY.items():
        is_meant = extension in (used if extension in _NEVER_OPTIONAL else required)
        if is_meant:
            raise InputError(f"{name} {what} in the program that made it.")
    for extension in required:
        is_draco = extension == "KHR_draco_mesh_compression"
        if is_draco and importlib.util.find_spec("DracoPy") is None:
            raise InputError(
                f"{name} is compressed by Draco. Install photoreg with its extra "
                "`draco`, or export it without compression."
            )
        is_known = extension in _READ or str(extension).startswith(_OF_LIGHT)
        if not is_known and not is_draco:
            raise InputError(
                f"{name} requires the glTF extension {extension!s:.60}, which photoreg "
                "does not read. Export it without, as plain GLB."
            )
    if any("skin" in node for node in document.get("nodes", [])):
        raise InputError(
            f"{name} is posed by a skeleton (skin). Apply the pose in the program that "
            "made it, and export it again without."
        )
    # A node's weights stand in for its mesh's.
    for formed in (*document.get("meshes", []), *document.get("nodes", [])):
        if any(formed.get("weights", [])):
            raise InputError(
                f"{name} is formed by morph targets. Apply them in the program that "
                "made it, and export it again without."
            )


def _left_out(document: dict[str, Any]) -> list[str]:
    """What a document says of place and colours that is not read, a sentence each."""
    notes = []
    unread = [
        str(extension)[:60]
        for extension in document.get("extensionsUsed", [])
        if extension not in (*_READ, *_CHANGES_GEOMETRY, *_WITH_A_FALLBACK)
        and not str(extension).startswith(_OF_LIGHT)
    ]
    if unread:
        notes.append(f"It uses {listed(unread)} of glTF, which photoreg does not read.")
    factors = set()
    for material in document.get("materials", []):
        colour = material.get("pbrMetallicRoughness", {})
        factor = tuple(colour.get("baseColorFactor", (1.0, 1.0, 1.0))[:3])
        factors.add(factor if "baseColorTexture" not in colour else ())
        if "baseColorTexture" in colour and factor != (1.0, 1.0, 1.0):
            notes.append(
                "Its materials tint textures (baseColorFactor), which was left out."
            )
        if "emissiveTexture" in material and "baseColorTexture" not in colour:
            notes.append(
                "A texture of emitted light (emissiveTexture) was left out; make it the "
                "base colour to keep it."
            )
    if len(factors - {()}) > 1:
        notes.append("The colours of its materials (baseColorFactor) were left out.")
    return list(dict.fromkeys(notes))


class _Plain:
    """A document whose accessors are made plain; what is made anew goes to the end."""

    def __init__(self, name: str, document: dict[str, Any], body: bytes) -> None:
        self._name, self._document = name, document
        self._body = bytearray(body)
        self._views = document.setdefault("bufferViews", [])
        self._accessors = document.setdefault("accessors", [])

    def make(self) -> list[str]:
        """Makes it plain; returns what is left out, a sentence each."""
        notes = []
        n_other = 0
        for mesh in self._document.get("meshes", []):
            kept = []
            for primitive in mesh["primitives"]:
                if primitive.get("mode", _TRIANGLES) not in (_TRIANGLES, _STRIP, _FAN):
                    n_other += 1
                    continue
                self._primitive(primitive)
                kept.append(primitive)
            mesh["primitives"] = kept
        if n_other:
            notes.append(
                f"{n_other} sets of lines or points, which are not part of the surface, were left out."
            )
        scenes = self._document.get("scenes", [])
        if len(scenes) > 1:
            shown = scenes[self._document.get("scene", 0)].get("name", "the first")
            notes.append(f"Of its {len(scenes)} scenes, {shown} was read.")
        return notes

    def file(self) -> bytes:
        """The plain document as GLB."""
        if self._body:
            self._document.setdefault("buffers", [{}])[0]["byteLength"] = len(
                self._body
            )
        return glb_file(self._document, bytes(self._body))

    def _primitive(self, primitive: dict[str, Any]) -> None:
        if "KHR_draco_mesh_compression" in primitive.get("extensions", {}):
            return
        attributes = primitive["attributes"]
        for key in ("POSITION", "NORMAL"):
            if key in attributes and not self._is_plain(attributes[key]):
                attributes[key] = self._add(self._values(attributes[key]))
        if "indices" in primitive and "sparse" in self._accessors[primitive["indices"]]:
            indices = self._values(primitive["indices"], normalise=False)
            primitive["indices"] = self._add(indices.astype(np.uint32))
        if primitive.get("mode") == _FAN:
            self._unfold_fan(primitive)
        if "COLOR_0" in attributes:
            linear = np.clip(self._values(attributes["COLOR_0"])[:, :3], 0.0, 1.0)
            # IEC 61966-2-1.
            srgb = np.where(
                linear <= 0.0031308,
                12.92 * linear,
                1.055 * linear ** (1.0 / 2.4) - 0.055,
            )
            rgba = np.full((len(srgb), 4), 255, dtype=np.uint8)
            rgba[:, :3] = np.rint(255.0 * srgb)
            attributes["COLOR_0"] = self._add(rgba, normalized=True)
        self._texture_coordinates(primitive)

    def _texture_coordinates(self, primitive: dict[str, Any]) -> None:
        """Puts those that the base colour's texture means, moved as it says, first."""
        attributes = primitive["attributes"]
        materials = self._document.get("materials", [])
        info: dict[str, Any] = {}
        if "material" in primitive:
            material = materials[primitive["material"]]
            info = material.get("pbrMetallicRoughness", {}).get("baseColorTexture", {})
            if not info:
                gloss = material.get("extensions", {}).get(
                    "KHR_materials_pbrSpecularGlossiness", {}
                )
                info = gloss.get("diffuseTexture", {})
        move = info.get("extensions", {}).get("KHR_texture_transform", {})
        channel = move.get("texCoord", info.get("texCoord", 0))
        key = f"TEXCOORD_{channel}"
        if key not in attributes:
            attributes.pop("TEXCOORD_0", None) if channel else None
            return
        if channel == 0 and not move and self._is_plain(attributes[key]):
            return
        uv = self._values(attributes[key])
        angle = float(move.get("rotation", 0.0))
        turn = np.array(
            [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        )
        uv = (uv * move.get("scale", (1.0, 1.0))) @ turn.T + move.get("offset", (0, 0))
        attributes["TEXCOORD_0"] = self._add(uv.astype(np.float32))

    def _unfold_fan(self, primitive: dict[str, Any]) -> None:
        if "indices" in primitive:
            ring = self._values(primitive["indices"], normalise=False).ravel()
        else:
            ring = np.arange(
                self._accessors[primitive["attributes"]["POSITION"]]["count"]
            )
        ring = ring.astype(np.uint32)
        fan = np.column_stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:]])
        primitive["indices"] = self._add(fan.astype(np.uint32).ravel())
        primitive["mode"] = _TRIANGLES

    def _is_plain(self, index: int) -> bool:
        accessor = self._accessors[index]
        return accessor["componentType"] == 5126 and "sparse" not in accessor

    def _values(self, index: int, normalise: bool = True) -> np.ndarray:
        """The numbers of an accessor, normalised where it says so, as float64."""
        accessor = self._accessors[index]
        dtype, width = (
            np.dtype(_TYPES[accessor["componentType"]]),
            _WIDTHS[accessor["type"]],
        )
        count = accessor["count"]
        if "bufferView" in accessor:
            values = self._view(
                accessor["bufferView"],
                accessor.get("byteOffset", 0),
                dtype,
                count,
                width,
            )
        else:
            values = np.zeros((count, width), dtype=dtype)
        sparse = accessor.get("sparse")
        if sparse:
            values = values.copy()
            where, what = sparse["indices"], sparse["values"]
            rows = self._view(
                where["bufferView"],
                where.get("byteOffset", 0),
                np.dtype(_TYPES[where["componentType"]]),
                sparse["count"],
                1,
            )
            values[rows.ravel()] = self._view(
                what["bufferView"],
                what.get("byteOffset", 0),
                dtype,
                sparse["count"],
                width,
            )
        numbers = values.astype(np.float64)
        if normalise and accessor.get("normalized") and dtype.kind in "iu":
            numbers = np.maximum(numbers / np.iinfo(dtype).max, -1.0)
        return numbers

    def _view(
        self, index: int, offset: int, dtype: np.dtype, count: int, width: int
    ) -> np.ndarray:
        view = self._views[index]
        if "uri" in self._document["buffers"][view["buffer"]] or view["buffer"] != 0:
            raise InputError(
                f"{self._name} keeps its numbers in a file beside it, in a form that is "
                "not read there. Export it as one GLB file."
            )
        start = view.get("byteOffset", 0)
        part = memoryview(self._body)[start : start + view["byteLength"]]
        stride = view.get("byteStride", width * dtype.itemsize)
        length = (count - 1) * stride + width * dtype.itemsize if count else 0
        if offset < 0 or stride <= 0 or offset + length > len(part):
            raise InputError(
                f"{self._name} names numbers beyond the end of its data; the file is "
                "damaged. Export or copy it again."
            )
        return np.ndarray(
            (count, width), dtype, part, offset, (stride, dtype.itemsize)
        ).copy()

    def _add(self, values: np.ndarray, normalized: bool = False) -> int:
        """Adds an accessor for ``values``; returns its number."""
        if values.dtype == np.float64:
            values = values.astype(np.float32)
        self._body += b"\0" * (-len(self._body) % 4)
        content = np.ascontiguousarray(values).tobytes()
        self._views.append(
            {"buffer": 0, "byteOffset": len(self._body), "byteLength": len(content)}
        )
        self._body += content
        code = next(code for code, kind in _TYPES.items() if kind == values.dtype)
        width = 1 if values.ndim == 1 else values.shape[1]
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1,
                "componentType": code,
                "count": len(values),
                "type": "SCALAR" if width == 1 else f"VEC{width}",
                **({"normalized": True} if normalized else {}),
            }
        )
        return len(self._accessors) - 1


def _contents(name: str, scene: Any, limits: Limits, notes: list[str]) -> MeshContents:
    """All parts of a scene, one after the other, each where it is placed."""
    places = [scene.graph[node] for node in _sorted_nodes(scene)]
    parts = [(matrix, scene.geometry[geometry]) for matrix, geometry in places]
    parts = [(matrix, part) for matrix, part in parts if hasattr(part, "faces")]
    check_counts(
        name,
        sum(len(part.vertices) for _, part in parts),
        sum(len(part.faces) for _, part in parts),
        limits,
    )
    vertices, faces, uvs, colours, normals = [], [], [], [], []
    pictures: list[Picture] = []
    number: dict[int, int] = {}
    shown = []
    n = 0
    for matrix, part in parts:
        linear = matrix[:3, :3]
        placed = np.asarray(part.vertices, dtype=np.float64) @ linear.T + matrix[:3, 3]
        corners = np.asarray(part.faces, dtype=np.int64)
        # A mirrored part is wound the other way.
        corners = corners[:, ::-1] if np.linalg.det(linear) < 0.0 else corners
        vertices.append(placed)
        faces.append(corners + n)
        n += len(placed)
        # The public property computes those that the file has not.
        own = part._cache.cache.get("vertex_normals")  # noqa: SLF001
        # Normals turn with the inverse transpose.
        normals.append(None if own is None else own @ np.linalg.pinv(linear))
        uv: Any = getattr(part.visual, "uv", None)
        is_whole = np.shape(uv) == (len(placed), 2)
        uvs.append(np.asarray(uv, dtype=np.float64)[corners] if is_whole else None)
        picture, note = _picture(part, number, pictures, limits)
        notes += [note] if note and note not in notes else []
        shown.append(np.full(len(corners), picture if is_whole else -1))
        colours.append(_colours(part))
    if not parts:
        return MeshContents(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), int))
    has_uv = any(uv is not None for uv in uvs)
    blank = [np.zeros((len(face), 3, 2)) for face in faces]
    return MeshContents(
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces),
        corner_uv=np.concatenate(
            [b if uv is None else uv for uv, b in zip(uvs, blank, strict=True)]
        )
        if has_uv
        else None,
        pictures=pictures,
        face_picture=np.concatenate(shown) if pictures else None,
        vertex_colours=_all_or_none(colours),
        vertex_normals=_all_or_none(normals),
        notes=tuple(notes),
    )


def _sorted_nodes(scene: Any) -> list[str]:
    """The nodes with geometry, in the order in which the file lists their meshes."""
    order = {name: i for i, name in enumerate(scene.geometry)}
    return sorted(
        scene.graph.nodes_geometry, key=lambda node: order[scene.graph[node][1]]
    )


def _all_or_none(arrays: list[np.ndarray | None]) -> np.ndarray | None:
    known = [array for array in arrays if array is not None]
    return np.concatenate(known) if len(known) == len(arrays) else None


def _colours(part: Any) -> np.ndarray | None:
    visual = part.visual
    if visual.kind == "vertex":
        return np.asarray(visual.vertex_colors, dtype=np.uint8)[:, :3]
    beside = getattr(visual, "vertex_attributes", {}).get("color")
    if beside is not None and len(beside) == len(part.vertices):
        return np.asarray(beside, dtype=np.uint8)[:, :3]
    return None


def _picture(
    part: Any, number: dict[int, int], pictures: list[Picture], limits: Limits
) -> tuple[int, str]:
    """Which of the pictures a part shows, -1: none; adds it if it is new."""
    material = getattr(part.visual, "material", None)
    for name in ("baseColorTexture", "image"):
        image = getattr(material, name, None)
        if image is None:
            continue
        if id(image) not in number:
            number[id(image)] = -1
            if image.width * image.height > limits.photo_pixels:
                return -1, (
                    f"A texture has {image.width}x{image.height} px; up to "
                    f"{limits.photo_megapixels:g} megapixels are read, so the mesh was "
                    "read without it."
                )
            try:
                shown = image
                if image.mode.startswith("I"):  # Grey of 16 bits, which Pillow cuts.
                    shown = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
                pixels = np.asarray(shown.convert("RGB"), dtype=np.uint8)
            except (OSError, ValueError, SyntaxError):
                return -1, "A texture is damaged, so the mesh was read without it."
            number[id(image)] = len(pictures)
            pictures.append(pixels)
        return number[id(image)], ""
    return -1, ""
