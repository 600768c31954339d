"""A project's database from anybody: damaged, lying, endless. One sentence, nothing made."""

import dataclasses
import hashlib
import json
import os
import sqlite3
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from jaxtyping import Float, UInt8

from photoreg.checks import Measured
from photoreg.errors import InputError
from photoreg.limits import Limits
from photoreg.project import values
from photoreg.project.check import check_project
from photoreg.project.folder import DATABASE
from photoreg.project.project import Project, StoredStep


@dataclasses.dataclass(frozen=True)
class Inner:
    """A field that is a dataclass itself."""

    x: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Kept:
    """Fields of every kind that a document has."""

    number: float = 0.0
    count: int = 0
    cost: Measured | None = None
    name: str = ""
    on: bool = True
    style: Literal["a", "b"] = "a"
    place: tuple[float, float, float] | None = None
    inner: Inner = Inner()
    inners: tuple[Inner, ...] = ()
    png: bytes | None = None
    points: Float[np.ndarray, "n 3"] | None = None
    colours: UInt8[np.ndarray, "n 3"] | None = None

    def __post_init__(self) -> None:
        MADE.append(self)


MADE: list[Kept] = []
TYPES = (Kept, Inner)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A closed project of one step."""
    with_numbers = Kept(points=np.arange(90.0).reshape(30, 3), png=b"png" * 50)
    project = Project(tmp_path / "work", TYPES)
    project.write_history(-1, [StoredStep(None, with_numbers)], 0)
    project.close()
    return tmp_path / "work"


def change(folder: Path, *statements: str, arguments: tuple[Any, ...] = ()) -> None:
    """Does something to the database that no photoreg does."""
    connection = sqlite3.connect(folder / DATABASE, isolation_level=None)
    for statement in statements:
        connection.execute(statement, arguments)
    connection.close()


def set_document(folder: Path, node: Any) -> None:
    text = node if isinstance(node, str | bytes) else json.dumps(node)
    change(folder, "UPDATE steps SET document = ?", arguments=(text,))


def add_part(folder: Path, content: bytes) -> str:
    key = hashlib.sha256(content).hexdigest()
    change(folder, "INSERT INTO parts VALUES (?, ?)", arguments=(key, content))
    return key


def refusal(folder: Path, read: Callable[[Path], Any] | None = None) -> str:
    """The one sentence, and nothing changed in the folder."""
    before = {
        path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()
    }
    with pytest.raises(InputError) as refused:
        (read or checked)(folder)
    after = {
        path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()
    }
    assert after == before
    assert "\n" not in str(refused.value)
    return str(refused.value)


def checked(folder: Path) -> Any:
    return check_project(folder, TYPES, Kept)


def test_what_is_sound_is_read_and_leaves_no_trace(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    document = checked(folder).steps[0].document
    assert (document.points == np.arange(90.0).reshape(30, 3)).all()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    # One that another program has open, too.
    project = Project(folder, TYPES)
    project.write_history(0, [StoredStep("a", Kept(count=3))], 1)
    assert checked(folder).steps[1].document.count == 3
    project.close()


def array(value: Any) -> dict[str, Any]:
    value = np.asarray(value)
    return {
        "array": value.ravel().tolist(),
        "type": value.dtype.str,
        "shape": list(value.shape),
    }


@pytest.mark.parametrize(
    ("field", "node"),
    [
        ("number", "<img src=x onerror=alert(1)>"),
        ("number", None),
        ("number", True),
        ("number", float("nan")),
        ("number", float("inf")),
        ("number", 10**400),
        ("count", 1.5),
        ("count", 10**30),
        ("count", "1"),
        ("count", False),
        ("cost", "1"),
        ("name", 5),
        ("name", "half of \ud83d"),
        ("on", 1),
        ("style", "c"),
        ("style", ["a"]),
        ("place", [1.0, 2.0]),
        ("place", [1.0, 2.0, "<b>"]),
        ("place", [1.0, 2.0, float("nan")]),
        ("place", {"map": []}),
        ("inner", None),
        ("inner", {"is": "Kept", "of": {}}),
        ("inners", [{"is": "Inner", "of": {}}, 3.0]),
        ("inners", {"is": "Inner", "of": {}}),
        ("png", "text"),
        ("points", [[1.0, 2.0, 3.0]]),
        ("points", array([[1, 2, 3]])),
        ("points", array([1.0, 2.0, 3.0])),
        ("points", array([[1.0, 2.0]])),
        ("colours", array(np.zeros((2, 3)))),
    ],
)
def test_a_value_of_another_type_is_refused_by_its_field(
    folder: Path, field: str, node: Any
) -> None:
    set_document(folder, {"is": "Kept", "of": {field: node}})
    MADE.clear()
    assert f"Kept.{field} should be " in refusal(folder)
    assert len(MADE) == (1 if "Kept" in json.dumps(node) else 0), "nothing else is made"


def test_arrays_of_one_document_must_be_of_one_length(folder: Path) -> None:
    points, colours = array(np.zeros((2, 3))), array(np.zeros((3, 3), np.uint8))
    set_document(folder, {"is": "Kept", "of": {"points": points, "colours": colours}})
    assert "Kept.colours should be " in refusal(folder)


def test_a_measured_number_may_be_infinite_and_an_integer_stands_for_a_number(
    folder: Path,
) -> None:
    set_document(folder, {"is": "Kept", "of": {"cost": float("inf"), "number": 2}})
    document = checked(folder).steps[0].document
    assert (document.cost, document.number) == (float("inf"), 2)


@pytest.mark.parametrize(
    "document",
    [
        "",
        "{",
        b"\xff\xfe",
        5,
        "3",
        {"is": "Popen", "of": {"args": ["true"]}},
        {"is": "Kept"},
        {"is": "Kept", "of": []},
        {"is": ["Kept"], "of": {}},
        {"at": "0" * 64},
        {"at": ["0"]},
        {"file": "0" * 64},
        {"map": 3},
        {"path": "a\0b"},
        {"array": "0" * 64, "type": "O", "shape": [1]},
        {"array": [1.0], "type": "<f8", "shape": [-1]},
        {"array": [], "type": "<f8", "shape": [2**62, 2**62]},
        {"nobody": "knows"},
        "[" * 100_000,
    ],
)
def test_a_document_that_is_none_is_refused(folder: Path, document: Any) -> None:
    set_document(folder, document if document != 5 else "5")
    if document == 5:
        change(folder, "UPDATE steps SET document = x'80'")
    refusal(folder)
    project = Project(folder, TYPES)
    with pytest.raises(InputError):
        project.read_history(kind=Kept)
    project.close()


@pytest.mark.parametrize(
    "statements",
    [
        ["CREATE VIEW v AS SELECT 1"],
        [
            "ALTER TABLE steps RENAME TO old",
            "CREATE VIEW steps AS WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 "
            "FROM n) SELECT i AS position, NULL AS name, '' AS made_utc, '0' AS document "
            "FROM n",
        ],
        [
            "CREATE TRIGGER t AFTER INSERT ON settings BEGIN "
            "UPDATE settings SET value = '1'; END"
        ],
        ["CREATE VIRTUAL TABLE f USING fts5(a)"],
        ["ALTER TABLE files ADD x AS (hex(zeroblob(1000000)))"],
        ["CREATE INDEX i ON runs (abs(seed))"],
        ["CREATE TABLE extra (a)"],
        ["DROP TABLE own"],
    ],
)
def test_a_schema_that_is_not_ours_to_the_letter_is_refused(
    folder: Path, statements: list[str]
) -> None:
    change(folder, *statements)
    assert "is foreign, changed or missing" in refusal(folder)
    assert "is foreign" in refusal(folder, lambda f: Project(f, TYPES))


@pytest.mark.parametrize("shape", [[1_000_000_000], [10]])
def test_what_unpacks_to_more_than_it_says_or_than_may_be_is_not_unpacked(
    folder: Path, shape: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = []
    real = zlib.decompressobj

    class Watched:
        def __init__(self) -> None:
            self._real = real()

        def decompress(self, packed: bytes, most: int) -> bytes:
            raw = self._real.decompress(packed, most)
            taken.append(len(raw))
            return raw

        @property
        def eof(self) -> bool:
            return self._real.eof

    monkeypatch.setattr(values.zlib, "decompressobj", Watched)
    key = add_part(folder, zlib.compress(bytes(100_000_000)))
    set_document(folder, {"array": key, "type": "|u1", "shape": shape})
    limits = Limits(project_mb=50)
    said = refusal(folder, lambda f: check_project(f, TYPES, Kept, limits=limits))
    assert "unpacks to more than 50 MB" in said or "has not 10 bytes" in said
    assert sum(taken) <= 11


def test_few_parts_that_name_each_other_stand_for_no_more_than_may_be(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(values, "MAX_VALUES", 10_000)
    node: Any = 0
    for _ in range(40):
        node = {"at": add_part(folder, json.dumps([node] * 10).encode())}
    set_document(folder, node)
    assert "expands to more than 10000 values" in refusal(folder)


def test_a_part_that_is_not_what_its_name_says_is_damaged(folder: Path) -> None:
    change(folder, "UPDATE parts SET content = replace(content, '0', '1')")
    change(folder, "UPDATE parts SET content = CAST(content AS BLOB)")
    assert "another content than it had" in refusal(folder)


@pytest.mark.parametrize("size", [2**60, -1, "big", None])
def test_a_source_without_end_is_not_read(folder: Path, size: Any) -> None:
    sparse = folder.parent / "endless.ply"
    with sparse.open("wb") as file:
        file.truncate(2**40)
    key = "a" * 64
    if size == 2**60:
        size = 2**40
    change(folder, "PRAGMA ignore_check_constraints = ON")
    change(
        folder,
        "INSERT INTO files VALUES (?, ?, ?, ?)",
        arguments=(key, str(sparse), key, "none" if size is None else size),
    )
    set_document(folder, {"file": key})
    started = time.process_time()
    said = refusal(folder)
    assert "MB are read" in said or "no path, SHA-256 and size" in said
    assert time.process_time() - started < 5.0


@pytest.mark.parametrize("device", ["/dev/zero", "a pipe"])
def test_a_source_that_is_no_file_is_told_and_not_waited_for(
    folder: Path, device: str
) -> None:
    if device == "a pipe":
        device = str(folder.parent / "pipe.ply")
        os.mkfifo(device)
    key = "b" * 64
    change(
        folder,
        "INSERT INTO files VALUES (?, ?, ?, ?)",
        arguments=(key, device, key, 0),
    )
    set_document(folder, {"file": key})
    (problem,) = checked(folder).problems
    assert (problem.kind, str(problem.path)) == ("missing", device)


@pytest.mark.parametrize("kind", ["pipe", "zero", "link", "folder"])
@pytest.mark.parametrize("name", [DATABASE, f"{DATABASE}-wal"])
def test_a_database_that_is_no_file_is_refused_at_once(
    folder: Path, kind: str, name: str
) -> None:
    path = folder / name
    if path.exists():
        path.rename(folder.parent / "was.db")
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "zero":
            path.symlink_to("/dev/zero")
        case "link":
            path.symlink_to(folder.parent / "was.db")
        case "folder":
            path.mkdir()
    with pytest.raises(InputError, match="is not a regular file"):
        checked(folder)


def test_a_database_larger_than_may_be_is_not_looked_into(folder: Path) -> None:
    with (folder / DATABASE).open("r+b") as file:
        file.truncate(2**33)
    with pytest.raises(InputError, match="up to 1000 MB are opened"):
        checked(folder)
