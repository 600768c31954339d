"""Meshes that lie: a tetrahedron, whose faces are easy to damage."""

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tests.robustness.lying_input import Case
from tests.robustness.lying_photos import png, png_bomb

V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
F = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def obj(vertices: Any = V, faces: Any = F, first: int = 1) -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += ["f " + " ".join(str(i + first) for i in face) for face in faces]
    return ("\n".join(lines) + "\n").encode()


def off(vertices: Any = V, faces: Any = F, announced: tuple | None = None) -> bytes:
    n, m = announced or (len(vertices), len(faces))
    lines = ["OFF", f"{n} {m} 0"]
    lines += [f"{x} {y} {z}" for x, y, z in vertices]
    lines += [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
    return ("\n".join(lines) + "\n").encode()


def ply(
    vertices: Any = V,
    faces: Any = F,
    announced: tuple | None = None,
    ascii_: bool = False,
    extra: str = "",
) -> bytes:
    n, m = announced or (len(vertices), len(faces))
    kind = "ascii" if ascii_ else "binary_little_endian"
    head = (
        f"ply\nformat {kind} 1.0\nelement vertex {n}\nproperty float x\nproperty float "
        f"y\nproperty float z\n{extra}element face {m}\nproperty list uchar int "
        "vertex_indices\nend_header\n"
    ).encode()
    if ascii_:
        rows = [" ".join(map(str, row)) for row in vertices]
        rows += [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
        return head + ("\n".join(rows) + "\n").encode()
    body = np.asarray(vertices, "<f4").tobytes()
    for face in faces:
        body += struct.pack(f"<B{len(face)}i", len(face), *face)
    return head + body


def stl(vertices: Any = V, faces: Any = F, announced: int | None = None) -> bytes:
    count = len(faces) if announced is None else announced
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *np.asarray(vertices, "f4")[face].ravel(), 0)
        for face in np.asarray(faces)
    )
    return b"\0" * 80 + struct.pack("<I", count) + body


def stl_text(vertices: Any = V, faces: Any = F) -> bytes:
    lines = ["solid t"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(map(str, vertices[i])) for i in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid t\n"]).encode()


def glb(
    vertices: Any = V,
    faces: Any = F,
    change: Callable[[dict[str, Any]], object] | None = None,
) -> bytes:
    points = np.asarray(vertices, "<f4").tobytes()
    indices = np.asarray(faces, "<u4").tobytes()
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(vertices),
                "type": "VEC3",
            },
            {
                "bufferView": 1,
                "componentType": 5125,
                "count": np.size(faces),
                "type": "SCALAR",
            },
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(indices)},
        ],
        "buffers": [{"byteLength": len(points) + len(indices)}],
    }
    if change is not None:
        change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = points + indices
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


WRITERS: dict[str, Callable[..., bytes]] = {
    "obj": obj,
    "ply": ply,
    "stl": stl,
    "glb": glb,
    "off": off,
}


def with_vertex(value: float) -> np.ndarray:
    vertices = V.copy()
    vertices[2, 1] = value
    return vertices


def mesh_cases() -> Iterator[Case]:
    """What every format can have wrong, then what only one can."""
    nan, inf = with_vertex(np.nan), with_vertex(np.inf)
    sphere = trimesh.creation.icosphere(subdivisions=3)
    many = np.repeat(F, 12_600, axis=0)
    for suffix, write in WRITERS.items():
        whole = write(sphere.vertices, sphere.faces)
        name = f"m.{suffix}"
        tetra = "read: 4 triangles, 4 vertices"
        yield Case("nothing wrong", name, write(), tetra)
        yield Case("empty", name, b"", "is empty (0 bytes)")
        yield Case("noise", name, bytes(range(256)) * 40, "")
        yield Case("a photo by another name", name, png(), "")
        yield Case("a ZIP archive by another name", name, b"PK\3\4" + bytes(200), "")
        if suffix != "obj":
            yield Case("cut at half", name, whole[: len(whole) // 2], "truncated")
            yield Case("cut near the end", name, whole[:-30], "truncated")
        yield Case(
            "more than the limit on bytes", name, write() + b" " * 1_000_000, "MB"
        )
        yield Case("more triangles than the limit", name, write(V, many), "")
        yield Case("a vertex is NaN", name, write(nan), "not finite")
        yield Case("a vertex is infinite", name, write(inf), "not finite")
        if suffix not in ("stl", "glb", "ply"):
            huge = with_vertex(1e200)
            yield Case(
                "a vertex is at 1e200", name, write(huge), "the largest possible"
            )
        yield Case(
            "a vertex is at 1e30",
            name,
            write(with_vertex(1e30)),
            "the largest possible",
        )
        if suffix != "stl":
            high, low = F + np.eye(4, 3, dtype=int) * 99, F.copy()
            low[1, 2] = -7
            yield Case("a face names vertex 99", name, write(V, high), "exist")
            if suffix != "glb":
                yield Case("a face names vertex -7", name, write(V, low), "exist")
            apart = np.vstack([V, [[9.0, 9, 9]]])
            yield Case(
                "a vertex of no face", name, write(apart), "read: 4 triangles, 5"
            )
        yield Case("no faces", name, write(V, F[:0]), "no ")
        flat = np.vstack([F, [[1, 1, 2]]])
        yield Case("a face without area", name, write(V, flat), "read: 5 triangles, 4")
        yield Case("no face has area", name, write(V * 0.0), "zero area")
        twice = np.vstack([V, V]), np.vstack([F, F + 4])
        yield Case("every vertex twice", name, write(*twice), "read: 8 triangles, ")
        yield Case("inside out", name, write(V, F[:, ::-1]), tetra)
        fan = np.vstack([F, [[0, 1, 2]]])
        yield Case(
            "three faces at an edge", name, write(V, fan), "read: 5 triangles, 4"
        )
        two = np.vstack([V, V + 5.0]), np.vstack([F, F + 4])
        yield Case("two pieces", name, write(*two), "read: 8 triangles, 8 vertices")
    yield from obj_cases()
    yield from ply_cases()
    yield from stl_cases()
    yield from glb_cases()
    for head in (b"OFF\n-1 4 0\n", b"OFF\n4\n", b"OFF\nmany few 0\n", b"NOFF\n1 1 0\n"):
        yield Case(f"header {head!r}", "m.off", head + off()[10:], "m.off")
    yield Case("announces 10^12 faces", "m.off", off(announced=(4, 10**12)), "million")
    yield Case("comments between", "m.off", b"OFF # a\n# b\n" + off()[4:], "read: 4")


def beside(name: str, content: bytes, beside: dict[str, bytes]) -> Any:
    """A file, and others by their paths from its folder."""

    def make(path: Path) -> None:
        path.write_bytes(content)
        for other, data in beside.items():
            target = path.parent / other
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)

    del name
    return make


def obj_cases() -> Iterator[Case]:
    uv = b"vt 0 0\nvt 1 0\nvt 0 1\n"
    textured = b"mtllib %s\n" + obj(V, F[:0]) + uv + b"usemtl a\nf 1/1 2/2 3/3\n"
    material = b"newmtl a\nmap_Kd %s\n"
    picture = png()

    def with_mtl(place: bytes, image: bytes, files: dict[str, bytes]) -> Any:
        written = {
            p: (material % image if p.endswith("mtl") else d) for p, d in files.items()
        }
        return beside("m.obj", textured % place, written)

    inside = {"m.mtl": b"", "t.png": picture}
    yield Case(
        "MTL and texture beside it",
        "m.obj",
        with_mtl(b"m.mtl", b"t.png", inside),
        "texture",
    )
    outside = {"../secret.mtl": b"", "t.png": picture}
    plain = "read: 1 triangles, 4 vertices, texture coordinates"
    yield Case(
        "MTL above its folder",
        "m.obj",
        with_mtl(b"../secret.mtl", b"t.png", outside),
        plain,
    )
    outside = {"m.mtl": b"", "../secret.png": picture}
    yield Case(
        "texture above its folder",
        "m.obj",
        with_mtl(b"m.mtl", b"../secret.png", outside),
        plain,
    )
    yield Case(
        "texture at /etc/passwd",
        "m.obj",
        with_mtl(b"m.mtl", b"/etc/passwd", {"m.mtl": b""}),
        plain,
    )
    yield Case("MTL at /dev/zero", "m.obj", with_mtl(b"/dev/zero", b"", {}), plain)
    bomb = {"m.mtl": b"", "t.png": png_bomb()}
    yield Case(
        "texture is a decompression bomb",
        "m.obj",
        with_mtl(b"m.mtl", b"t.png", bomb),
        plain,
    )
    cut = {"m.mtl": b"", "t.png": picture[:60]}
    yield Case("texture is cut", "m.obj", with_mtl(b"m.mtl", b"t.png", cut), plain)
    yield Case("cut within a face", "m.obj", obj()[:-3], "truncated")
    yield Case("words for numbers", "m.obj", b"v a b c\n" + obj(), "")
    yield Case("numbers too few", "m.obj", b"v 1 2\n" + obj(), "")
    yield Case(
        "indices from the end", "m.obj", obj(V, F[:0]) + b"f -4 -3 -2\n", "read: 1"
    )
    yield Case("a face of 0", "m.obj", obj(V, F[:0]) + b"f 0 1 2\n", "")
    yield Case(
        "a polygon of 5",
        "m.obj",
        obj(np.vstack([V, V[:1]]), [[0, 1, 2, 3, 4]]),
        "read: 3",
    )
    yield Case(
        "lines end as on Windows", "m.obj", obj().replace(b"\n", b"\r\n"), "read: 4"
    )
    yield Case(
        "a number of 10^6 digits",
        "m.obj",
        b"v " + b"9" * 900_000 + b" 0 0\n" + obj(),
        "",
    )
    for name in (
        "a b.obj",
        "Mäuse 模型.obj",
        'it\'s "quoted".obj',
        "..m...obj",
        "-rf.obj",
    ):
        yield Case("a name", name, obj(), "read: 4 triangles")


def ply_cases() -> Iterator[Case]:
    yield Case("as text", "m.ply", ply(ascii_=True), "read: 4 triangles, 4")
    yield Case("text, cut", "m.ply", ply(ascii_=True)[:-12], "truncated")
    yield Case(
        "text, with words",
        "m.ply",
        ply(ascii_=True).replace(b"\n0.0 1.0", b"\nx 1.0"),
        "",
    )
    yield Case(
        "announces 10^12 vertices", "m.ply", ply(announced=(10**12, 4)), "million"
    )
    yield Case("announces -1 faces", "m.ply", ply(announced=(4, -1)), "how many")
    yield Case("announces 4e0 faces", "m.ply", ply(announced=(4, "4e0")), "how many")
    yield Case("announces 3 of 4 faces", "m.ply", ply(announced=(4, 3)), "m.ply")
    yield Case("no end of its header", "m.ply", ply()[:100], "end_header")
    yield Case(
        "a property of no known type", "m.ply", ply(extra="property quad q\n"), ""
    )
    yield Case(
        "a list of -1 vertices",
        "m.ply",
        ply()
        .replace(b"uchar int", b"char int")
        .replace(b"\3\0\0\0\0\2", b"\xff\0\0\0\0\2"),
        "",
    )
    quads = [[0, 1, 2, 3], [0, 1, 2], [1, 2, 3]]
    yield Case("triangles and quads", "m.ply", ply(V, quads), "read: 4 triangles")
    yield Case(
        "triangles and quads, as text",
        "m.ply",
        ply(V, quads, ascii_=True),
        "read: 4 triangles",
    )
    normals = "property float nx\nproperty float ny\nproperty float nz\n"
    out = np.hstack([V, V - V.mean(axis=0)])
    yield Case("with normals", "m.ply", ply(out, extra=normals), "normals")
    out = np.hstack([V, V.mean(axis=0) - V])
    yield Case(
        "with normals that point inwards", "m.ply", ply(out, extra=normals), "normals"
    )
    out = np.hstack([V, V * np.nan])
    yield Case(
        "with normals that are NaN",
        "m.ply",
        ply(out, extra=normals),
        "read: 4 triangles, 4 vertices",
    )
    texture = (
        ply(ascii_=True)
        .replace(b"ply\n", b"ply\n", 1)
        .replace(
            b"element vertex", b"comment TextureFile ../secret.png\nelement vertex"
        )
    )
    yield Case(
        "texture above its folder",
        "m.ply",
        beside("m.ply", texture, {"../secret.png": png()}),
        "read: 4 triangles, 4 vertices",
    )


def stl_cases() -> Iterator[Case]:
    yield Case("as text", "m.stl", stl_text(), "read: 4 triangles, 4")
    yield Case("text, cut", "m.stl", stl_text()[: len(stl_text()) // 2], "truncated")
    yield Case(
        "text, with words",
        "m.stl",
        stl_text().replace(b"vertex 1.0", b"vertex x", 1),
        "",
    )
    yield Case(
        "text, a vertex is NaN", "m.stl", stl_text(with_vertex(np.nan)), "not finite"
    )
    yield Case(
        "announces 2^32 - 1 faces",
        "m.stl",
        stl(announced=2**32 - 1),
        "announces 4,294,967,295",
    )
    yield Case("announces no faces", "m.stl", stl(announced=0), "announces 0")
    yield Case(
        "solid, but not text", "m.stl", b"solid" + stl()[5:], "read: 4 triangles, 4"
    )


def glb_cases() -> Iterator[Case]:
    def changed(key: str, index: int, **values: Any) -> bytes:
        return glb(change=lambda d: d[key][index].update(values))

    yield Case(
        "announces 10^12 vertices",
        "m.glb",
        changed("accessors", 0, count=10**12),
        "announces",
    )
    yield Case(
        "announces -4 vertices", "m.glb", changed("accessors", 0, count=-4), "count"
    )
    yield Case(
        "announces 'four' vertices",
        "m.glb",
        changed("accessors", 0, count="four"),
        "count",
    )
    yield Case(
        "vertices that it does not hold",
        "m.glb",
        glb(
            change=lambda d: (
                d["accessors"][0].pop("bufferView"),
                d["accessors"][0].update(count=40_000),
            )
        ),
        "does not hold",
    )
    yield Case(
        "a view past its end", "m.glb", changed("bufferViews", 0, byteLength=10**9), ""
    )
    yield Case("a view of no buffer", "m.glb", changed("bufferViews", 0, buffer=7), "")
    yield Case(
        "a type that is none", "m.glb", changed("accessors", 0, componentType=1), ""
    )
    yield Case(
        "a node within itself", "m.glb", changed("nodes", 0, children=[0]), "ancestor"
    )
    yield Case("a node of no mesh", "m.glb", changed("nodes", 0, mesh=9), "")
    yield Case(
        "a mesh used 20,000 times",
        "m.glb",
        glb(
            change=lambda d: (
                d.update(nodes=[{"mesh": 0}] * 20_000),
                d.update(scenes=[{"nodes": list(range(20_000))}]),
            )
        ),
        "million",
    )
    yield Case(
        "a buffer above its folder",
        "m.glb",
        beside(
            "m.glb",
            changed("buffers", 0, uri="../secret.bin"),
            {"../secret.bin": bytes(96)},
        ),
        "m.glb",
    )
    image = {
        "images": [{"uri": "../secret.png"}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    }
    yield Case(
        "an image above its folder",
        "m.glb",
        beside(
            "m.glb",
            glb(
                change=lambda d: (
                    d.update(image),
                    d["meshes"][0]["primitives"][0].update(material=0),
                )
            ),
            {"../secret.png": png()},
        ),
        "read: 4 triangles, 4 vertices",
    )
    yield Case(
        "description is not JSON",
        "m.glb",
        glb().replace(b'{"asset"', b'{,asset"'),
        "JSON",
    )
    yield Case("description is empty", "m.glb", glb(change=lambda d: d.clear()), "")
    yield Case(
        "version 1", "m.glb", glb()[:4] + struct.pack("<I", 1) + glb()[8:], "version 2"
    )
    yield Case(
        "cut, its length too",
        "m.glb",
        glb()[:8] + struct.pack("<I", 700) + glb()[12:700],
        "",
    )
    yield Case(
        "moved by NaN",
        "m.glb",
        changed("nodes", 0, translation=[float("nan"), 0, 0]),
        "",
    )
