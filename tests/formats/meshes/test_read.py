"""Mesh files as they come: each is read right, or refused by name."""

import io
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.exchange.gltf import export_glb

from photoreg.errors import InputError
from photoreg.formats.meshes.polygons import triangle_corners
from photoreg.formats.meshes.read import MESH_SUFFIXES, load_mesh
from photoreg.limits import Limits
from tests.formats.photo_files import DISPLAY_P3, coded, icc_profile, png_16

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
# An L: its fan from the first corner leaves the outline.
L_RING = np.array([[2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]], dtype=float)


def obj(folder: Path, text: str | bytes, name: str = "m.obj") -> Any:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return load_mesh(path)


def picture(path: Path, colour: tuple[int, int, int], size: int = 8) -> None:
    Image.new("RGB", (size, size), colour).save(path)


# Polygons.


def test_an_l_is_cut_inside_its_outline_in_every_turn_and_direction():
    flat = np.pad(L_RING, ((0, 0), (0, 1)))
    turn = trimesh.transformations.random_rotation_matrix(
        rand=np.array([0.1, 0.5, 0.7])
    )[:3, :3]
    for axes in (np.eye(3), np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]], turn):
        for shift in range(6):
            for ring in (np.roll(flat, shift, 0), np.roll(flat, shift, 0)[::-1]):
                placed = ring @ axes
                cut, _ = triangle_corners(placed, np.arange(6), np.array([6]), "m")
                a, b, c = (placed[cut[:, k]] for k in range(3))
                cross = np.cross(b - a, c - a)
                assert 0.5 * np.linalg.norm(cross, axis=1).sum() == pytest.approx(3.0)
                newell = np.cross(placed, np.roll(placed, -1, 0)).sum(axis=0)
                assert (cross @ newell > 0.0).all(), "wound as the polygon is"


def test_a_dart_is_cut_along_the_diagonal_inside():
    dart = np.array([[0.0, 0, 0], [2, 1, 0], [0, 2, 0], [0.5, 1, 0]])
    for shift in range(4):
        ring = np.roll(dart, shift, axis=0)
        cut, _ = triangle_corners(ring, np.arange(4), np.array([4]), "m")
        a, b, c = (ring[cut[:, k]] for k in range(3))
        areas = 0.5 * np.cross(b - a, c - a)[:, 2]
        assert (areas > 0).all()
        assert areas.sum() == pytest.approx(1.5)


def test_corners_on_a_straight_edge_stay_joined():
    ring = np.array(
        [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [0, 1, 0]]
    )
    cut, _ = triangle_corners(ring, np.arange(6), np.array([6]), "m")
    assert len(cut) == 4
    assert set(cut.ravel()) == set(range(6))


def test_a_polygon_that_crosses_itself_is_refused():
    bow = np.array([[0.0, 0, 0], [2, 2, 0], [2, 0, 0], [0, 2, 0], [-1, 1, 0]])
    with pytest.raises(InputError, match="face 1, a polygon of 5 corners"):
        triangle_corners(bow, np.arange(5), np.array([5]), "m.obj")


# OBJ.


def test_white_space_of_any_kind_parts_words(tmp_path):
    text = SQUARE.replace(" ", "\t") + "f\t1\t2\t3\r\n  f  1 \t 3  4  # the rest\n"
    mesh = obj(tmp_path, b"\xef\xbb\xbf" + text.encode())
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    joined = obj(tmp_path, SQUARE + "f 1 2 \\\n 3\nf 1 \\\r\n3 4\n")
    assert joined.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_indices_count_back_from_their_line(tmp_path):
    block = "v {0} 0 0\nv {0} 1 0\nv {0} 0 1\nf -3 -2 -1\n"
    mesh = obj(tmp_path, "".join(block.format(i) for i in range(4)))
    assert mesh.faces.tolist() == [[3 * i, 3 * i + 1, 3 * i + 2] for i in range(4)]


@pytest.mark.parametrize("colours", ["0 0.5 1", "0 127.5 255"])
def test_colours_go_to_1_or_to_255(tmp_path, colours):
    text = "".join(f"{line} {colours}\n" for line in SQUARE.splitlines())
    mesh = obj(tmp_path, text + "f 1 2 3\n")
    assert mesh.vertex_colours is not None
    assert np.abs(mesh.vertex_colours[0].astype(int) - [0, 128, 255]).max() <= 1


def test_all_textures_of_several_materials_are_kept(tmp_path):
    (tmp_path / "maps").mkdir()
    picture(tmp_path / "maps" / "Red Side.PNG", (200, 0, 0), 16)
    picture(tmp_path / "blue.png", (0, 0, 200))
    (tmp_path / "all materials.mtl").write_text(
        "newmtl r\nmap_Kd -s 1 1 1 maps\\red side.png\nnewmtl b\nmap_Kd ./blue.png\n"
        "newmtl plain\nKd 0 1 0\n"
    )
    faces = "usemtl {}\nf 1/1 2/2 3/3\n"
    text = "mtllib all materials.mtl\n" + SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\n"
    mesh = obj(tmp_path, text + "".join(faces.format(m) for m in ("b", "r", "plain")))
    assert mesh.faces.tolist() == [[0, 1, 2]] * 3, "in the order of the file"
    assert mesh.notes == ()
    shown = _colour_at(mesh, mesh.corner_uv.mean(axis=1))
    assert shown.tolist() == [[0, 0, 200], [200, 0, 0], [0, 255, 0]]
    corners = _colour_at(mesh, mesh.corner_uv[:2].reshape(-1, 2))
    assert corners.tolist() == [[0, 0, 200]] * 3 + [[200, 0, 0]] * 3


def _colour_at(mesh: Any, uv: np.ndarray) -> np.ndarray:
    height, width = mesh.own_texture.shape[:2]
    x = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    y = np.clip(((1.0 - uv[:, 1]) * height).astype(int), 0, height - 1)
    return mesh.own_texture[y, x]


def test_what_lies_elsewhere_is_not_read_and_named(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    picture(tmp_path / "secret.png", (9, 9, 9))
    for name in ("../secret.png", str(tmp_path / "secret.png"), "C:\\secret.png"):
        (folder / "m.mtl").write_text(f"newmtl a\nmap_Kd {name}\n")
        text = "mtllib m.mtl\nusemtl a\n" + SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\n"
        mesh = obj(folder, text + "f 1/1 2/2 3/3\n")
        assert mesh.own_texture is None
        assert len(mesh.notes) == 1
        assert "outside the mesh's own folder" in mesh.notes[0]


def test_nothing_of_an_obj_vanishes_unseen(tmp_path):
    with pytest.raises(InputError, match=r"2 lines of faces, but 1"):
        obj(tmp_path, SQUARE + "f 1 2 3\nf 1 2\n")
    with pytest.raises(InputError, match="do not exist"):
        obj(tmp_path, SQUARE + "f 1 2 9\n")
    with pytest.raises(InputError, match="does not exist"):
        obj(tmp_path, SQUARE + "f 1 2 -9\n")
    with pytest.raises(InputError, match=r"curved surface \(cstype\)"):
        obj(tmp_path, SQUARE + "cstype bspline\nf 1 2 3\n")
    with pytest.raises(InputError, match="fourth coordinate"):
        obj(tmp_path, SQUARE.replace(" 0\n", " 0 2.5\n") + "f 1 2 3\n")
    lines = obj(tmp_path, SQUARE + "f 1 2 3\nl 3 4\np 1\n")
    assert lines.notes[0].startswith("2 lines and points")


# PLY.

PLY_HEAD = (
    "ply\nformat ascii 1.0\ncomment TextureFile red.png\ncomment TextureFile blue.png\n"
    "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n{vertex}"
    "element face 2\nproperty list uchar int vertex_indices\n{face}end_header\n"
)


def test_a_ply_with_several_textures_at_the_corners_of_its_faces(tmp_path):
    picture(tmp_path / "red.png", (200, 0, 0))
    picture(tmp_path / "blue.png", (0, 0, 200))
    head = PLY_HEAD.format(
        vertex="", face="property list uchar float texcoord\nproperty int texnumber\n"
    )
    body = (
        "0 0 0\n\n1 0 0\n0 1 0\n0 0 1\n"
        "3 3 1 2 6 0 0 1 0 0 1 1\n\n3 0 1 3 6 0 0 1 0 0 1 0\n"
    )
    (tmp_path / "m.ply").write_text(head + body)
    mesh = load_mesh(tmp_path / "m.ply")
    assert mesh.faces.tolist() == [[3, 1, 2], [0, 1, 3]]
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert mesh.corner_uv is not None
    shown = _colour_at(mesh, mesh.corner_uv.reshape(-1, 2))
    assert shown.tolist() == [[0, 0, 200]] * 3 + [[200, 0, 0]] * 3


@pytest.mark.parametrize(
    ("kind", "values"),
    [("uchar", "0 128 255"), ("float", "0 0.5 1"), ("ushort", "0 32896 65535")],
)
def test_ply_colours_of_every_type(tmp_path, kind, values):
    channels = "".join(f"property {kind} {c}\n" for c in ("red", "green", "blue"))
    rows = "".join(f"{p} {values}\n" for p in ("0 0 0", "1 0 0", "0 1 0", "0 0 1"))
    text = PLY_HEAD.format(vertex=channels, face="") + rows + "3 0 1 2\n4 0 1 2 3\n"
    (tmp_path / "m.ply").write_text(text)
    mesh = load_mesh(tmp_path / "m.ply")
    assert len(mesh.faces) == 3
    assert mesh.vertex_colours is not None
    assert mesh.vertex_colours[2].tolist() == [0, 128, 255]


def test_a_ply_that_goes_on_behind_its_end_is_refused(tmp_path):
    rows = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n3 1 2 3\n"
    (tmp_path / "m.ply").write_text(PLY_HEAD.format(vertex="", face="") + rows)
    with pytest.raises(InputError, match="goes on behind"):
        load_mesh(tmp_path / "m.ply")


# STL and OFF.


def test_an_stl_with_bytes_behind_its_end(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    path = tmp_path / "m.stl"
    ball.export(path)
    path.write_bytes(path.read_bytes() + b"made by a scanner")
    mesh = load_mesh(path)
    assert len(mesh.faces) == 80
    assert mesh.notes == ("17 bytes after its last triangle were left out.",)


@pytest.mark.parametrize("colour", ["0.2 0.4 0.6 1", "51 102 153 255"])
def test_coloured_off(tmp_path, colour):
    path = tmp_path / "m.off"
    points = ("0 0 0", "1 0 0", "1 1 0", "0.4 0.6 0")
    path.write_text(
        "COFF\n4 1 0\n" + "".join(f"{p} {colour}\n" for p in points) + "4 0 1 2 3\n"
    )
    mesh = load_mesh(path)
    assert mesh.vertex_colours is not None
    assert mesh.vertex_colours.tolist() == [[51, 102, 153]] * 4
    assert len(mesh.faces) == 2


# GLB.

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]], dtype="<f4")
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], dtype="<u2")


class Glb:
    """A GLB file, put together by hand."""

    def __init__(self) -> None:
        self.body = b""
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {}}]}],
            "accessors": [],
            "bufferViews": [],
        }
        self.primitive["indices"] = self.add(TRIANGLES.ravel())
        self.primitive["attributes"]["POSITION"] = self.add(POINTS)

    @property
    def primitive(self) -> dict[str, Any]:
        return self.document["meshes"][0]["primitives"][0]

    def view(self, content: bytes) -> int:
        self.body += b"\0" * (-len(self.body) % 4)
        view = {"buffer": 0, "byteOffset": len(self.body), "byteLength": len(content)}
        self.document["bufferViews"].append(view)
        self.body += content
        return len(self.document["bufferViews"]) - 1

    def add(self, values: np.ndarray, **more: Any) -> int:
        codes = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        width = 1 if values.ndim == 1 else values.shape[1]
        self.document["accessors"].append(
            {
                "bufferView": self.view(np.ascontiguousarray(values).tobytes()),
                "componentType": codes[values.dtype.str[1:]],
                "count": len(values),
                "type": "SCALAR" if width == 1 else f"VEC{width}",
                **more,
            }
        )
        return len(self.document["accessors"]) - 1

    def load(self, folder: Path) -> Any:
        self.document["buffers"] = [{"byteLength": len(self.body)}]
        text = json.dumps(self.document).encode()
        text += b" " * (-len(text) % 4)
        body = self.body + b"\0" * (-len(self.body) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(body), 0x004E4942) + body
        path = folder / "m.glb"
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return load_mesh(path)

    def texture(self, colours: np.ndarray, **info: Any) -> None:
        file = io.BytesIO()
        Image.fromarray(colours).save(file, "PNG")
        view = self.view(file.getvalue())
        self.document["images"] = [{"bufferView": view, "mimeType": "image/png"}]
        self.document["textures"] = [{"source": 0}]
        texture = {"baseColorTexture": {"index": 0, **info}}
        self.document["materials"] = [{"pbrMetallicRoughness": texture}]
        self.primitive["material"] = 0


def test_quantised_positions_are_normalised_and_placed_by_their_node(tmp_path):
    glb = Glb()
    quantised = np.rint(POINTS * 65535).astype("<u2")
    padded = np.pad(quantised, ((0, 0), (0, 1)))  # a stride of 8 bytes
    index = glb.add(padded, normalized=True, type="VEC3")
    glb.document["bufferViews"][-1]["byteStride"] = 8
    glb.primitive["attributes"]["POSITION"] = index
    glb.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    glb.document["nodes"][0].update(scale=[2, 2, 2], translation=[10, 0, 0])
    mesh = glb.load(tmp_path)
    np.testing.assert_allclose(mesh.vertices, POINTS * 2 + [10, 0, 0], atol=1e-4)


def test_sparse_accessors_replace_some_numbers(tmp_path):
    glb = Glb()
    index = glb.primitive["attributes"]["POSITION"]
    glb.document["accessors"][index]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": glb.view(b"\3\0"), "componentType": 5123},
        "values": {"bufferView": glb.view(np.array([0, 1, 9], "<f4").tobytes())},
    }
    assert glb.load(tmp_path).vertices.tolist() == [*POINTS[:3].tolist(), [0, 1, 9]]


def test_linear_colours_become_srgb(tmp_path):
    glb = Glb()
    linear = np.tile(np.array([0.0, 0.2140, 1.0], "<f4"), (4, 1))
    glb.primitive["attributes"]["COLOR_0"] = glb.add(linear)
    assert glb.load(tmp_path).vertex_colours.tolist() == [[0, 127, 255]] * 4


QUARTERS = np.zeros((8, 8, 3), dtype=np.uint8)
QUARTERS[:4, :4], QUARTERS[:4, 4:] = (200, 0, 0), (0, 200, 0)
QUARTERS[4:, :4], QUARTERS[4:, 4:] = (0, 0, 200), (200, 200, 200)


UV = np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]], "<f4")


@pytest.mark.parametrize("uri", ["my%20skin.png", "my skin.png"])
def test_a_picture_beside_a_glb_is_found_by_its_uri_or_told(tmp_path, uri):
    glb = Glb()
    glb.primitive["attributes"]["TEXCOORD_0"] = glb.add(UV)
    glb.texture(QUARTERS)
    glb.document["images"] = [{"uri": uri}]
    mesh = glb.load(tmp_path)
    assert mesh.own_texture is None
    assert "my skin.png is not there" in " ".join(mesh.notes)
    Image.fromarray(QUARTERS).save(tmp_path / "my skin.png")
    mesh = glb.load(tmp_path)
    np.testing.assert_array_equal(mesh.own_texture, QUARTERS)
    assert mesh.notes == ()


def test_a_grey_texture_of_16_bits_is_not_cut(tmp_path):
    glb = Glb()
    glb.primitive["attributes"]["TEXCOORD_0"] = glb.add(UV)
    grey = QUARTERS[..., 2]
    glb.texture(grey.astype(np.uint16) * 257)
    mesh = glb.load(tmp_path)
    np.testing.assert_array_equal(mesh.own_texture, np.dstack([grey] * 3))


@pytest.mark.parametrize(
    ("move", "colour"),
    [
        ({}, [200, 0, 0]),
        ({"offset": [0.5, 0]}, [0, 200, 0]),
        ({"scale": [3, 1]}, [0, 200, 0]),
        # The extension's example: the lower left quarter, turned clockwise.
        ({"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}, [0, 0, 200]),
    ],
)
def test_texture_transforms_and_a_second_set_of_coordinates(tmp_path, move, colour):
    uv = np.tile(np.array([0.25, 0.25]), (4, 1))
    glb = Glb()
    glb.primitive["attributes"]["TEXCOORD_0"] = glb.add(np.ones((4, 2), "<f4"))
    second = np.rint(uv * 65535).astype("<u2")
    glb.primitive["attributes"]["TEXCOORD_1"] = glb.add(second, normalized=True)
    extensions = {"KHR_texture_transform": move}
    glb.texture(QUARTERS, texCoord=1, extensions=extensions)
    glb.document["extensionsRequired"] = ["KHR_texture_transform"]
    mesh = glb.load(tmp_path)
    assert _colour_at(mesh, mesh.corner_uv.reshape(-1, 2)).tolist() == [colour] * 6


def test_fans_and_strips_are_triangles(tmp_path):
    fan, strip = Glb(), Glb()
    fan.primitive["indices"] = fan.add(np.array([0, 1, 2, 3], "<u2"))
    fan.primitive["mode"] = 6
    assert fan.load(tmp_path).faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    strip.primitive["indices"] = strip.add(np.array([1, 2, 0, 3], "<u2"))
    strip.primitive["mode"] = 5
    assert strip.load(tmp_path).area == pytest.approx(fan.load(tmp_path).area)


def test_a_mirrored_node_keeps_its_outside(tmp_path):
    glb = Glb()
    before = glb.load(tmp_path)
    glb.document["nodes"][0]["scale"] = [-1, 1, 1]
    after = glb.load(tmp_path)
    mirrored = before.face_normals * [-1, 1, 1]
    np.testing.assert_allclose(after.face_normals, mirrored, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"extensionsRequired": ["KHR_anything_new"]}, "KHR_anything_new"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "gltf-transform"),
        ({"extensionsUsed": ["EXT_mesh_gpu_instancing"]}, "instancing"),
        ({"nodes": [{"mesh": 0, "skin": 0}]}, "skeleton"),
        ({"extensionsRequired": ["KHR_texture_basisu"]}, "KHR_texture_basisu"),
    ],
)
def test_what_is_not_understood_is_refused_by_name(tmp_path, change, words):
    glb = Glb()
    glb.document.update(change)
    with pytest.raises(InputError, match=words):
        glb.load(tmp_path)


def test_other_scenes_and_lines_are_named(tmp_path):
    glb = Glb()
    glb.document["scenes"] += [{"nodes": []}]
    lines = {"attributes": glb.primitive["attributes"], "mode": 1}
    glb.document["meshes"][0]["primitives"].append(lines)
    mesh = glb.load(tmp_path)
    assert len(mesh.faces) == 2
    assert "1 sets of lines or points" in mesh.notes[0]
    assert "2 scenes" in mesh.notes[1]


def test_draco_is_decoded(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    plain, small = tmp_path / "plain.glb", tmp_path / "small.glb"
    plain.write_bytes(trimesh.Scene(ball).export(file_type="glb"))
    small.write_bytes(export_glb(trimesh.Scene(ball), extension_draco=True))
    a, b = load_mesh(plain), load_mesh(small)
    assert b"draco" in small.read_bytes()
    assert len(a.faces) == len(b.faces)
    assert b.area == pytest.approx(a.area, rel=1e-3)


def test_lines_of_an_obj_that_begin_with_no_known_word_are_told(tmp_path):
    text = "V 9 9 9\n#c\nhello\nv 0 0 0\nv 1 0 0\nv 0 1 0\nbeer 1\nhello\nf 1 2 3\n"
    assert obj(tmp_path, text).notes == (
        "4 lines that begin with 'V', 'hello', 'beer' are not understood and were left "
        "out.",
    )


def test_files_that_a_mesh_names_are_no_larger_than_the_limit(tmp_path):
    (tmp_path / "m.mtl").write_bytes(b"newmtl a\n" + b"#" * 20_000)
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    )
    (note,) = load_mesh(tmp_path / "m.obj", Limits(file_mb=0.01)).notes
    assert note.startswith("The material file m.mtl has 0.0 MB; up to 0.01 MB are read")


def test_the_readme_names_every_mesh_format_that_is_read_and_no_other():
    text = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    sentence = text.split("**Meshes**")[1].partition(";")[0]
    assert set(re.findall(r"`(\.\w+)`", sentence)) == set(MESH_SUFFIXES)


@pytest.mark.parametrize("precision", ["f4", "f8"])
def test_georeferenced_coordinates_in_single_precision_are_told(tmp_path, precision):
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = (ball.vertices + np.array([4_512_345.0, 5_401_234.0, 310.0])).astype(
        precision
    )
    rows = "\n".join(" ".join(map(repr, row)) for row in vertices.tolist())
    faces = "\n".join(f"f {a} {b} {c}" for a, b, c in ball.faces + 1)
    text = rows.replace("\n", "\nv ")
    mesh = obj(tmp_path, f"v {text}\n{faces}\n")
    if precision == "f8":
        assert mesh.notes == ()
        np.testing.assert_array_equal(mesh.vertices, vertices)
    else:
        assert "single precision, in steps of 0.5" in mesh.notes[0]


def test_what_of_a_ply_is_not_read_is_told(tmp_path):
    head = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty float quality\nelement face 1\nproperty list uchar "
        "int vertex_indices\nproperty uchar red\nelement edge 1\nproperty int vertex1\n"
        "end_header\n"
    )
    body = "0 0 0 1\n1 0 0 1\n0 1 0 1\n3 0 1 2 255\n0\n"
    (tmp_path / "m.ply").write_text(head + body)
    assert load_mesh(tmp_path / "m.ply").notes == (
        "Left out of it were quality of its vertex elements, red of its face elements "
        "and the elements edge.",
    )


def test_colours_of_the_faces_of_an_stl_and_of_some_vertices_of_an_obj_are_told(
    tmp_path,
):
    ball = trimesh.creation.icosphere(subdivisions=0)
    ball.export(tmp_path / "m.stl")
    content = bytearray((tmp_path / "m.stl").read_bytes())
    assert load_mesh(tmp_path / "m.stl").notes == ()
    content[84 + 48] = 7
    (tmp_path / "m.stl").write_bytes(content)
    assert "Colours of its faces" in load_mesh(tmp_path / "m.stl").notes[0]
    mesh = obj(tmp_path, "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert mesh.vertex_colours is None
    assert mesh.notes[0].startswith("Only some of its vertices have colours")


def test_textures_of_16_bits_and_in_wide_colours_have_their_colours(tmp_path):
    colour = np.array([200, 90, 40])
    wide = np.rint(255.0 * coded(colour / 255.0, DISPLAY_P3, None)).astype(np.uint8)
    profile = icc_profile(DISPLAY_P3, None)
    file = Image.fromarray(np.tile(wide, (16, 16, 1)))
    file.save(tmp_path / "wide.png", icc_profile=profile)
    deep = np.tile(257 * colour, (16, 16, 1)).astype(np.uint16)
    deep[0, 0] = 65535
    (tmp_path / "deep.png").write_bytes(png_16(deep))
    for name in ("wide.png", "deep.png"):
        (tmp_path / "m.mtl").write_text(f"newmtl a\nmap_Kd {name}\n")
        mesh = obj(
            tmp_path,
            "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
            "usemtl a\nf 1/1 2/2 3/3\n",
        )
        assert mesh.own_texture is not None, mesh.notes
        assert np.abs(mesh.own_texture[8, 8] - colour).max() <= 2, mesh.own_texture[
            8, 8
        ]
