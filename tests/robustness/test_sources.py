"""Only regular files are read: nothing in their place blocks a reader, or never ends."""

import ast
import contextlib
import os
import signal
import socket
import sqlite3
from pathlib import Path

import pytest

import app
import photoreg
from photoreg.errors import InputError
from photoreg.formats.archives import unzipped
from photoreg.formats.cameras.find import find_camera_file
from photoreg.formats.cameras.registry import read_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.project.project import Project
from photoreg.sources import open_for_reading, read_regular, source_file
from tests.robustness import lying_meshes
from tests.robustness.lying_photos import png

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no FIFOs")


@pytest.fixture(autouse=True)
def no_hang():
    """Ends a test whose reader waits for somebody."""

    def fail(*_):
        raise TimeoutError("The reader hangs.")

    signal.signal(signal.SIGALRM, fail)
    signal.alarm(60)
    yield
    signal.alarm(0)


def put(kind: str, path: Path) -> Path:
    """Something that is no file, at a path."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(str(path))
    else:
        path.symlink_to({"endless": "/dev/zero", "terminal": "/dev/tty"}[kind])
    return path


KINDS = ("pipe", "folder", "socket", "endless", "terminal")


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_file_is_not_opened_and_said_in_words(tmp_path, kind):
    path = put(kind, tmp_path / "f")
    for read in (open_for_reading, read_regular, source_file):
        with pytest.raises(OSError, match=r"it is a .*, not a file"):
            read(path)


def test_files_and_links_to_files_are_read(tmp_path):
    path, link = tmp_path / "f", tmp_path / "l"
    path.write_bytes(b"content")
    link.symlink_to(path)
    assert read_regular(path) == read_regular(link) == b"content"
    with pytest.raises(OSError, match="it is a link, not a file"):
        read_regular(link, follow_link=False)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("m.obj", load_mesh),
        ("p.png", load_photo),
        ("c.json", read_cameras),
        ("c.yaml", read_cameras),
        ("c.out", read_cameras),
        ("c.mlp", read_cameras),
        ("z.zip", lambda path: unzipped(path, path.parent / "to", lambda _: True)),
    ],
)
def test_a_reader_refuses_what_is_no_file(tmp_path, kind, name, read):
    path = put(kind, tmp_path / name)
    with pytest.raises(InputError):
        read(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("names", [("cameras.bin", "images.bin"), ("a.cam", "a.txt")])
def test_a_folder_of_cameras_is_searched_without_waiting(tmp_path, kind, names):
    for name in names:
        put(kind, tmp_path / name)
    for read in (read_cameras, find_camera_file):
        with pytest.raises(InputError):
            read(tmp_path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("named", ["m.mtl", "t.png"])
def test_what_an_obj_names_is_read_only_where_it_is_a_file(tmp_path, kind, named):
    files = {
        "m.obj": b"mtllib m.mtl\nusemtl a\nvt 0 0\nvt 1 0\nvt 0 1\n"
        + lying_meshes.obj().replace(b"f 1 2 3", b"f 1/1 2/2 3/3"),
        "m.mtl": b"newmtl a\nmap_Kd t.png\n",
        "t.png": png(),
    }
    for name, content in files.items():
        if name != named:
            (tmp_path / name).write_bytes(content)
    put(kind, tmp_path / named)
    # As where it is missing.
    assert load_mesh(tmp_path / "m.obj").own_texture is None


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_glb_or_ply_names_is_read_only_where_it_is_a_file(tmp_path, kind):
    put(kind, tmp_path / "t.bin")
    path = tmp_path / "m.ply"
    text = lying_meshes.ply(ascii_=True)
    path.write_bytes(text.replace(b"\nel", b"\ncomment TextureFile t.bin\nel", 1))
    assert load_mesh(path).own_texture is None
    glb = tmp_path / "m.glb"
    glb.write_bytes(
        lying_meshes.glb(change=lambda d: d["buffers"][0].update(uri="t.bin"))
    )
    with pytest.raises(InputError):
        load_mesh(glb)


@pytest.mark.parametrize("kind", KINDS)
def test_a_source_of_a_project_that_is_no_file_any_more_is_missing(tmp_path, kind):
    path = tmp_path / "p.png"
    path.write_bytes(png())
    project = Project(tmp_path / "project")
    with project.writing():
        key = project.files.add(source_file(path))
    path.unlink()
    put(kind, path)
    # Also where the project claims just the size that a device has.
    with contextlib.closing(sqlite3.connect(project.path)) as database, database:
        database.execute("UPDATE files SET size = 0")
    problem = project.files.problem(key)
    assert problem is not None
    with pytest.raises(InputError):
        project.files.use(key, path)
    project.close()


def test_files_are_opened_by_photoreg_sources_alone():
    """In the sources: no file is opened, or given by name to a library that opens it."""
    found = []
    for package in (photoreg, app):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.Call) and reads(ast.unparse(node)):
                    found.append(f"{path.stem}: {ast.unparse(node)[:60]}")
    assert [f for f in found if not f.startswith(tuple(ALLOWED))] == []


ALLOWED = {
    "sources": "the place",
    "photo_server": "static files of the program",
    "static_files": "the same",
    "registry: files[0]": "what it wrote itself",
    "download": "the same",
    "archives: target": "the same",
    "lock: mounts": "the system's list of what is mounted",
}


def reads(call: str) -> bool:
    return (
        any(word in call for word in (".read_bytes()", ".read_text(", "cv2.imread("))
        or call.startswith(BY_NAME)
        or (".open(" in call and "'rb'" in call)
    )


BY_NAME = (
    "open(",
    "Image.open(path",
    "np.load(",
    "np.fromfile(",
    "zipfile.ZipFile(path",
    "trimesh.load(path",
)
