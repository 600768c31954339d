"""OFF and COFF, with colours at the vertices."""

from pathlib import Path

import numpy as np

from photoreg.errors import InputError
from photoreg.formats.meshes.contents import MeshContents, colours_of
from photoreg.formats.meshes.polygons import triangle_corners
from photoreg.limits import Limits
from photoreg.sources import read_regular


def read_off(path: Path, limits: Limits) -> MeshContents:
    """Reads an OFF file as text; trimesh drops colours and cuts polygons as fans.

    Raises:
        InputError: if its words are not what should stand there.
    """
    del limits  # Checked by its header.
    text = read_regular(path).decode("utf-8-sig", "replace")
    rows = [
        row.split()
        for line in text.splitlines()
        if (row := line.partition("#")[0].strip())
    ]
    keyword = rows[0].pop(0)
    has_colours = keyword.startswith("C")
    if len(keyword) > len("OFF") and keyword not in ("OFF", "COFF"):
        # The numbers may follow without a space.
        rows[0].insert(0, keyword.removeprefix("C").removeprefix("OFF"))
    rows = [row for row in rows if row]
    try:
        n, m = int(rows[0][0]), int(rows[0][1])
        width = min(map(len, rows[1 : n + 1]), default=3)
        table = np.array([row[:width] for row in rows[1 : n + 1]], dtype=np.float64)
        table = table.reshape(n, width)
        polygons = [
            np.array(row[1 : int(row[0]) + 1], dtype=np.int64)
            for row in rows[n + 1 : n + 1 + m]
        ]
        lengths = [int(row[0]) for row in rows[n + 1 : n + 1 + m]]
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"{path.name} could not be read as a mesh: there are words where numbers "
            "should be. Is the file complete?"
        ) from error
    if width < 3 or any(
        len(polygon) != length
        for polygon, length in zip(polygons, lengths, strict=True)
    ):
        raise InputError(
            f"{path.name} could not be read as a mesh: a line has fewer numbers than it "
            "should. Is the file complete?"
        )
    vertices = table[:, :3]
    counts = np.array(lengths, dtype=np.int64)
    corners = np.concatenate([*polygons, np.zeros(0, dtype=np.int64)])
    cut, _ = triangle_corners(vertices, corners, counts, path.name)
    colours = colours_of(table[:, 3:6]) if has_colours and width >= 6 else None
    has_face_colours = any(
        len(row) > length + 1
        for row, length in zip(rows[n + 1 : n + 1 + m], lengths, strict=True)
    )
    note = "Colours of its faces were left out; colours at the vertices are kept."
    return MeshContents(
        vertices=vertices,
        faces=corners[cut],
        vertex_colours=colours,
        notes=(note,) if has_face_colours else (),
    )
