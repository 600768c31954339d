"""Text PLY made binary holds what plyfile reads of the text, or is left to it."""

import io

import numpy as np
import plyfile
import pytest

from photoreg.formats.meshes.ply_text import as_binary

HEAD = (
    "ply\nformat ascii 1.0\ncomment a b\nelement vertex 3\nproperty float x\nproperty "
    "double y\nproperty float z\nproperty uchar red\nelement face 2\nproperty list uchar "
    "int vertex_indices\nproperty list uint8 float32 texcoord\nproperty short flag\n"
    "element edge 0\nproperty int vertex1\nend_header\n"
)
BODY = (
    "0.1 -1e-3 1e30 255\n\n 1 0.123456789012345 3.4 0\r\n-0 2 3\t7 \n"
    "3 0 1 2 6 0 0 1 0 0 0.7 -5\n3 2 1 0 6 0 0 1 0 0 1 300\n"
)


def test_the_numbers_are_those_that_plyfile_reads():
    made = as_binary((HEAD + BODY).encode())
    assert made is not None
    binary, lengths = made
    assert lengths["face"] == {"vertex_indices": 3, "texcoord": 6}
    rows = BODY.replace("\n\n", "\n").replace("\r", "")
    expected = plyfile.PlyData.read(io.StringIO(HEAD + rows))
    ply = plyfile.PlyData.read(io.BytesIO(binary), known_list_len=lengths)
    assert ply.comments == expected.comments
    for name in ("vertex", "face", "edge"):
        mine, theirs = ply[name].data, expected[name].data
        assert mine.dtype.names == theirs.dtype.names
        for field in mine.dtype.names:
            for a, b in zip(mine[field], theirs[field], strict=True):
                np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("3 2 1 0 6", "4 2 1 0 1 6"),  # Polygons of several lengths.
        ("0 1 300\n", "0 1\n"),  # A word too few,
        ("3\t7 \n", "3 7 9\n"),  # or too many,
        ("0 1 300\n", "0 1 300\n1 2 3\n"),  # or a line.
        ("1e30", "far"),
        (" 255\n", " 256\n"),
        (" 255\n", " 2.5\n"),
        (" -5\n", " -50000\n"),
        ("3 0 1 2 6", "-3 0 1 2 6"),
        ("-0 2", "-0 0x2"),
    ],
)
def test_what_is_not_plain_is_left_to_plyfile(old, new):
    assert old in BODY
    assert as_binary((HEAD + BODY.replace(old, new)).encode()) is None
