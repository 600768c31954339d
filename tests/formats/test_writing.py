"""Nothing of the user's is written over: inputs never, other files only if asked to."""

import contextlib
import functools
import hashlib
import io
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image

from photoreg.cli import commands as cli_commands
from photoreg.cli import refine as cli_refine
from photoreg.cli import texture as cli_texture
from photoreg.errors import OutputError
from photoreg.formats import writing
from photoreg.formats.cameras.camera_set import CameraSet, FormatName
from photoreg.formats.cameras.cameras_json import CameraFile, load_cameras, save_cameras
from photoreg.formats.cameras.registry import WRITTEN_FORMATS, write_cameras
from photoreg.formats.mark import is_marked, marked_picture
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.encode_texture import PictureKind, encode_picture
from photoreg.formats.models.ply import save_mesh
from photoreg.formats.models.registry import save_textured, textured_files
from photoreg.formats.writing import check_outputs, write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.registration.events import Progress
from photoreg.texture.bake import TexturedMesh, bake_texture
from photoreg.texture.config import TextureConfig
from tests.formats.camera_files import PLACES
from tests.painted import ball_and_moon, cameras_around, photograph

PHOTOS = ("shell.png", "right.jpg")
"""The first is named as the texture of shell.obj will be."""


@functools.cache
def world() -> tuple[Mesh, list[Camera], list[Photo], TexturedMesh]:
    """A small mesh, two cameras, their photos, and the texture baked from them."""
    mesh, cameras = ball_and_moon(1), cameras_around(2, 64, 48)
    photos = [
        photograph(mesh, camera, name)
        for name, camera in zip(PHOTOS, cameras, strict=True)
    ]
    return (
        mesh,
        cameras,
        photos,
        bake_texture(mesh, photos, cameras, TextureConfig(size=64)),
    )


def write_world(folder: Path) -> None:
    """A scan that is textured already, its photos, cameras of several formats."""
    mesh, cameras, photos, _ = world()
    for photo in photos:
        Image.fromarray(photo.pixels).save(folder / photo.name)
    save_mesh(folder / "s.ply", mesh)
    given = CameraSet(
        dict(zip(PHOTOS, cameras, strict=True)), {n: folder / n for n in PHOTOS}
    )
    write_cameras(folder / "rough.json", given)
    write_cameras(folder / "b.out", given, "bundler")
    write_cameras(folder / "model", given, "colmap")
    obj = "".join("v {} {} {}\n".format(*v) for v in mesh.vertices)
    obj += "mtllib scan.mtl\nusemtl scan\nvt 0 0\nvt 1 0\nvt 0 1\n"
    obj += "".join("f {}/1 {}/2 {}/3\n".format(*(f + 1)) for f in mesh.faces)
    (folder / "scan.obj").write_text(obj)
    (folder / "scan.mtl").write_text("newmtl scan\nmap_Kd scan.png\n")
    Image.new("RGB", (8, 8), (9, 99, 199)).save(folder / "scan.png")


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    write_world(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@contextlib.contextmanager
def quick() -> Iterator[None]:
    """The commands with their long work taken out; files are read and written."""
    _, cameras, _, textured = world()
    moved = [
        Camera(c.K, c.R_cam_world, c.t_cam_world + 0.01, c.width, c.height)
        for c in cameras
    ]
    progress = mock.Mock(Progress, cameras=moved, best_cost=1.0, fraction=1.0, step="")
    written = SimpleNamespace(paths=(), runs=())

    def reproduced(out: Path, *_: object, overwrite: bool) -> Iterator[object]:
        from photoreg.paper.report import report_files

        out.mkdir(exist_ok=True)
        paths = report_files(out)
        check_outputs(paths, overwrite=overwrite)
        text = "<!-- made by photoreg -->\n"
        picture = encode_picture(np.zeros((8, 8, 3), dtype=np.uint8), "jpeg")
        contents = {p: picture if p.suffix == ".jpg" else text for p in paths}
        contents[out / "results.json"] = '{"format": "photoreg-results"}'
        write_files(contents, overwrite=overwrite)
        yield written

    with (
        mock.patch.object(cli_refine, "refine_in_attempts", return_value=[progress]),
        mock.patch.object(cli_texture, "baking", return_value=[textured]),
        mock.patch.object(cli_commands, "reproduce", reproduced),
        mock.patch.object(cli_commands, "Reproduced", SimpleNamespace),
    ):
        yield


def status_of(*words: object) -> tuple[int, str]:
    said = io.StringIO()
    with quick(), contextlib.redirect_stderr(said):
        status = cli_commands.run([str(word) for word in words])
    return status, " ".join(said.getvalue().split())


def texture(*words: object, mesh: str = "s.ply") -> tuple[int, str]:
    return status_of("texture", mesh, *PHOTOS, "--cameras", "rough.json", *words)


def digest(path: Path) -> tuple[object, ...]:
    """What a path is, its link and its content; nothing that reading changes."""
    status = path.lstat()
    if stat.S_ISLNK(status.st_mode):
        return "link", str(path.readlink())
    if not stat.S_ISREG(status.st_mode):
        return ("other", stat.S_IFMT(status.st_mode))
    return "file", status.st_ino, hashlib.sha256(path.read_bytes()).hexdigest()


def tree(*folders: Path) -> dict[Path, tuple[object, ...]]:
    return {
        path: digest(path) for folder in folders for path in sorted(folder.rglob("*"))
    }


# The cases that were seen.


def test_the_texture_does_not_replace_a_photo_of_its_name(folder):
    before = tree(folder)
    status, said = texture("--out", "shell.obj")
    assert status == 2
    assert "shell.png is read by this command" in said
    assert tree(folder) == before
    assert texture("--out", "shell.obj", "--overwrite")[0] == 2
    assert tree(folder) == before
    assert texture("--out", "model.obj")[0] == 0


def test_the_model_does_not_replace_the_scan(folder):
    before = tree(folder)
    for words in (["--out", "s.ply"], ["--out", "s.ply", "--overwrite"]):
        status, said = texture(*words)
        assert (status, "s.ply is read by this command" in said) == (2, True)
    assert tree(folder) == before


def test_nor_what_the_scan_names_its_material_and_its_texture(folder):
    before = tree(folder)
    # The scan itself is model and texture of this name; a PLY has the texture alone.
    status, said = texture("--out", "scan.ply", "--overwrite", mesh="scan.obj")
    assert (status, "scan.png is read by this command" in said) == (2, True)
    (folder / "SCAN.obj").write_text((folder / "scan.obj").read_text())
    (folder / "SCAN.obj").unlink()
    assert tree(folder) == before


def test_cameras_do_not_replace_those_that_were_read(folder):
    refine = ["refine", "s.ply", *PHOTOS, "--cameras", "rough.json"]
    before = tree(folder)
    for words in (
        [*refine, "--out", "rough.json", "--overwrite"],
        ["convert", "rough.json", "--out", "rough.json", "--overwrite"],
        ["convert", "b.out", "--out", "b.out", "--photos", ".", "--overwrite"],
        ["convert", "model", "--out", "model", "--to", "colmap", "--overwrite"],
    ):
        status, said = status_of(*words)
        assert (status, "read by this command" in said) == (2, True), (words, said)
    assert tree(folder) == before


def test_all_that_is_in_the_way_is_said_in_one_sentence(folder):
    (folder / "m.mtl").write_text("newmtl mine")
    (folder / "m.png").write_bytes(b"mine")
    status, said = texture("--out", "m.obj", "--coverage", "right.jpg.png")
    assert status == 2
    assert "m.mtl and m.png are there and not photoreg's" in said
    assert "--overwrite" in said
    assert texture("--out", "m.obj", "--overwrite")[0] == 0
    assert is_marked(folder / "m.mtl")
    assert is_marked(folder / "m.png")


def test_it_is_said_before_the_work(folder):
    (folder / "m.png").write_bytes(b"mine")
    with mock.patch.object(
        cli_texture, "load_told", side_effect=AssertionError("too late")
    ):
        assert texture("--out", "m.obj")[0] == 2
        (folder / "r.json").write_text("{}")
        words = ["refine", "s.ply", *PHOTOS, "--cameras", "rough.json", "--out"]
        assert status_of(*words, "r.json")[0] == 2


def test_two_outputs_are_not_one_file(folder):
    before = tree(folder)
    status, said = texture("--out", "m.obj", "--coverage", "m.png")
    assert (status, "same place" in said) == (2, True)
    assert tree(folder) == before


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda path: path.symlink_to("shell.png"), "is read by this command"),
        (lambda path: os.link("shell.png", path), "is read by this command"),
        (lambda path: path.symlink_to("nowhere"), "not photoreg's"),
        (lambda path: path.symlink_to("scan.png"), "not photoreg's"),
        (lambda path: path.write_bytes(b""), "not photoreg's"),
        (lambda path: path.mkdir(), "is a folder"),
        (os.mkfifo, "no ordinary file"),
    ],
)
def test_links_empty_files_folders_and_pipes_are_in_the_way(folder, make, sentence):
    make(folder / "m.png")
    before = tree(folder)
    status, said = texture("--out", "m.obj")
    assert (status, sentence in said) == (2, True), said
    assert tree(folder) == before


def test_a_link_is_replaced_and_not_written_through(folder):
    (folder / "m.png").symlink_to("scan.png")
    before = digest(folder / "scan.png")
    assert texture("--out", "m.obj", "--overwrite")[0] == 0
    assert not (folder / "m.png").is_symlink()
    assert digest(folder / "scan.png") == before


def test_a_folder_that_takes_capitals_for_small_letters_holds_both_names_once(
    folder, monkeypatch
):
    write_files({folder / "one.txt": "a", folder / "ONE.txt": "b"})
    monkeypatch.setattr(writing, "_folds_case", lambda _: True)
    with pytest.raises(OutputError, match="same place"):
        write_files({folder / "two.txt": "a", folder / "TWO.txt": "b"})
    assert not (folder / "two.txt").exists()


# The mark.


@pytest.mark.parametrize("name", WRITTEN_FORMATS)
def test_cameras_are_written_again_unasked_where_their_format_has_a_mark(
    folder, name: FormatName
):
    place = folder / "new" / PLACES[name]
    place.parent.mkdir()
    _, cameras, _, _ = world()
    photos = {n: folder / n for n in PHOTOS}
    write_cameras(
        place, CameraSet(dict(zip(PHOTOS, cameras, strict=True)), photos), name
    )
    # Once more the same is no loss, mark or not.
    write_cameras(
        place, CameraSet(dict(zip(PHOTOS, cameras, strict=True)), photos), name
    )
    other = CameraSet(dict(zip(PHOTOS, cameras[::-1], strict=True)), photos)
    before = tree(place.parent)
    if name in ("colmap", "bundler"):
        with pytest.raises(OutputError, match=r"not photoreg's.*--overwrite"):
            write_cameras(place, other, name)
        assert tree(place.parent) == before
        write_cameras(place, other, name, overwrite=True)
    else:
        write_cameras(place, other, name)
    assert tree(place.parent) != before


@pytest.mark.parametrize("picture", ["png", "jpeg"])
@pytest.mark.parametrize("name", ["m.obj", "m.ply", "m.glb"])
def test_every_file_of_a_model_has_the_mark_and_is_replaced_unasked(
    tmp_path, name, picture: PictureKind
):
    *_, textured = world()
    files = save_textured(tmp_path / name, textured, picture=picture)
    assert files == textured_files(tmp_path / name, picture=picture)
    assert all(map(is_marked, files))
    assert save_textured(tmp_path / name, textured, picture=picture) == files
    assert sorted(tmp_path.iterdir()) == sorted(files)


def test_pictures_keep_their_pixels_and_tell_who_made_them(tmp_path):
    pixels = np.random.default_rng(3).integers(0, 256, (9, 14, 3), dtype=np.uint8)
    kinds: dict[PictureKind, str] = {"png": "Software", "jpeg": "comment"}
    for kind, said in kinds.items():
        path = tmp_path / f"a.{kind}"
        path.write_bytes(encode_picture(pixels, kind))
        with Image.open(path) as image:
            image.load()
            assert b"photoreg" in str(image.info[said]).encode()
            if kind == "png":
                np.testing.assert_array_equal(np.asarray(image), pixels)
    assert marked_picture(b"neither") == b"neither"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"# photoreg\n",
        b"# photoreg is made by others\n",
        b'{"by": "me", "format": "photoreg-cameras"}',
        b'{"format": "other"}',
        b"glTF",
        b"glTF\2\0\0\0\xff\xff\xff\xff\xff\xff\xff\xffJSON[[[[",
        b"\x89PNG\r\n\x1a\n made by photoreg",
        b"\xff\xd8\xff\xe0 made by photoreg",
        b"\n\n\n\n\n\n# made by photoreg\n",
    ],
)
def test_what_only_resembles_the_mark_is_not_photoreg_s(tmp_path, content):
    (tmp_path / "a").write_bytes(content)
    assert not is_marked(tmp_path / "a")


def test_the_library_may_save_what_it_loaded(folder):
    """Only a command knows that it is one; a program of a user's may well do this."""
    file = load_cameras(folder / "rough.json")
    save_cameras(folder / "rough.json", file)
    (folder / "mine.json").write_text("{}")
    with pytest.raises(OutputError, match="not photoreg's"):
        save_cameras(folder / "mine.json", file)
    save_cameras(folder / "mine.json", CameraFile(file.cameras), overwrite=True)


def test_the_library_does_not_write_over_the_mesh_that_it_textured(folder):
    _, cameras, photos, _ = world()
    mesh = load_mesh(folder / "s.ply")
    textured = bake_texture(mesh, photos, cameras, TextureConfig(size=64))
    before = tree(folder)
    with pytest.raises(OutputError, match=r"s\.ply is read"):
        save_textured(folder / "s.ply", textured, overwrite=True)
    assert tree(folder) == before


# Whole or not at all.


def test_files_of_others_called_part_stay(folder):
    (folder / "m.obj.part").write_bytes(b"a download")
    (folder / "m.png.part").write_bytes(b"a download")
    assert texture("--out", "m.obj")[0] == 0
    assert (folder / "m.obj.part").read_bytes() == b"a download"
    assert (folder / "m.png.part").read_bytes() == b"a download"


@pytest.mark.parametrize("failing", [1, 2, 3])
def test_if_one_cannot_be_put_in_place_the_old_ones_come_back(
    folder, monkeypatch, failing
):
    assert texture("--out", "m.obj", "--coverage", "c.png")[0] == 0
    (folder / "m.mtl").unlink()
    before = tree(folder)
    replace, calls = Path.replace, []

    def fails(self: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) == failing:
            raise OSError(5, "Input/output error")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", fails)
    status, said = texture("--out", "m.obj")
    assert (status, "Input/output error" in said) == (2, True)
    assert tree(folder) == before


def test_ctrl_c_while_writing_leaves_the_old_ones(folder, monkeypatch):
    assert texture("--out", "m.obj")[0] == 0
    before = tree(folder)
    monkeypatch.setattr(os, "fsync", mock.Mock(side_effect=KeyboardInterrupt))
    assert texture("--out", "m.obj")[0] == 1
    assert tree(folder) == before


def test_who_may_read_a_file_may_read_its_successor(folder):
    words = ["convert", "rough.json", "--out", "c.json"]
    assert status_of(*words)[0] == 0
    (folder / "c.json").chmod(0o600)
    assert status_of(*words)[0] == 0
    assert (folder / "c.json").stat().st_mode & 0o777 == 0o600


# Any command among any files.

STEMS = ("s", "shell", "SHELL", "right", "rough", "out", "Out", "scan", "b", "b.list")
SUFFIXES = (*(".png", ".jpg", ".obj", ".mtl", ".ply", ".glb", ".json", ".out"), ".txt",
            *(".mlp", ".yml", ".py", ".cam", ".png.part"))  # fmt: skip
FIXED = (
    *("cameras.bin", "images.bin", "points3D.bin", "cameras.txt", "images.txt"),
    *("points3D.txt", "report.md", "report.html", "results.json", "figure4.svg"),
    *("photo1.jpg", "transforms.json"),
)
NAMES = st.one_of(
    st.builds(str.__add__, st.sampled_from(STEMS), st.sampled_from(SUFFIXES)),
    st.sampled_from(FIXED),
)
KINDS = st.sampled_from(
    ["file", "file", "empty", "link to input", "link out", "hard link", "hard link out",
     "dangling", "folder", "pipe", "ours"]
)  # fmt: skip
FOLDERS = st.sampled_from([".", "new", "model", "alias"])
MESHES = st.sampled_from(["s.ply", "scan.obj"])


@st.composite
def commands(draw: st.DrawFn) -> list[str]:
    """The words of a command that writes."""
    which = draw(st.sampled_from(["texture", "refine", "convert", "reproduce", "make"]))
    where = draw(FOLDERS)
    words = ["--overwrite"] if draw(st.booleans()) else []
    stem = draw(st.sampled_from(STEMS))
    if which == "make":
        return ["synthesize", where, "--kind", "clean", "--n-faces", "20", "--width",
                "32", "--height", "24"]  # fmt: skip
    if which == "reproduce":
        return ["reproduce", "--out", where, *words]
    if which == "convert":
        name = draw(st.sampled_from(sorted(WRITTEN_FORMATS)))
        place = WRITTEN_FORMATS[name].place
        out = where if place == "folder" else f"{where}/{stem}{place}"
        if name == "nerfstudio":
            out = f"{where}/transforms.json"
        source = draw(st.sampled_from(["rough.json", "b.out", "model"]))
        return ["convert", source, "--out", out, "--to", name, "--mesh", draw(MESHES),
                "--photos", *PHOTOS, *words]  # fmt: skip
    words = ["--cameras", "rough.json", *words]
    if which == "refine":
        return [which, draw(MESHES), *PHOTOS, *words, "--out", f"{where}/{stem}.json"]
    suffix = draw(st.sampled_from([".obj", ".ply", ".glb"]))
    if suffix == ".ply" and draw(st.booleans()):
        words += ["--at-vertices"]
    if draw(st.booleans()):
        words += ["--picture", "jpeg"]
    if draw(st.booleans()):
        words += ["--coverage", f"{draw(FOLDERS)}/{draw(st.sampled_from(STEMS))}.png"]
    return [which, draw(MESHES), *PHOTOS, *words, "--out", f"{where}/{stem}{suffix}"]


@functools.cache
def pattern() -> Path:
    """A folder to be copied for each case."""
    folder = Path(tempfile.mkdtemp(prefix="photoreg-test-"))
    write_world(folder)
    (folder / "new").mkdir()
    (folder / "alias").symlink_to(".", target_is_directory=True)
    return folder


def put(folder: Path, outside: Path, where: str, name: str, kind: str) -> None:
    """Something of the user's at a place that is free."""
    path = folder / where / name
    if os.path.lexists(path):
        return
    other = outside / f"{len(list(outside.iterdir()))}"
    other.write_bytes(b"the user's " + name.encode())
    match kind:
        case "file":
            path.write_bytes(b"the user's " + name.encode())
        case "empty":
            path.touch()
        case "link to input":
            path.symlink_to(folder / "shell.png")
        case "link out":
            path.symlink_to(other)
        case "hard link":
            os.link(folder / "right.jpg", path)
        case "hard link out":
            os.link(other, path)
        case "dangling":
            path.symlink_to("nowhere at all")
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "ours":
            path.write_bytes(b"# made by photoreg\n")


def read_by(words: list[str]) -> list[str]:
    """Patterns of the files that a command reads."""
    if words[0] in ("synthesize", "reproduce"):
        return []
    parts = {"model": ["model/*.bin"], "b.out": ["b.list.txt"], "scan.obj": ["scan.*"]}
    given = [words[1], *(w for w in words if w in (*PHOTOS, "rough.json", "s.ply"))]
    if words[0] == "convert" and words[1] != "rough.json":
        given = [word for word in given if word != "rough.json"]
    return [*given, *(name for word in given for name in parts.get(word, []))]


def what_a_command_leaves(words: list[str], files: list[tuple[str, str, str]]) -> None:
    """Runs a command in a folder of the user's files, and compares before and after."""
    with tempfile.TemporaryDirectory() as base:
        folder, outside = Path(base) / "in", Path(base) / "out"
        shutil.copytree(pattern(), folder, symlinks=True)
        outside.mkdir()
        for where, name, kind in files:
            put(folder, outside, where, name, kind)
        inputs = {path for name in read_by(words) for path in folder.glob(name)}
        before = tree(folder, outside)
        ours = {p for p in before if p.is_file() and is_marked(p)} - inputs
        with contextlib.chdir(folder):
            status, said = status_of(*words)
        assert status in (0, 2), said
        after = tree(folder, outside)
        changed = {p for p in before if after.get(p) != before[p]}
        context = (words, files, said)
        assert not changed & inputs, context
        assert not [p for p in changed if not p.is_relative_to(folder)], context
        if status == 2:
            assert not changed, context
            # Of what it could not write it leaves an empty folder at most.
            assert not [p for p in set(after) - set(before) if p.is_file()], context
        if "--overwrite" not in words:
            assert changed <= ours, context
        # What is there now and was not before is all photoreg's, or a copied photo.
        assert not [p for p in after if p.suffix in (".part", ".old", ".trial")
                    and p not in before], context  # fmt: skip
        assert set(before) <= set(after), context


def test_of_any_command_among_any_files_none_is_lost() -> None:
    any_command_among_any_files(20)


@pytest.mark.slow
def test_of_a_thousand_commands_among_any_files_none_is_lost() -> None:
    any_command_among_any_files(1000)


def any_command_among_any_files(n: int) -> None:
    @settings(
        max_examples=n, deadline=None, suppress_health_check=[HealthCheck.too_slow]
    )
    @given(commands(), st.lists(st.tuples(FOLDERS, NAMES, KINDS), max_size=8))
    @example(["texture", "s.ply", *PHOTOS, "--cameras", "rough.json", "--out",
              "./shell.obj"], [])  # fmt: skip
    @example(["texture", "s.ply", *PHOTOS, "--cameras", "rough.json", "--overwrite",
              "--out", "alias/s.ply"], [])  # fmt: skip
    @example(["convert", "rough.json", "--out", "new", "--to", "texrecon", "--photos",
              *PHOTOS, "--overwrite"], [("new", "shell.png", "link to input")])  # fmt: skip
    def check(words: list[str], files: list[tuple[str, str, str]]) -> None:
        what_a_command_leaves(words, files)

    check()
