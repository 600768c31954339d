"""STL, as text or binary, by trimesh."""

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from photoreg.formats.meshes.contents import MeshContents
from photoreg.limits import Limits
from photoreg.sources import read_regular


def read_stl(path: Path, limits: Limits) -> MeshContents:
    """Reads an STL file; the corners that lie at one place become one vertex."""
    del limits  # Checked by its header.
    content = read_regular(path)
    notes: tuple[str, ...] = ()
    announced = struct.unpack_from("<I", content.ljust(84, b"\0"), 80)[0]
    end = 84 + 50 * announced
    if content.lstrip()[:5].lower() != b"solid" and len(content) > end:
        notes = (
            f"{len(content) - end:,} bytes after its last triangle were left out.",
        )
        content = content[:end]
    if announced > 0 and len(content) == end:
        rows = np.frombuffer(content, dtype=np.uint8, offset=84).reshape(announced, 50)
        if rows[:, 48:].any():
            notes = (*notes, "Colours of its faces (attribute bytes) were left out.")
    loaded: Any = trimesh.load_mesh(io.BytesIO(content), file_type="stl", process=False)
    vertices, index = np.unique(loaded.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[np.asarray(loaded.faces)]
    return MeshContents(vertices=vertices, faces=faces, notes=notes)
