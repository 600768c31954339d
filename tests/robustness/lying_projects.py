"""A sound project as files, to be damaged, and how the app reads and writes it."""

import contextlib
import dataclasses
import hashlib
import shutil
import sqlite3
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.control.autosave import CHOICES, DOCUMENT_TYPES
from app.control.project_reading import read_all
from app.engine.warm_up import toy_scene
from app.model.masks import encode_mask
from app.model.run import Run
from app.model.state import Document, PhotoEntry, PointPair, State
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.ply import save_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.project.check import CheckedProject
from photoreg.project.folder import DATABASE
from photoreg.project.guard import MAX_ROWS
from photoreg.project.project import Project, StoredStep
from photoreg.project.runs import StoredGeneration
from photoreg.report.cost_curve import CurvePoint

FOLDER = "a project"
DATABASE_PATH = f"{FOLDER}/{DATABASE}"


def project_files() -> Mapping[str, bytes]:
    """A small project with all that one may hold, the database first."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / FOLDER
        make_project(folder)
        paths = [path for path in folder.rglob("*") if path.is_file()]
        paths.sort(key=lambda path: path.name != DATABASE)
        return {str(path.relative_to(name)): path.read_bytes() for path in paths}


def make_project(folder: Path) -> None:
    """Makes that project."""
    mesh, photos, cameras = toy_scene()
    save_mesh(folder.with_name("m.ply"), mesh)
    project = Project(folder, DOCUMENT_TYPES)
    kept = project.keep_file("m.ply", folder.with_name("m.ply").read_bytes())
    entries = []
    for photo, camera in zip(photos, cameras, strict=True):
        content = cv2.imencode(".png", photo.pixels[:, :, ::-1])[1].tobytes()
        mask = np.ones((photo.height, photo.width), bool)
        mask[:9] = False
        entries.append(
            PhotoEntry(
                load_photo(project.keep_file(photo.name, content)),
                camera,
                pairs=(PointPair(1, (0.5, 0.25, 1.0), (3.0, 4.5)), PointPair(2)),
                mask_png=encode_mask(mask),
            )
        )
    read = load_mesh(kept)
    document = Document(read, read.decimated(100), tuple(entries))
    turned = dataclasses.replace(document, up=(0.0, 0.0, 1.0))
    project.write_history(-1, [StoredStep(None, document), StoredStep("a", turned)], 1)
    curve = (CurvePoint(0, 1.0, 2.0), CurvePoint(1, 0.5, float("inf")))
    names = tuple(entry.name for entry in entries)
    run = Run(
        status="review", number=1, photo_names=names, start=tuple(cameras), curve=curve
    )
    choices = {name: getattr(State(), name) for name in CHOICES}
    project.write_settings({"run": run, "runs": (run,), "choices": choices})
    number = project.runs.add_run({"preset": "fast"}, 1, names, cameras)
    project.runs.add_generations(number, [StoredGeneration(0, 1.0, 2.0)])
    project.runs.add_checkpoint(number, b"a kept search" * 20, 1, cameras)
    project.close()


def read(folder: Path) -> CheckedProject:
    """Reads it as the app does, then opens it, reads the rest, tidies up and writes.

    Raises:
        PhotoregError: if it cannot be used.
    """
    for name in ("-wal", "-shm", "-journal"):
        (folder / f"{DATABASE}{name}").unlink(missing_ok=True)
    checked = read_all(folder, lambda _: None)
    project = Project(folder, DOCUMENT_TYPES, create=False, loaded=checked.loaded)
    try:
        project.read_history(kind=Document)
        project.read_setting("choices", {}, dict)
        for run in project.runs.all():
            project.runs.generations(run.id)
            project.runs.checkpoint(run.id)
        assert isinstance(project.is_untouched, bool)
        project.collect_garbage()
        project.write_settings({"choices": {}})
        copy = folder.with_name("copy")
        shutil.rmtree(copy, ignore_errors=True)
        project.save_as(copy)
    finally:
        project.close()
    return checked


def tables(content: bytes) -> dict[str, list[tuple[Any, ...]]]:
    """The rows of all tables of a database."""
    with contextlib.closing(_opened(content)) as connection:
        return {
            name: connection.execute(f"SELECT * FROM {name}").fetchall()
            for name in MAX_ROWS
        }


def with_value(content: bytes, table: str, row: int, column: int, value: Any) -> bytes:
    """The database with one value changed.

    A part's content is changed all through: what names it names the new one.
    """
    rows = tables(content)
    changed = list(rows[table][row])
    old, changed[column] = changed[column], value
    if (table, column) == ("parts", 1):
        rows = _renamed(rows, rows[table][row][0], _bytes(old), _bytes(value))
    else:
        rows[table][row] = tuple(changed)
    with contextlib.closing(_opened(content)) as connection:
        connection.execute("BEGIN")
        for name, these in rows.items():
            connection.execute(f"DELETE FROM {name}")
            for each in these:
                marks = ", ".join("?" * len(each))
                with contextlib.suppress(sqlite3.IntegrityError, OverflowError):
                    connection.execute(
                        f"INSERT INTO {name} VALUES ({marks})",
                        each,
                    )
        connection.execute("COMMIT")
        return bytes(connection.serialize())


def _renamed(
    rows: dict[str, list[tuple[Any, ...]]], key: str, old: bytes, new: bytes
) -> dict[str, list[tuple[Any, ...]]]:
    parts = {name: _bytes(content) for name, content in rows["parts"]}
    renamed = [(key, new)]
    texts = {name: these for name, these in rows.items() if name != "parts"}
    while renamed:
        before, content = renamed.pop()
        after = hashlib.sha256(content).hexdigest()
        parts.pop(before, None)
        parts[after] = content
        for name, other in list(parts.items()):
            if before.encode() in other and name != after:
                renamed.append((name, other.replace(before.encode(), after.encode())))
        for name, these in texts.items():
            texts[name] = [
                tuple(
                    v.replace(before, after) if isinstance(v, str) else v for v in row
                )
                for row in these
            ]
    return texts | {"parts": list(parts.items())}


def _bytes(value: Any) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode()


def _opened(content: bytes) -> sqlite3.Connection:
    """A database in memory."""
    connection = sqlite3.connect(":memory:", isolation_level=None)
    # In memory there is no write-ahead log.
    connection.deserialize(content[:18] + b"\1\1" + content[20:])
    return connection
