"""What is kept of an object beside its results: whether it is done, and of what."""

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from photoreg.batch.collection import (
    CollectionObject,
    FileState,
    Inputs,
    state_of,
)
from photoreg.batch.settings import fingerprint
from photoreg.errors import InputError
from photoreg.formats.writing import write_files
from photoreg.sources import read_regular, source_file

RECORD = "object.json"
FORMAT = "photoreg-object"
VERSION = 1
MAX_BYTES = 16 << 20

Ending = Literal["done", "failed"]

KeptFile = tuple[int, int, str]
"""Size, time in nanoseconds, and SHA-256; "" of a file that was not read."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ObjectRecord:
    """How an object ended, and what it was made of."""

    ending: Ending
    """``failed``: by itself, as often as it is tried."""
    settings: str
    """Their fingerprint."""
    base: str
    """The folder that the paths below are relative to."""
    mesh: str
    photos: tuple[str, ...]
    cameras: str
    files: Mapping[str, KeptFile]
    """All files that it may consist of, and which of them it was made of."""
    outputs: tuple[str, ...] = ()
    """Files in its folder."""
    figures: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """What the summary says about it."""

    def inputs(self) -> Inputs:
        """Its files, where they were."""
        base = Path(self.base)
        return Inputs(
            base / self.mesh,
            tuple(base / photo for photo in self.photos),
            base / self.cameras,
        )


def is_known(folder: Path) -> bool:
    """Whether a record is kept in an object's folder."""
    return os.path.lexists(folder / RECORD)


def load_record(folder: Path) -> ObjectRecord | None:
    """What is kept in an object's folder; None if nothing is, or it cannot be read."""
    try:
        text = read_regular(folder / RECORD)
        document = json.loads(text) if len(text) <= MAX_BYTES else {}
        if document["format"] != FORMAT or document["version"] != VERSION:
            return None
        return ObjectRecord(
            ending=_one_of(document["ending"], ("done", "failed")),
            settings=str(document["settings"]),
            base=str(document["base"]),
            mesh=str(document["mesh"]),
            photos=tuple(map(str, document["photos"])),
            cameras=str(document["cameras"]),
            files={
                name: (int(size), int(time), str(sha256))
                for name, (size, time, sha256) in document["files"].items()
            },
            outputs=tuple(map(str, document["outputs"])),
            figures=dict(document["figures"]),
        )
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def _one_of(value: Any, choices: tuple[Any, ...]) -> Any:
    if value not in choices:
        raise ValueError(value)
    return value


def save_record(folder: Path, record: ObjectRecord) -> None:
    """Writes it whole or not at all.

    Raises:
        OutputError: if it cannot be written, or another file has its name.
    """
    document = {"format": FORMAT, "version": VERSION, **dataclasses.asdict(record)}
    text = json.dumps(document, indent=1, ensure_ascii=False)
    write_files({folder / RECORD: text})


def hashed(
    base: Path, states: Mapping[str, FileState], read: set[str]
) -> dict[str, KeptFile]:
    """Files as a record has them: those that were read with their hashes.

    Args:
        base: The folder that paths are relative to.
        states: The files and their states before they were read.
        read: Those of them, and others, that were read.

    Raises:
        InputError: if one has changed since.
    """
    found: dict[str, KeptFile] = {}
    for name in sorted({*states, *read}):
        now = state_of(base / name)
        before = states.get(name, now)
        if now is None or now != before:
            raise InputError(f"{base / name} changed while it was being read.")
        sha256 = source_file(base / name).sha256 if name in read else ""
        found[name] = (*now, sha256)
    return found


def still_holds(record: ObjectRecord, thing: CollectionObject) -> ObjectRecord | None:
    """The record if the object is still what it was made of; None if it is not.

    Files of the same size and time are taken for the same, as `make` and `git` do. Where
    one differs, contents decide, and the record comes back with the files as they are now.
    """
    if record.settings != fingerprint(thing.settings):
        return None
    states = thing.files()
    for name in record.files:
        if name not in states and (now := state_of(thing.base / name)) is not None:
            states[name] = now  # What the mesh names and the table does not.
    if states == {name: (size, at) for name, (size, at, _) in record.files.items()}:
        return record
    if record.ending == "failed":
        return None  # Somebody may have put it right.
    used = {name: kept[2] for name, kept in record.files.items() if kept[2]}
    try:
        now = thing.inputs()
        if not _has_same_roles(record, thing, now):
            return None
        files = hashed(thing.base, states, set(used))
    except (InputError, OSError):
        return None
    if {name: files[name][2] for name in used} != used:
        return None
    return dataclasses.replace(record, base=str(thing.base), files=files)


def _has_same_roles(
    record: ObjectRecord, thing: CollectionObject, inputs: Inputs
) -> bool:
    photos = tuple(map(thing.told, inputs.photos))
    return (
        record.mesh == thing.told(inputs.mesh)
        and record.cameras == thing.told(inputs.cameras)
        # A texture of the mesh's own may lie among them.
        and set(record.photos) <= set(photos)
        and all(photo in record.files for photo in photos)
    )
