"""Files that cannot be read for want of what the system gives: told, and all goes on."""

import contextlib
import errno
import io
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.control.file_intake import Batch, FileIntake
from app.engine import read_job
from app.engine.scene_opening import demo_folder
from app.model.messages import MeshLoaded, PhotoLoaded
from app.model.session import Session
from app.model.state import Document, State
from app.page.main import open_document
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.formats.meshes.read import load_mesh
from tests.moved_cameras import write_moved

DEMO = ("shell.ply", "shell-left.jpg", "shell-right.jpg")


@pytest.fixture
def intake():
    intake = FileIntake(Session(), lambda: None, lambda *_: None)
    yield intake
    intake.close()


def announced(intake: FileIntake) -> None:
    intake.expect(1, 2)


def opened(intake: FileIntake) -> None:
    intake.open_one("left.png", b"x")


def test_what_was_opened_is_told_and_the_step_that_comes_next():
    document = open_document([demo_folder() / name for name in DEMO], None)
    mesh, display = document.mesh, document.display_mesh
    assert mesh is not None
    assert display is not None
    scan = MeshLoaded(mesh, display)
    photos = [PhotoLoaded(entry.photo) for entry in document.photos]
    for loaded, note in (
        (
            [scan, *photos],
            "Opened shell.ply and 2 photos. Next: find the cameras, in tab 2.",
        ),
        (photos, "Opened 2 photos. Next: drop the scan."),
    ):
        batch = Batch("Open", DEMO[0], begins_anew=True, loaded=list(loaded))
        assert batch.put_into(State()).note == note


@pytest.mark.parametrize("act", [announced, opened])
def test_after_too_many_open_files_nothing_goes_on_and_one_sentence_says_so(
    act, intake, monkeypatch
):
    def fail(*_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(read_job, "spawned", fail)
    with pytest.raises(InputError, match="Too many open files"):
        act(intake)
    assert not intake.is_busy
    assert intake._session.state.job is None


def textured_obj() -> dict[str, bytes]:
    """OBJ, MTL and picture as programs write them, and a photo."""
    buffer = io.BytesIO()
    Image.new("RGB", (32, 32), (200, 30, 10)).save(buffer, "PNG")
    obj = (
        b"mtllib my scan.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\n"
        b"vt 0 1\nusemtl a\nf 1/1 3/3 2/2\nf 1/1 2/2 4/3\nf 1/1 4/3 3/2\nf 2/1 3/2 4/3\n"
    )
    return {
        "scan.obj": obj,
        "My Scan.mtl": b"newmtl a\nKd 1 1 1\nmap_Kd -s 1 1 1 textures\\Skin 1.png\n",
        "Skin 1.png": buffer.getvalue(),
        "photo.png": buffer.getvalue(),
    }


def zipped(files: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items():
            archive.writestr(f"export/{name}", content)
    return buffer.getvalue()


def received(intake: FileIntake, files: dict[str, bytes]) -> Document:
    """What is open after these files were dropped."""
    intake.expect(1, len(files))
    for name, content in files.items():
        intake.receive(1, name, content)
    deadline = time.monotonic() + 60.0
    while intake.is_busy and time.monotonic() < deadline:
        time.sleep(0.02)
    return intake._session.state.document


@pytest.mark.parametrize("in_zip", [False, True])
def test_a_mesh_comes_with_its_materials_and_pictures_which_are_no_photos(
    in_zip, tmp_path
):
    problems: list[str] = []

    def kept(name: str, content: bytes) -> Path:
        """As a project does: each file in a folder of its own."""
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        (folder / name).write_bytes(content)
        return folder / name

    files = textured_obj()
    intake = FileIntake(
        Session(), lambda: None, lambda _, sentence: problems.append(sentence), kept
    )
    with contextlib.closing(intake):
        # What systems put into zips, a kind with a name, and kinds without.
        others = {"__MACOSX/._scan.obj": b"\0\5", "._photo.png": b"", "room.fbx": b"x"}
        others |= {"Thumbs.db": b"", **{f"{i}.notes": b"x" for i in range(7)}}
        came = {"scan.zip": zipped({**files, **others})} if in_zip else files
        document = received(intake, came)
        if in_zip:
            named, rest = problems
            assert named.startswith("room.fbx was left out: it is an FBX scene; open")
            assert rest == (
                "Left out, as photoreg opens no such files: 0.notes, 1.notes, 2.notes, "
                "3.notes, 4.notes and 2 more."
            )
            problems.clear()
        assert problems == []
        assert [entry.name for entry in document.photos] == ["photo.png"]
        mesh = document.mesh
        assert mesh is not None
        assert mesh.name == "scan.obj"
        assert mesh.own_texture is not None, mesh.notes
        assert tuple(mesh.own_texture[5, 5]) == (200, 30, 10)
        # What the project keeps opens to the same.
        assert mesh.source is not None
        again = load_mesh(mesh.source.path)
        np.testing.assert_array_equal(again.corner_uv, mesh.corner_uv)
        np.testing.assert_array_equal(again.own_texture, mesh.own_texture)
        # A mesh is there: another zip's is left, and so is what belongs to it.
        more = {"more.zip": zipped({**files, "new.png": files["photo.png"]})}
        names = [entry.name for entry in received(intake, more).photos]
        assert names == ["photo.png", "new.png"]
        with pytest.raises(InputError, match=r"My Scan\.mtl describes the materials"):
            received(intake, {"My Scan.mtl": files["My Scan.mtl"]})


def test_cameras_that_nerfstudio_moved_are_of_the_mesh_s_world_as_on_the_command_line(
    intake, tmp_path
):
    demo = demo_folder()
    files = {name: (demo / name).read_bytes() for name in DEMO}
    true = load_cameras(demo / "cameras.json")
    write_moved(tmp_path / "transforms.json", true.cameras)
    moved = {"transforms.json": (tmp_path / "transforms.json").read_bytes()}

    def check(document: Document) -> None:
        assert "this was undone" in intake._session.state.note
        for entry in document.photos:
            want = true.cameras[entry.name]
            np.testing.assert_allclose(entry.camera.P, want.P, atol=1e-6)

    check(received(intake, {**files, **moved}))
    received(intake, files)  # First cameras; then only the file of cameras comes.
    check(received(intake, moved))
    # The same from a terminal.
    paths = [demo / name for name in DEMO]
    document = open_document(paths, tmp_path / "transforms.json")
    for entry in document.photos:
        want = true.cameras[entry.name]
        np.testing.assert_allclose(entry.camera.P, want.P, atol=1e-6)
