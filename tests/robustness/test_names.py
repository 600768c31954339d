"""Names that cannot be shown or kept: told in percent signs, the file found all the same."""

import os
import sys
from pathlib import Path

import pytest

from app.control.project_reading import read_all
from app.control.projects import Projects
from app.engine.scene_opening import open_files
from app.engine.warm_up import toy_scene
from app.model import photo_list
from app.model.scene_files import photo_files
from app.model.session import Session
from app.model.state import Document, PhotoEntry, State
from photoreg.errors import InputError
from photoreg.formats.cameras.registry import photos_by_name
from photoreg.formats.photos.read import load_photo
from photoreg.names import path_of, presentable, stored_path
from tests.robustness.lying_photos import png

needs_bytes = pytest.mark.skipif(
    sys.platform in ("win32", "darwin"), reason="names are always Unicode there"
)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("left.jpg", "left.jpg"),
        ("Söl \u6d77 \U0001f41a\ufe0f'.png", "Söl \u6d77 \U0001f41a\ufe0f'.png"),
        (os.fsdecode(b"\xff\xe9.png"), "%FF%E9.png"),
        ("\ud800.png", "%ED%A0%80.png"),
        ("a\u202egpj.exe", "a%E2%80%AEgpj.exe"),
        ("a\nb\x7f\u2028.png", "a%0Ab%7F%E2%80%A8.png"),
    ],
)
def test_names_are_told_apart_and_can_be_shown(name, shown):
    assert presentable(name) == shown
    assert presentable(shown) == shown
    shown.encode()


def test_paths_are_kept_as_text_or_bytes():
    for name in ("plain.png", "Söl.png", os.fsdecode(b"\xff.png")):
        path = Path("a") / name
        assert path_of(stored_path(path)) == path


@needs_bytes
def test_a_photo_whose_name_is_no_text_is_opened_kept_and_found_again(tmp_path):
    path = tmp_path / os.fsdecode(b"caf\xe9\xff.png")
    path.write_bytes(png())
    photo = load_photo(path)
    assert photo.name == "caf%E9%FF.png"
    assert photos_by_name([path]) == {photo.name: path}
    document = open_files([path])
    assert photo_files(document) == {photo.name: path}
    session = Session()
    projects = Projects(session, read=read_all)
    projects.new(document, tmp_path / "project")
    assert projects.wait(20)
    assert not session.state.saving
    projects.close()
    again = Session()
    reopened = Projects(again, read=read_all)
    reopened.open(tmp_path / "project")
    try:
        assert again.state.waiting is None
        (entry,) = again.state.document.photos
        assert entry.name == photo.name
        assert entry.photo.source is not None
        assert entry.photo.source.path == path
    finally:
        reopened.close()


@pytest.mark.parametrize("name", ["\ud800.png", "a\u202egpj.png", "a\x7f.png"])
def test_a_photo_is_not_renamed_to_what_cannot_be_kept(name):
    mesh, photos, cameras = toy_scene()
    entries = tuple(map(PhotoEntry, photos, cameras))
    state = State(document=Document(mesh, mesh, entries))
    with pytest.raises(InputError, match="cannot be shown or kept") as refused:
        photo_list.renamed(photos[0].name, name)(state)
    str(refused.value).encode()
