"""Files as other programs write them, in forms that a reader may not expect.

Each is read right or refused by name: what is not understood does not pass in silence.
"""

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tests.robustness.lying_cameras import damaged, photoreg_file
from tests.robustness.lying_input import Case
from tests.robustness.lying_meshes import (
    F,
    V,
    beside,
    glb,
    obj,
    off,
    ply,
    stl,
    stl_text,
)
from tests.robustness.lying_photos import chunk, encoded, picture, png

SOUND = "read: 4 triangles, 4 vertices"
COLOURED = f"{SOUND}, colours"


def foreign_cases() -> Iterator[Case]:
    """All of them."""
    yield from obj_cases()
    yield from ply_cases()
    yield from other_mesh_cases()
    yield from glb_cases()
    yield from winding_cases()
    yield from lens_cases()
    yield from photo_cases()


def obj_cases() -> Iterator[Case]:
    lines = obj().decode().splitlines()
    vertices, faces = lines[:4], lines[4:]

    def case(what: str, text: str | list[str] | bytes, expected: str = SOUND) -> Case:
        if isinstance(text, list):
            text = "\n".join(text) + "\n"
        content = text.encode() if isinstance(text, str) else text
        return Case(f"OBJ: {what}", "m.obj", content, expected)

    yield case("a byte order mark", b"\xef\xbb\xbf" + obj())
    yield case("a byte order mark of UTF-16", obj().decode().encode("utf-16"), "UTF-16")
    yield case("lines that end in CR only", obj().replace(b"\n", b"\r"))
    yield case("tabs", obj().replace(b" ", b"\t"))
    yield case(
        "two blanks, and some at the end",
        obj().replace(b" ", b"  ").replace(b"\n", b"  \n"),
    )
    yield case("form feeds and vertical tabs", obj().replace(b" ", b"\v"), "")
    yield case("blanks before each line", "  " + obj().decode().replace("\n", "\n  "))
    yield case("capitals", obj().upper(), "")
    yield case("commas for decimal points", obj().replace(b".0", b",0"), "")
    yield case("exponents", obj().replace(b"1.0", b"1.0E+00"))
    yield case("faces before their vertices", [*faces, *vertices])
    yield case(
        "faces and vertices in turn",
        [*vertices[:3], "f 1 2 3", vertices[3], "f 1 2 4"],
        "read: 2 triangles, 4",
    )
    yield case(
        "indices counted back within blocks",
        [*vertices[:3], "f -3 -2 -1", *vertices[1:], "f -3 -2 -1"],
        "read: 2 triangles, 6",
    )
    yield case("an index counted back too far", [*vertices, "f -9 -2 -1"], "exist")
    yield case("w of 1", [f"{v} 1.0" for v in vertices] + faces)
    yield case("w of 2", [f"{v} 2.0" for v in vertices] + faces, "rational")
    yield case(
        "colours 0 to 1", [f"{v} 0.5 0.2 1.0" for v in vertices] + faces, COLOURED
    )
    yield case(
        "colours 0 to 255", [f"{v} 128 20 255" for v in vertices] + faces, COLOURED
    )
    yield case(
        "colours with alpha", [f"{v} .5 .2 1.0 1.0" for v in vertices] + faces, COLOURED
    )
    five = [f"{v} 0.5 0.5" for v in vertices] + faces
    yield case("two numbers more a vertex", five, "5 numbers")
    yield case("vertices that are marked otherwise", [f"vx{v}" for v in lines], "vx")
    yield case(
        "colours at some vertices", [f"{vertices[0]} 1 0 0", *vertices[1:], *faces]
    )
    for key, kind in (("vt", "texture coordinates"), ("vn", "normals")):
        for word in ("nan", "-1.#IND", "0,5"):
            ends = "f 1/1/1 2/1/1 3/1/1"
            other = "vn 0 0 1" if key == "vt" else "vt 0 0"
            text = [*vertices, f"{key} {word} 0 1", other, ends]
            yield Case(
                f"OBJ: {kind} with {word}",
                "m.obj",
                "\n".join(text).encode(),
                "read: 1 triangles" if key == "vt" else "texture coordinates",
                f"Some {kind} are not numbers",
            )
    yield case("comments behind numbers", [f"{line} # here" for line in lines])
    yield case("lines that go on", obj().replace(b"f 1 ", b"f 1 \\\n"))
    yield case(
        "groups and objects", ["o a b", "g one two", "s 1", *vertices, "s off", *faces]
    )
    yield case(
        "an object for each face",
        [*vertices, *(line for i, f in enumerate(faces) for line in (f"o part{i}", f))],
    )
    yield case("lines and points beside faces", [*lines, "l 1 2", "p 1"])
    yield case("lines only", [*vertices, "l 1 2 3"], "no triangles")
    yield case("a face of two corners", [*vertices, "f 1 2"], "corners")
    yield case(
        "a free-form surface",
        [*vertices, "cstype bspline", "deg 3 3", "surf 0 1 0 1 1 2 3 4"],
        "curved surface",
    )
    yield case(
        "an L",
        [
            "v 0 0 0",
            "v 2 0 0",
            "v 2 1 0",
            "v 1 1 0",
            "v 1 2 0",
            "v 0 2 0",
            "f 1 2 3 4 5 6",
        ],
        "read: 4 triangles, 6",
    )
    yield case(
        "a bow tie",
        [
            "v 0 0 0",
            "v 1 1 0",
            "v 2 0 0",
            "v 2 2 0",
            "v 1 1.5 0",
            "v 0 2 0",
            "f 1 6 3 4 2 5",
        ],
        "",
    )
    yield case(
        "coordinates of a country",
        [f"v {512345.25 + x} {5401234.5 + y} {z}" for x, y, z in V] + faces,
    )
    yield case("a line of no known word", ["hello world", *lines], SOUND)
    yield case(
        "texture coordinates of three numbers",
        [*vertices, "vt 0 0 0", "vt 1 0 0", "vt 0 1 0", "f 1/1 2/2 3/3"],
        "texture coordinates",
    )
    yield case(
        "normals without texture coordinates",
        [
            *vertices,
            "vn 0 0 1",
            *("f " + " ".join(f"{i + 1}//1" for i in f) for f in F),
        ],
        "normals",
    )
    yield case(
        "a texture index that does not exist",
        [*vertices, "vt 0 0", "f 1/1 2/7 3/1"],
        "do not exist",
    )
    yield case("an MTL that is not there", ["mtllib gone.mtl", *lines])

    def textured(map_line: str, picture_name: str = "t.png") -> Any:
        text = (
            "mtllib m.mtl\n"
            + "\n".join(vertices)
            + "\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
        )
        return beside(
            "m.obj",
            text.encode(),
            {"m.mtl": f"newmtl a\n{map_line}\n".encode(), picture_name: png()},
        )

    full = "texture, texture coordinates"
    for what, line, name in (
        ("options", "map_Kd -o 0 0 0 -s 1 1 1 t.png", "t.png"),
        ("a space", "map_Kd my skin.png", "my skin.png"),
        ("other capitals", "map_Kd T.PNG", "t.png"),
        ("a backslash", "map_Kd tex\\t.png", "tex/t.png"),
        ("a dot", "map_Kd ./t.png", "t.png"),
        (
            "a Windows path, and the picture beside it",
            "map_Kd C:\\scans\\t.png",
            "t.png",
        ),
        ("a lost folder, and the picture beside it", "map_Kd textures/t.png", "t.png"),
        ("tabs", "\tmap_Kd\tt.png", "t.png"),
        ("letters beyond ASCII", "map_Kd Häutung.png", "Häutung.png"),
    ):
        yield Case(f"MTL: {what}", "m.obj", textured(line, name), full)
    for option in ("-s 2 2 1", "-o 0.1 0.2 0", "-t 0.5", "-mm 0.2 0.5"):
        yield Case(
            f"MTL: a texture with {option}",
            "m.obj",
            textured(f"map_Kd -clamp on {option} t.png"),
            "texture coordinates",
            "scales, shifts or fades a texture",
        )
    for key, light in (("map_Ka", "ambient"), ("map_Ke", "emitted")):
        yield Case(
            f"MTL: a texture of {light} light only",
            "m.obj",
            textured(f"{key} t.png"),
            "texture coordinates",
            "t.png does not hold the surface's colours",
        )
    two = ["mtllib m.mtl", *vertices, "usemtl a", *faces[:2], "usemtl b", *faces[2:]]
    kinds = {"m.mtl": b"newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n"}
    yield Case(
        "MTL: a colour for each material",
        "m.obj",
        beside("", "\n".join(two).encode(), kinds),
        SOUND,
        "materials (Kd) were left out",
    )
    for word in ("-1.#IND", "1.#QNAN", "-nan(ind)", "1,5", "1.0D0"):
        yield case(
            f"a vertex at {word}",
            [f"v 0 0 {word}", *vertices[1:], *faces],
            "not numbers",
        )
    yield case("comments behind numbers", [f"{line} # it" for line in lines])
    yield Case(
        "OBJ: ZBrush's colours in comments",
        "m.obj",
        obj() + b"#MRGB ffff0000ff00ff00ff0000ffffffffff\n",
        SOUND,
        "'#MRGB'",
    )
    yield Case(
        "MTL: a picture in a format that is no picture",
        "m.obj",
        textured("map_Kd m.mtl"),
        "texture coordinates",
    )

    large = {"m.mtl": b"newmtl a\nmap_Kd t.png\n", "t.png": png() + bytes(1_100_000)}
    text = b"mtllib m.mtl\n" + obj()
    yield Case(
        "MTL: a picture above the limit", "m.obj", beside("", text, large), SOUND
    )
    large = {"m.mtl": b"newmtl a\n" + b"#" * 1_100_000}
    yield Case("MTL: itself above the limit", "m.obj", beside("", text, large), SOUND)
    wide = {"m.mtl": "newmtl a\nmap_Kd t.png\n".encode("utf-16"), "t.png": png()}
    yield Case(
        "MTL: in UTF-16", "m.obj", beside("", text, wide), "m.mtl is text in UTF-16"
    )


def ply_cases() -> Iterator[Case]:
    xyz = "property float x\nproperty float y\nproperty float z\n"
    face = "property list uchar int vertex_indices\n"

    def text(
        vertex: str = "",
        rows: Any = V,
        faces: list[str] | None = None,
        head: str = "",
        face_extra: str = "",
        first: str = "ascii",
        tail: str = "",
    ) -> bytes:
        of_faces = (
            faces if faces is not None else ["3 " + " ".join(map(str, f)) for f in F]
        )
        lines = [" ".join(map(str, row)) for row in rows] + of_faces
        return (
            f"ply\nformat {first} 1.0\n{head}element vertex {len(rows)}\n{xyz}{vertex}element face "
            f"{len(of_faces)}\n{face}{face_extra}{tail}end_header\n"
            + "\n".join(lines)
            + "\n"
        ).encode()

    def case(
        what: str, content: bytes | Callable[[Path], object], expected: str = SOUND
    ) -> Case:
        return Case(f"PLY: {what}", "m.ply", content, expected)

    def coloured(kind: str, values: str) -> bytes:
        head = "".join(f"property {kind} {c}\n" for c in ("red", "green", "blue"))
        return text(head, [[*v, *values.split()] for v in V])

    big = ply().replace(b"little", b"big")
    body = np.asarray(V, ">f4").tobytes()
    body += b"".join(struct.pack(">B3i", 3, *f) for f in F)
    yield case("big endian", big[: big.index(b"end_header\n") + 11] + body)
    yield case("lines that end in CR LF", text().replace(b"\n", b"\r\n"))
    yield case(
        "blank lines between", text().replace(b"end_header\n", b"end_header\n\n\n")
    )
    yield case(
        "obj_info and comments",
        text(head="obj_info num_cols 4\ncomment VCGLIB generated\n"),
    )
    yield case(
        "a scalar field of CloudCompare",
        text("property float scalar_Intensity\n", [[*v, 0.5] for v in V]),
    )
    yield case(
        "confidence and intensity",
        text(
            "property float confidence\nproperty float intensity\n",
            [[*v, 1, 0.5] for v in V],
        ),
    )
    yield case(
        "vertex_index for vertex_indices",
        text().replace(b"vertex_indices", b"vertex_index"),
    )
    yield case(
        "lists of unsigned numbers", text().replace(b"uchar int", b"uint8 uint32")
    )
    yield case(
        "a flag behind each face",
        text(
            face_extra="property int flags\n",
            faces=["3 " + " ".join(map(str, f)) + " 0" for f in F],
        ),
    )
    yield case("colours of bytes", coloured("uchar", "10 20 30"), COLOURED)
    yield case("colours of floats", coloured("float", "0.1 0.2 1"), COLOURED)
    yield case("colours of shorts", coloured("ushort", "1000 20000 65535"), COLOURED)
    yield case(
        "colours and alpha",
        text(
            "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n",
            [[*v, 1, 2, 3, 255] for v in V],
        ),
        COLOURED,
    )
    yield case(
        "diffuse colours of Blender's old exporter",
        text(
            "property uchar diffuse_red\nproperty uchar diffuse_green\nproperty uchar diffuse_blue\n",
            [[*v, 1, 2, 3] for v in V],
        ),
        COLOURED,
    )
    yield case("doubles", text().replace(b"float", b"double"))
    yield case(
        "an edge element behind",
        text(tail="element edge 1\nproperty int vertex1\nproperty int vertex2\n")
        + b"0 1\n",
    )
    yield case(
        "a camera of MeshLab",
        text(head="element camera 1\nproperty float view_px\n").replace(
            b"end_header\n", b"end_header\n0.5\n"
        ),
    )
    yield case("points only", ply(V, F[:0]), "no triangles")
    yield case(
        "points of a cloud with normals",
        text(
            "property float nx\nproperty float ny\nproperty float nz\n",
            [[*v, 0, 0, 1] for v in V],
            faces=[],
        ),
        "Make a mesh of the points",
    )
    yield case(
        "triangle strips",
        (
            f"ply\nformat ascii 1.0\nelement vertex 4\n{xyz}element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
            + "\n".join(" ".join(map(str, v)) for v in V)
            + "\n4 0 1 2 3\n"
        ).encode(),
        "tristrips",
    )
    yield case(
        "splats of 3D Gaussians",
        text(
            "property float f_dc_0\nproperty float opacity\nproperty float scale_0\n",
            [[*v, 0, 0, 0] for v in V],
            faces=[],
        ),
        "no triangles",
    )
    yield case("more lines than announced", text() + b"3 0 1 2\n", "goes on behind")
    yield case("a face of two corners", text(faces=["2 0 1", "3 0 1 2"]), "corners")
    yield case(
        "a polygon of five",
        text(
            rows=[[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0]],
            faces=["5 0 1 2 3 4"],
        ),
        "read: 3 triangles, 5",
    )
    wedge = "property list uchar float texcoord\n"
    rows = ["3 " + " ".join(map(str, f)) + " 6 0 0 1 0 0 1" for f in F]
    yield case(
        "texture coordinates at the corners",
        beside(
            "m.ply",
            text(head="comment TextureFile t.png\n", face_extra=wedge, faces=rows),
            {"t.png": png()},
        ),
        "texture, texture coordinates",
    )
    yield case(
        "texture with a space in its name",
        beside(
            "m.ply",
            text(head="comment TextureFile my t.png\n", face_extra=wedge, faces=rows),
            {"my t.png": png()},
        ),
        "texture, texture coordinates",
    )
    yield case(
        "no texture coordinates at some faces",
        beside(
            "m.ply",
            text(
                head="comment TextureFile t.png\n",
                face_extra=wedge,
                faces=[*rows[:3], rows[3][: rows[3].index(" 6 ")] + " 0"],
            ),
            {"t.png": png()},
        ),
        "texture, texture coordinates",
    )
    yield case(
        "texture coordinates of four numbers",
        text(face_extra=wedge, faces=["3 0 2 1 4 0 0 1 0"]),
        "read: 1 triangles",
    )


def other_mesh_cases() -> Iterator[Case]:
    colours = (
        b"COFF\n4 4 0\n"
        + b"".join(b"%g %g %g 255 0 0 255\n" % tuple(v) for v in V)
        + b"".join(b"3 %d %d %d\n" % tuple(f) for f in F)
    )
    yield Case("OFF: COFF", "m.off", colours, COLOURED)
    yield Case(
        "OFF: counts in the first line",
        "m.off",
        off().replace(b"OFF\n", b"OFF "),
        SOUND,
    )
    yield Case(
        "OFF: colours behind faces",
        "m.off",
        off().replace(b"3 0 2 1\n", b"3 0 2 1 255 0 0\n"),
        SOUND,
    )
    yield Case("OFF: NOFF", "m.off", b"N" + off(), "begin with OFF")
    yield Case("OFF: binary", "m.off", b"OFF BINARY\n" + bytes(100), "m.off")
    yield Case(
        "STL: remarks behind the end", "m.stl", stl() + b"made by a scanner", SOUND
    )
    yield Case(
        "STL: colours in its attributes", "m.stl", b"COLOR=\1\2\3\4" + stl()[10:], SOUND
    )
    yield Case(
        "STL: two solids", "m.stl", stl_text() + stl_text(V + 5.0), "read: 8 triangles"
    )
    yield Case("STL: capitals", "m.stl", stl_text().upper(), "read: 4 triangles")
    yield Case(
        "STL: lines that end in CR LF",
        "m.stl",
        stl_text().replace(b"\n", b"\r\n"),
        SOUND,
    )


def glb_cases() -> Iterator[Case]:
    def case(
        what: str, change: Callable[[dict[str, Any]], object], expected: str = SOUND
    ) -> Case:
        return Case(f"GLB: {what}", "m.glb", glb(change=change), expected)

    for extension in (
        "KHR_texture_basisu",
        "EXT_meshopt_compression",
        "KHR_gaussian_splatting",
        "CESIUM_primitive_outline",
        "MADE_UP_extension",
    ):
        yield case(
            f"requires {extension}",
            lambda d, e=extension: d.update(extensionsRequired=[e], extensionsUsed=[e]),
            "m.glb",
        )
    yield case(
        "uses an extension that is not required",
        lambda d: d.update(extensionsUsed=["KHR_materials_unlit"]),
    )
    yield case(
        "instancing",
        lambda d: d.update(extensionsUsed=["EXT_mesh_gpu_instancing"]),
        "instancing",
    )
    for extension in ("KHR_node_visibility", "MSFT_lod", "MADE_UP_extension"):
        yield Case(
            f"GLB: uses {extension}, which is not required",
            "m.glb",
            glb(change=lambda d, e=extension: d.update(extensionsUsed=[e])),
            SOUND,
            f"It uses {extension} of glTF",
        )
    yield case(
        "a centre of its own",
        lambda d: d.update(
            extensionsUsed=["CESIUM_RTC"],
            extensions={"CESIUM_RTC": {"center": [1e6, 2e6, 3e6]}},
        ),
        "centre of its own",
    )
    yield case(
        "morph targets of a node",
        lambda d: d["nodes"][0].update(weights=[0.0, 0.5]),
        "morph targets",
    )
    red, blue = (
        {"pbrMetallicRoughness": {"baseColorFactor": [*rgb, 1.0]}}
        for rgb in ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    )
    tinted = {
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.2, 0.2, 0.2, 1.0],
            "baseColorTexture": {"index": 0},
        }
    }
    for what, materials, told in (
        ("a colour for each material", [red, blue], "(baseColorFactor) were left out"),
        ("a tinted texture", [tinted], "tint textures"),
        ("a glowing texture", [{"emissiveTexture": {"index": 0}}], "emitted light"),
    ):
        yield Case(
            f"GLB: {what}",
            "m.glb",
            glb(change=lambda d, m=materials: d.update(materials=m)),
            SOUND,
            told,
        )
    yield case("a skin", lambda d: d["nodes"][0].update(skin=0), "skeleton")
    yield case(
        "morph targets", lambda d: d["meshes"][0].update(weights=[0.5]), "morph targets"
    )
    yield case(
        "points",
        lambda d: d["meshes"][0]["primitives"][0].update(mode=0),
        "no triangles",
    )
    yield case(
        "two scenes", lambda d: d.update(scenes=[{"nodes": [0]}, {"nodes": [0]}])
    )
    yield case(
        "a node turned", lambda d: d["nodes"][0].update(rotation=[0.5, 0.5, 0.5, 0.5])
    )
    yield case("a node mirrored", lambda d: d["nodes"][0].update(scale=[-1, 1, 1]))
    yield case(
        "a node flattened", lambda d: d["nodes"][0].update(scale=[0, 0, 0]), "area"
    )
    yield case(
        "a mesh placed twice",
        lambda d: (
            d["nodes"].append({"mesh": 0, "translation": [5, 0, 0]}),
            d["scenes"][0].update(nodes=[0, 1]),
        ),
        "read: 8 triangles, 8",
    )
    yield case(
        "the object far away in its node",
        lambda d: d["nodes"][0].update(translation=[512345.0, 5401234.0, 300.0]),
    )


def winding_cases() -> Iterator[Case]:
    turned = F.copy()
    turned[1] = turned[1, ::-1]
    for suffix, write in (
        ("obj", obj),
        ("ply", ply),
        ("stl", stl),
        ("glb", glb),
        ("off", off),
    ):
        yield Case(
            "one face wound the other way", f"m.{suffix}", write(V, turned), SOUND
        )
        both = np.vstack([F, F[:, ::-1]])
        yield Case(
            "two-sided: each face twice, once turned",
            f"m.{suffix}",
            write(V, both),
            SOUND,
        )


def lens_cases() -> Iterator[Case]:
    for key, value in (
        ("distortion", [0.1, 0]),
        ("k1", -0.1),
        ("k5", 0.01),
        ("distortion_coefficients", [0, 0.1]),
        ("is_fisheye", True),
        ("dist", [1e-3]),
    ):
        yield Case(f"photoreg: {key}", "c.json", photoreg_file(**{key: value}), key)
    yield Case(
        "photoreg: a distortion of zeros",
        "c.json",
        photoreg_file(distortion=[0.0, 0]),
        "read: 1 cameras",
    )

    def changed(**values: Any) -> Any:
        return damaged(
            "nerfstudio", lambda b: json.dumps({**json.loads(b), **values}).encode()
        )

    for key, value in (
        ("distortion_params", [0.1, 0, 0, 0]),
        ("k6", 0.1),
        ("is_fisheye", True),
        ("camera_model", "OPENCV_FISHEYE"),
        ("camera_model", "EQUIRECTANGULAR"),
    ):
        yield Case(
            f"nerfstudio: {key} is {value}",
            "transforms.json",
            changed(**{key: value}),
            "undistort",
        )
    for key in ("k1", "p1"):
        lens = changed(**{key: 0.01})
        yield Case(f"nerfstudio: {key}", "transforms.json", lens, "read: 2 cameras")
    yield Case(
        "nerfstudio: an applied transform",
        "transforms.json",
        changed(applied_transform=[[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]),
        "read: 2 cameras",
    )


def photo_cases() -> Iterator[Case]:
    marks = {
        "a fisheye by its XMP": b'<a GPano:ProjectionType="fisheye"/>',
        "a half panorama": b'<a GPano:UsePanoramaViewer="True" GPano:ProjectionType="cylindrical"/>',
    }
    for what, xmp in marks.items():
        yield Case(what, "p.jpg", encoded(picture(), "JPEG", xmp=xmp), "p.jpg")
    wide = png()[:33] + chunk(b"cICP", bytes([12, 13, 0, 1])) + png()[33:]
    yield Case("Display P3 by cICP", "p.png", wide, "read: 40 x 30 px")
    linear = png()[:33] + chunk(b"gAMA", struct.pack(">I", 100_000)) + png()[33:]
    yield Case("linear by gAMA", "p.png", linear, "read: 40 x 30 px")
    for turn in (2, 4, 5, 7):
        size = "40 x 30" if turn < 5 else "30 x 40"
        exif = picture().getexif()
        exif[0x0112] = turn
        yield Case(
            f"mirrored by EXIF ({turn})",
            "p.jpg",
            encoded(picture(), "JPEG", exif=exif.tobytes()),
            f"read: {size} px",
        )
