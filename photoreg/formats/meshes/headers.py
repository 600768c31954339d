"""What a mesh file announces, held against what it holds and against the limits.

Readers believe headers: they make room for what is announced, or read what is there and
say nothing of the rest. So a truncated or lying file is refused before it is read.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from photoreg.errors import InputError
from photoreg.formats.glb_container import JSON_CHUNK
from photoreg.formats.parsing import refuse_utf16
from photoreg.limits import Limits
from photoreg.sources import open_for_reading

HEADER_BYTES = 1 << 20
"""No header of a PLY file is longer."""

VERTICES_A_FACE = 3
"""More vertices than corners have no use."""


def check_announced(path: Path, limits: Limits) -> None:
    """Raises InputError if the file announces more than it holds or than is allowed."""
    if path.suffix.lower() in (".obj", ".ply", ".off"):
        with open_for_reading(path) as file:
            refuse_utf16(path, file.read(2))
    checks = {".obj": _obj, ".ply": _ply, ".stl": _stl, ".off": _off, ".glb": _glb}
    checks[path.suffix.lower()](path, limits)


def check_counts(name: str, n_vertices: int, n_faces: int, limits: Limits) -> None:
    """Raises InputError if a mesh is larger than the limits."""
    most = limits.faces_millions * 1e6
    if n_faces > most or n_vertices > VERTICES_A_FACE * most:
        raise InputError(
            f"{name} has {n_faces:,} triangles and {n_vertices:,} vertices; up to "
            f"{limits.faces_millions:g} million triangles are read. Decimate it first, "
            "or raise the limit (SECURITY.md names its variable)."
        )


def _obj(path: Path, limits: Limits) -> None:
    del limits  # It announces nothing; only its last line tells that more should come.
    with open_for_reading(path) as file:
        file.seek(max(0, path.stat().st_size - 10_000))
        tail = file.read()
    words = tail.rpartition(b"\n")[2].split()
    if words[:1] in ([b"f"], [b"v"]) and len(words) < 4:
        raise InputError(
            f"{path.name} ends within a line; it is truncated. Export or copy it again."
        )


def _ply(path: Path, limits: Limits) -> None:
    with open_for_reading(path) as file:
        head = file.read(HEADER_BYTES)
        end = head.find(b"end_header")
        if not head.lower().startswith(b"ply") or end < 0:
            raise InputError(
                f"{path.name} could not be read as a mesh: it should begin with ply "
                "and have a header that ends with end_header. Is the file complete?"
            )
        counts: dict[str, int] = {}
        layouts: dict[str, list[list[str]]] = {}
        for line in head[:end].decode("latin-1").splitlines():
            words = line.split()
            if words[:1] == ["element"]:
                if len(words) != 3 or not words[2].isdecimal():
                    raise InputError(
                        f"{path.name}: its header should say how many of each element "
                        f"there are, but says {line.strip()!r:.60}."
                    )
                counts[words[1]], layouts[words[1]] = int(words[2]), []
            elif words[:1] == ["property"] and layouts:
                layouts[list(layouts)[-1]].append(words[1:])
        vertices, faces = counts.get("vertex", 0), counts.get("face", 0)
        check_counts(path.name, vertices, faces, limits)
        file.seek(end)
        file.readline()
        if b"ascii" in head[:end]:
            _expect_lines(path, sum(counts.values()), _count_lines(file))
            return
        least = sum(
            counts[name] * sum(map(_least_bytes, rows))
            for name, rows in layouts.items()
        )
        found = path.stat().st_size - file.tell()
        if found < least:
            raise InputError(
                f"{path.name} announces {vertices:,} vertices and {faces:,} faces, but "
                f"has room for fewer; it is truncated. Export or copy it again."
            )


_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


def _least_bytes(words: list[str]) -> int:
    """The least that a property of a binary PLY takes: a face has three corners."""
    if words[:1] != ["list"] or len(words) != 4:
        return _PLY_BYTES.get(words[0], 0) if words else 0
    corners = 3 if words[3] in ("vertex_indices", "vertex_index") else 0
    return _PLY_BYTES.get(words[1], 0) + corners * _PLY_BYTES.get(words[2], 0)


def _off(path: Path, limits: Limits) -> None:
    with open_for_reading(path) as file:
        lines = (line.partition(b"#")[0].strip() for line in file)
        words: list[bytes] = []
        n_lines = 0
        for line in lines:
            if len(words) < 3:
                words += line.replace(b"OFF", b"OFF ", 1).split()
            elif line:
                n_lines += 1
    if not words or words[0] not in (b"OFF", b"COFF"):
        raise InputError(
            f"{path.name} could not be read as a mesh: it should begin with OFF."
        )
    if len(words) < 3 or not all(word.isdigit() for word in words[1:3]):
        raise InputError(
            f"{path.name}: after OFF should come the numbers of vertices and faces."
        )
    vertices, faces = int(words[1]), int(words[2])
    check_counts(path.name, vertices, faces, limits)
    _expect_lines(path, vertices + faces, n_lines)


def _count_lines(file: Any) -> int:
    n_lines, ends = 0, True
    while chunk := file.read(1 << 22):
        n_lines += chunk.count(b"\n")
        ends = chunk.endswith(b"\n")
    return n_lines + (not ends)


def _expect_lines(path: Path, announced: int, found: int) -> None:
    if found < announced:
        raise InputError(
            f"{path.name} announces {announced:,} lines of vertices and faces, but has "
            f"{found:,}; it is truncated. Export or copy it again."
        )


def _stl(path: Path, limits: Limits) -> None:
    size = path.stat().st_size
    with open_for_reading(path) as file:
        head = file.read(84)
        announced = struct.unpack("<I", head[80:84])[0] if len(head) == 84 else 0
        is_text = head.lstrip().lower().startswith(b"solid")
        behind = size - 84 - 50 * announced
        # Some programs write remarks behind the last triangle; never whole triangles.
        has_remarks = not is_text and announced > 0 and behind > 0 and behind % 50 != 0
        if len(head) == 84 and (behind == 0 or has_remarks):
            check_counts(path.name, 3 * announced, announced, limits)
            return
        if not is_text:
            raise InputError(
                f"{path.name} announces {announced:,} triangles, but holds "
                f"{max(size - 84, 0) // 50:,}; it is truncated or not an STL mesh. "
                "Export or copy it again."
            )
        file.seek(max(0, size - 1000))
        if b"endsolid" not in file.read().lower():
            raise InputError(
                f"{path.name} has no endsolid at its end; it is truncated. Export or "
                "copy it again."
            )


def _glb(path: Path, limits: Limits) -> None:
    size = path.stat().st_size
    with open_for_reading(path) as file:
        head = file.read(20)
        if len(head) < 20 or head[:4] != b"glTF":
            raise InputError(
                f"{path.name} could not be read as a mesh: it should begin with glTF."
            )
        version, length, json_length, kind = struct.unpack("<IIII", head[4:])
        if version != 2 or kind != JSON_CHUNK:
            raise InputError(
                f"{path.name} is not glTF 2.0 with its description first; export it "
                "again as GLB, version 2."
            )
        if length > size or 20 + json_length > size:
            raise InputError(
                f"{path.name} announces {length:,} bytes, but has {size:,}; it is "
                "truncated. Export or copy it again."
            )
        try:
            document = json.loads(file.read(json_length))
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"{path.name}: its description is not JSON; the file is damaged."
            ) from error
    most = VERTICES_A_FACE * limits.faces_millions * 1e6
    for accessor in _entries(path, document, "accessors"):
        count = accessor.get("count")
        if type(count) is not int or count < 0:
            raise InputError(
                f"{path.name}: an accessor's count should be a whole number, but is "
                f"{count!r:.40}."
            )
        if count > most:
            raise InputError(
                f"{path.name} announces {count:,} numbers in one array; up to "
                f"{limits.faces_millions:g} million triangles are read. Decimate it "
                "first."
            )
        if "bufferView" not in accessor and count > size:
            raise InputError(
                f"{path.name} announces {count:,} numbers that it does not hold (it may "
                "be compressed); export it again as plain GLB."
            )
    _check_tree(path, document)


def _check_tree(path: Path, document: Any) -> None:
    """Raises InputError unless every node has one parent at most, and none itself."""
    nodes = list(_entries(path, document, "nodes"))
    children = [child for node in nodes for child in node.get("children", ())]
    good = all(type(child) is int and 0 <= child < len(nodes) for child in children)
    if not good or len(set(children)) != len(children):
        raise InputError(
            f"{path.name}: its nodes should be a tree, but one has two parents or does "
            "not exist."
        )
    parents = {
        child: i for i, node in enumerate(nodes) for child in node.get("children", ())
    }
    for i in range(len(nodes)):
        seen = {i}
        while i in parents:
            i = parents[i]
            if i in seen:
                raise InputError(f"{path.name}: one of its nodes is its own ancestor.")
            seen.add(i)


def _entries(path: Path, document: Any, key: str) -> Iterator[dict[str, Any]]:
    entries = document.get(key, []) if isinstance(document, dict) else None
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise InputError(f"{path.name}: its {key} should be a list of objects.")
    for entry in entries:
        if not isinstance(entry.get("children", []), list):
            raise InputError(f"{path.name}: a node's children should be a list.")
    yield from entries
