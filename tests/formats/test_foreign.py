"""Files of kinds that are not read are refused with what they are and what to do."""

from pathlib import Path

import pytest

from app.engine.file_kinds import KINDS
from photoreg.errors import InputError
from photoreg.formats.foreign import _BY_SUFFIX, _KINDS, what_to_do
from photoreg.formats.meshes.read import load_mesh


def test_no_kind_that_is_read_is_among_them_and_none_twice():
    read = {suffix for kind in KINDS for suffix in kind}
    assert read.isdisjoint(_BY_SUFFIX)
    assert len(_BY_SUFFIX) == sum(map(len, _KINDS.values()))


def test_each_says_what_to_do():
    for suffix in _BY_SUFFIX:
        words = what_to_do(Path(f"a{suffix.upper()}"))
        assert "; " in words, words


def test_a_mesh_of_another_kind_is_refused_so(tmp_path):
    path = tmp_path / "room.usdz"
    path.write_bytes(b"PK")
    with pytest.raises(InputError, match=r"room\.usdz .*it is a USD scene; export"):
        load_mesh(path)
    path = path.rename(tmp_path / "room.odd")
    with pytest.raises(InputError, match=r"photoreg reads\. The suffix should be one"):
        load_mesh(path)
