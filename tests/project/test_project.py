"""The project's store: round trips, history, runs, files, locks, damage, versions."""

import dataclasses
import multiprocessing
import os
import signal
import sqlite3
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.control.autosave import DOCUMENT_TYPES
from app.engine.warm_up import toy_scene
from app.model.state import Document, PhotoEntry
from photoreg.errors import InputError, OutputError
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.ply import save_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera, same_camera
from photoreg.project import schema
from photoreg.project.files import keep_file, plain_name
from photoreg.project.folder import DATABASE
from photoreg.project.lock import is_on_network
from photoreg.project.project import Project, StoredStep
from photoreg.project.runs import StoredGeneration

TYPES = DOCUMENT_TYPES


@pytest.fixture
def files(tmp_path) -> Path:
    """A folder with a mesh and two photos, as a person has them."""
    folder = tmp_path / "my files"
    folder.mkdir()
    mesh, photos, _ = toy_scene()
    save_mesh(folder / "rock.ply", mesh)
    for photo in photos:
        cv2.imwrite(str(folder / photo.name), photo.pixels[:, :, ::-1])
    return folder


@pytest.fixture
def document(files) -> Document:
    mesh = load_mesh(files / "rock.ply")
    names = ("toy-0.png", "toy-1.png")
    entries = tuple(
        PhotoEntry(load_photo(files / name), camera)
        for name, camera in zip(names, toy_scene()[2], strict=True)
    )
    truth = (("toy-0.png", entries[0].camera),)
    return Document(mesh, mesh.decimated(200), entries, truth)


@pytest.fixture
def project(tmp_path):
    project = Project(tmp_path / "project", TYPES)
    yield project
    project.close()


def moved(document: Document, by: float) -> Document:
    """The document with its first camera moved."""
    first = document.photos[0]
    t = first.camera.t_cam_world + np.array([by, 0.0, 0.0])
    camera = dataclasses.replace(first.camera, t_cam_world=t)
    photos = (dataclasses.replace(first, camera=camera), *document.photos[1:])
    return dataclasses.replace(document, photos=photos)


def reopened(project: Project) -> Project:
    project.close()
    return Project(project.folder, TYPES, create=False)


def test_a_document_comes_back_to_the_bit(project, document):
    mask = np.zeros((120, 160), dtype=bool)
    mask[20:70, 30:90] = True
    entry = document.photos[1]
    masked = dataclasses.replace(
        entry, photo=dataclasses.replace(entry.photo, mask=mask), enabled=False
    )
    document = dataclasses.replace(document, photos=(document.photos[0], masked))
    project.write_history(-1, [StoredStep(None, document)], 0)
    project = reopened(project)
    first, (step,), now = project.read_history()
    back = step.document
    assert (first, now) == (0, 0)
    assert back.up == document.up
    assert back.mesh.source == document.mesh.source
    assert np.array_equal(back.mesh.vertices, document.mesh.vertices)
    assert np.array_equal(back.display_mesh.faces, document.display_mesh.faces)
    for ours, theirs in zip(back.photos, document.photos, strict=True):
        assert np.array_equal(ours.photo.pixels, theirs.photo.pixels)
        assert np.array_equal(ours.camera.P, theirs.camera.P)
        assert ours.enabled == theirs.enabled
    assert back.photos[0].photo.mask is None
    assert np.array_equal(back.photos[1].masked_photo.mask, mask)
    assert same_camera(dict(back.truth)["toy-0.png"], document.photos[0].camera)
    project.close()


def test_what_was_made_in_memory_is_kept_in_the_project_itself(project):
    mesh, photos, cameras = toy_scene()
    document = Document(mesh, mesh, tuple(map(PhotoEntry, photos, cameras)))
    project.write_history(-1, [StoredStep(None, document)], 0)
    project = reopened(project)
    back = project.read_history()[1][0].document
    assert back.mesh is back.display_mesh, "what is one stays one"
    assert np.array_equal(back.mesh.vertices, mesh.vertices)
    assert np.array_equal(back.photos[1].photo.pixels, photos[1].pixels)
    project.close()


def test_the_history_survives_with_its_names_and_shares_what_is_the_same(
    project, document
):
    steps = [
        StoredStep(f"Move {i}" if i else None, moved(document, i)) for i in range(6)
    ]
    project.write_history(-1, steps, 3)
    project = reopened(project)
    first, back, now = project.read_history()
    assert (first, now) == (0, 3)
    assert [step.name for step in back] == [step.name for step in steps]
    assert len({id(step.document.mesh) for step in back}) == 1
    assert len({id(step.document.photos[0].photo) for step in back}) == 1
    xs = [step.document.photos[0].camera.t_cam_world[0] for step in back]
    assert np.allclose(np.diff(xs), 1.0, rtol=0, atol=1e-12)
    # A new step ends what could be redone.
    project.write_history(3, [StoredStep("Turn", moved(document, 9))], 4)
    first, back, now = project.read_history(n_back=1)
    assert (first, now) == (3, 4)
    assert [step.name for step in back] == ["Move 3", "Turn"]
    project.close()


def test_a_new_field_takes_its_default_and_one_that_is_gone_is_passed_over(
    tmp_path, document
):
    @dataclasses.dataclass(frozen=True)
    class Point:
        x: float
        gone: str = "old" * 100

    @dataclasses.dataclass(frozen=True)
    class Newer:
        x: float
        note: str = "new"

    Newer.__name__ = "Point"
    project = Project(tmp_path / "p", [Point])
    project.write_settings({"here": (Point(1.5), Point(2.5, "short"))})
    project.close()
    project = Project(tmp_path / "p", [Newer])
    assert project.read_setting("here") == (Newer(1.5), Newer(2.5))
    project.close()
    project = Project(tmp_path / "p")
    with pytest.raises(InputError, match="holds a Point, which this photoreg does not"):
        project.read_setting("here")
    project.close()


@pytest.mark.parametrize(
    "value",
    [
        float("inf"),
        -0.1,
        (1, (2, "drei\n'\"")),
        {"a": (1,), 2: None},
        b"\0bytes" * 99,
        frozenset({"b", "a"}),
        Path("/a b/c"),
        True,
    ],
)
def test_settings_come_back_as_they_were(project, value):
    project.write_settings({"it": value})
    project = reopened(project)
    back = project.read_setting("it")
    assert back == value
    assert type(back) is type(value) or isinstance(value, Path)
    project.close()


def test_what_cannot_be_kept_is_refused_and_nothing_is_written(project, document):
    project.write_history(-1, [StoredStep(None, document)], 0)
    with pytest.raises(TypeError, match="cannot keep a Thread"):
        project.write_history(
            -1,
            [
                StoredStep("a", moved(document, 1)),
                StoredStep("b", __import__("threading").Thread()),
            ],
            1,
        )
    assert [step.name for step in project.read_history()[1]] == [None]
    # The parts that were rolled back are written again when they are needed.
    project.write_history(0, [StoredStep("a", moved(document, 1))], 1)
    project = reopened(project)
    assert len(project.read_history()[1]) == 2
    project.close()


# Files.


def test_a_changed_file_is_noticed_and_never_used_unasked(project, document, files):
    project.write_history(-1, [StoredStep(None, document)], 0)
    assert project.file_problems() == []
    path = files / "toy-1.png"
    picture = cv2.imread(str(path))
    assert picture is not None
    cv2.imwrite(str(path), 255 - picture)
    project = reopened(project)
    (problem,) = project.file_problems()
    assert (problem.kind, problem.path.name) == ("changed", "toy-1.png")
    with pytest.raises(InputError, match=r"toy-1\.png has changed"):
        project.read_history()
    with pytest.raises(InputError, match="not the same file"):
        project.files.use(problem.key, path)
    project.files.use(problem.key, path, even_changed=True)
    assert project.file_problems() == []
    back = project.read_history()[1][0].document
    assert np.array_equal(back.photos[1].photo.pixels[:, :, ::-1], 255 - picture)
    project.close()


def test_a_moved_file_is_noticed_and_can_be_located(project, document, files, tmp_path):
    project.write_history(-1, [StoredStep(None, document)], 0)
    elsewhere = tmp_path / "elsewhere.ply"
    (files / "rock.ply").rename(elsewhere)
    (problem,) = project.file_problems()
    assert (problem.kind, problem.path.name) == ("missing", "rock.ply")
    with pytest.raises(InputError, match="cannot be read"):
        project.files.use(problem.key, tmp_path / "nowhere.ply")
    project.files.use(problem.key, elsewhere)
    back = project.read_history()[1][0].document
    assert back.mesh.source.path == elsewhere
    assert back.mesh.name == "rock.ply"


def test_a_step_whose_file_is_gone_is_left_out_but_stays_in_the_project(
    project, document, files
):
    without = dataclasses.replace(document, photos=document.photos[:1])
    steps = [
        StoredStep(None, document),
        StoredStep("Remove", without),
        StoredStep("Move", moved(without, 1)),
    ]
    project.write_history(-1, steps, 2)
    (files / "toy-1.png").rename(files / "away.png")
    project = reopened(project)
    assert project.file_problems() == [], "the document in force does not need it"
    first, back, now = project.read_history()
    assert (first, now, [s.name for s in back]) == (1, 2, ["Remove", "Move"])
    (files / "away.png").rename(files / "toy-1.png")
    assert len(project.read_history()[1]) == 3
    project.close()


def test_kept_files_move_with_the_project_and_names_cannot_leave_it(project, files):
    content = (files / "toy-0.png").read_bytes()
    path = project.keep_file("../../etc/pass'wd ä.png", content)
    assert path == project.folder / "files" / "pass'wd ä.png"
    assert project.keep_file("pass'wd ä.png", content) == path, "it is there already"
    other = project.keep_file("pass'wd ä.png", content + b"more")
    assert other == project.folder / "files" / "2" / path.name, "it keeps its name"
    assert path.read_bytes() == content
    project.write_settings({"photo": load_photo(path)})
    project.close()
    moved_to = project.folder.with_name("renamed")
    project.folder.rename(moved_to)
    project = Project(moved_to, TYPES)
    assert project.read_setting("photo").source.path == moved_to / "files" / path.name
    project.close()


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("..", "file"),
        ("a/../../b.png", "b.png"),
        ("C:\\temp\\x.jpg", "x.jpg"),
        ("..\\..\\x.jpg", "x.jpg"),
        (".hidden", "hidden"),
        ("a\0b\n.png", "a_b_.png"),
        ('q"<>|?*:.png', "q_______.png"),
        ("  spaced name .png ", "spaced name .png"),
        ("日本語 photo's.png", "日本語 photo's.png"),
        ("\ud800.png", "?.png"),
        ("", "file"),
    ],
)
def test_uploaded_names_become_plain_file_names(name, plain):
    assert plain_name(name) == plain


def test_a_name_of_any_length_can_be_kept(tmp_path):
    path = keep_file(tmp_path, "ä" * 5000 + ".jpeg", b"x")
    assert path.suffix == ".jpeg"
    assert path.read_bytes() == b"x"


def test_saving_as_makes_a_project_of_its_own(project, document, tmp_path):
    project.keep_file("a.bin", b"abc")
    project.write_history(-1, [StoredStep(None, document)], 0)
    project.save_as(tmp_path / "copy")
    other = Project(tmp_path / "copy", TYPES, create=False)
    assert other.read_only == ""
    other.write_history(0, [StoredStep("Move", moved(document, 1))], 1)
    assert len(project.read_history()[1]) == 1
    assert (other.folder / "files" / "a.bin").read_bytes() == b"abc"
    other.close()
    with pytest.raises(OutputError, match="not an empty folder"):
        project.save_as(tmp_path / "copy")


def test_garbage_goes_and_what_is_needed_stays(project, document):
    steps = [StoredStep(None, document), StoredStep("a", moved(document, 1))]
    project.write_history(-1, steps, 1)
    project.runs.add_run({}, 1, ["toy-0.png"], document.used_cameras)
    assert project.collect_garbage() == 0
    project.write_history(0, [], 0)
    assert project.collect_garbage() > 0
    project.write_history(0, [StoredStep("a", moved(document, 1))], 1)
    project = reopened(project)
    assert len(project.read_history()[1]) == 2
    assert len(project.runs.all()) == 1
    project.close()


# Runs.


def test_a_run_is_remembered_from_its_start_to_its_answer(project, document):
    cameras = document.used_cameras
    run = project.runs.add_run(
        {"preset": "default", "population": np.int64(7), "range": (1.0, 2.0)},
        42,
        ["toy-0.png", "toy-1.png"],
        cameras,
    )
    project.runs.add_generations(
        run, [StoredGeneration(i, 1.0 / (i + 1), 2.0) for i in range(5)]
    )
    project.runs.add_checkpoint(run, b"first", 3)
    project.runs.add_checkpoint(run, b"second", 5, cameras[::-1])
    project = reopened(project)
    found = project.runs.unfinished_run()
    assert found is not None
    assert found.id == run
    assert found.settings == {"preset": "default", "population": 7, "range": [1.0, 2.0]}
    assert (found.seed, found.photo_names) == (42, ("toy-0.png", "toy-1.png"))
    assert all(map(same_camera, found.start, cameras))
    assert found.cameras is not None
    assert all(map(same_camera, found.cameras, cameras[::-1])), "of the checkpoint"
    checkpoint = project.runs.checkpoint(run)
    assert checkpoint is not None
    assert (checkpoint.generation, checkpoint.content) == (5, b"second")
    assert [g.number for g in project.runs.generations(run)] == list(range(5))
    project.runs.end_run(
        run, cameras, 0.5, start_cost=2.0, outcome="Done.", figures={"px": 0.1}
    )
    assert project.runs.unfinished_run() is None
    assert project.runs.checkpoint(run) is None
    (ended,) = project.runs.all()
    assert (ended.cost, ended.start_cost, ended.outcome) == (0.5, 2.0, "Done.")
    assert (ended.figures, ended.n_generations) == ({"px": 0.1}, 5)
    project.runs.remove_run(run)
    assert project.runs.all() == []
    assert project.runs.generations(run) == []
    project.close()


# Locks, damage, versions.


def test_a_second_program_may_look_but_not_write(project, document):
    project.write_history(-1, [StoredStep(None, document)], 0)
    second = Project(project.folder, TYPES)
    assert f"process {os.getpid()}" in second.read_only
    assert len(second.read_history()[1]) == 1
    with pytest.raises(OutputError, match="open in another photoreg"):
        second.write_history(0, [], 0)
    with pytest.raises(OutputError, match="open in another photoreg"):
        second.keep_file("a.png", b"")
    project.write_history(0, [StoredStep("Move", moved(document, 1))], 1)
    assert len(second.read_history()[1]) == 2, "it sees what the first one writes"
    second.close()
    project.close()
    third = Project(project.folder, TYPES)
    assert third.read_only == ""
    third.close()


def _write_until_killed(folder: Path, started) -> None:
    project = Project(folder, TYPES)
    project.write_settings({"n": 0})
    started.set()
    for n in range(1, 10**9):
        project.write_settings({"n": n, "same": n})
        (folder / "telling").write_text(str(n))
        (folder / "telling").replace(folder / "told")


@pytest.mark.slow
def test_a_killed_writer_leaves_all_it_told_and_no_lock(tmp_path):
    context = multiprocessing.get_context("spawn")
    folder = tmp_path / "p"
    for _ in range(3):
        started = context.Event()
        process = context.Process(target=_write_until_killed, args=(folder, started))
        process.start()
        assert started.wait(60)
        process.join(0.2)
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        project = Project(folder, TYPES, create=False)
        assert project.read_only == ""
        told = int((folder / "told").read_text() or 0)
        n = project.read_setting("n")
        assert n >= told > 0
        assert project.read_setting("same") == n, "a write is whole or not there"
        project.close()


def test_no_project_and_foreign_or_damaged_files_are_refused_in_a_sentence(tmp_path):
    with pytest.raises(InputError, match="holds no project"):
        Project(tmp_path, create=False)
    with pytest.raises(InputError, match="There is no folder"):
        Project(tmp_path / "nowhere", create=False)
    for name, content in (
        ("text", b"this is not a database, but long enough to be looked at" * 30),
        ("short", b"x"),
    ):
        folder = tmp_path / name
        folder.mkdir()
        (folder / DATABASE).write_bytes(content)
        with pytest.raises(InputError, match="cannot be opened as a project"):
            Project(folder)
        assert (folder / DATABASE).read_bytes() == content
    folder = tmp_path / "foreign"
    folder.mkdir()
    with sqlite3.connect(folder / DATABASE) as foreign:
        foreign.execute("CREATE TABLE birds (name)")
    foreign.close()
    with pytest.raises(InputError, match="another program"):
        Project(folder)


def test_a_damaged_page_is_noticed(project, document):
    mesh, photos, cameras = toy_scene()
    kept = Document(mesh, mesh, tuple(map(PhotoEntry, photos, cameras)))
    project.write_history(-1, [StoredStep(None, kept)], 0)
    project.close()
    with project.path.open("r+b") as file:
        for page in range(3, 12):
            file.seek(page * 4096)
            file.write(b"\xff" * 4096)
    with pytest.raises(InputError, match="cannot be opened as a project"):
        Project(project.folder, TYPES)


def test_a_newer_project_is_refused_and_not_touched(project):
    project.close()
    with sqlite3.connect(project.path) as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()
    before = project.path.read_bytes()
    with pytest.raises(InputError, match="saved by a newer photoreg"):
        Project(project.folder)
    assert project.path.read_bytes() == before


def test_an_older_project_is_brought_up_to_date_after_a_copy_is_kept(
    project, document, monkeypatch
):
    project.write_history(-1, [StoredStep(None, document)], 0)
    project.close()
    newer = (
        *schema.MIGRATIONS,
        "CREATE TABLE extra (a);\nALTER TABLE runs ADD note TEXT;",
    )
    monkeypatch.setattr(schema.prepare, "__defaults__", (newer,))
    project = Project(project.folder, TYPES)
    assert project.old_copy is not None
    assert len(project.read_history()[1]) == 1
    project._connection.execute("SELECT note FROM runs")
    project.close()
    monkeypatch.undo()
    with pytest.raises(InputError, match="newer photoreg"):
        Project(project.folder, TYPES)
    project.path.unlink()
    project.old_copy.rename(project.path)
    project = Project(project.folder, TYPES)
    assert len(project.read_history()[1]) == 1, "the copy is whole"
    project.close()


def test_a_migration_that_fails_leaves_the_project_as_it_was(project, monkeypatch):
    project.write_settings({"a": 1})
    project.close()
    broken = (
        *schema.MIGRATIONS,
        "CREATE TABLE extra (a);\nCREATE TABLE runs (a);",
    )
    monkeypatch.setattr(schema.prepare, "__defaults__", (broken,))
    with pytest.raises(InputError, match="cannot be opened"):
        Project(project.folder, TYPES)
    monkeypatch.undo()
    project = Project(project.folder, TYPES)
    assert project.read_setting("a") == 1
    project.close()


def test_a_foreign_project_makes_no_object_but_those_it_may(project):
    project.write_settings({"a": 1})
    project._connection.execute(
        "UPDATE settings SET value = ? WHERE name = 'a'",
        ('{"is": "Popen", "of": {"args": ["true"]}}',),
    )
    with pytest.raises(InputError, match="Popen"):
        project.read_setting("a")


def test_a_full_disk_is_a_sentence(project, document):
    project._connection.execute("PRAGMA max_page_count = 30")
    mesh, photos, cameras = toy_scene()
    kept = Document(mesh, mesh, tuple(map(PhotoEntry, photos, cameras)))
    with pytest.raises(OutputError, match="Is the disk full"):
        project.write_history(-1, [StoredStep(None, kept)], 0)
    assert project.read_history()[1] == []


def test_cameras_keep_every_bit(project):
    rng = np.random.default_rng(5)
    for _ in range(50):
        center = rng.normal(size=3) * 10 ** rng.uniform(-6, 6)
        camera = Camera.look_at(
            center,
            center + rng.normal(size=3),
            rng.normal(size=3),
            10 ** rng.uniform(0, 5),
            640,
            480,
        )
        project.write_settings({"c": camera})
        project._values._decoded.clear()
        back = project.read_setting("c")
        for ours, theirs in (
            (back.K, camera.K),
            (back.R_cam_world, camera.R_cam_world),
            (back.t_cam_world, camera.t_cam_world),
        ):
            assert np.array_equal(ours, theirs)


def test_a_folder_of_other_machines_is_known_and_its_project_needs_no_shared_memory(
    tmp_path, monkeypatch
):
    mounts = tmp_path / "mountinfo"
    line = "36 35 98:0 / {} rw,noatime master:1 - {} server:/x rw\n"
    mounts.write_text(
        line.format("/", "ext4")
        + line.format("/mnt/my\\040share", "nfs4")
        + line.format("/mnt/my\\040share/here", "xfs")
    )
    assert is_on_network(Path("/mnt/my share/a/b"), mounts)
    assert not is_on_network(Path("/mnt/my share/here/b"), mounts)
    assert not is_on_network(Path("/mnt/my shares"), mounts)
    assert not is_on_network(tmp_path, tmp_path / "nowhere")

    monkeypatch.setattr("photoreg.project.project.is_on_network", lambda _: True)
    project = Project(tmp_path / "p")
    project.write_settings({"a": 1})
    assert {p.name for p in project.folder.iterdir()} == {DATABASE, "project.lock"}
    project.close()
