"""Frozen values as text and back: how a project's database keeps a document.

A value is a tree of dataclasses, tuples, mappings, arrays, text and numbers. A branch
whose text is long becomes a part of its own, named by the SHA-256 of its content, so
what two steps of the history share is kept once. What was read from a file is kept as
the file's name and fingerprint and read again.

Fields are kept by name: a field that is new takes its default, one that is gone is
ignored, so documents outlive changes to the program. A database is untrusted
input: each part must have the content that its name says, each value the type of its
field, and sizes are bounded before anything is unpacked.
"""

import contextlib
import dataclasses
import hashlib
import json
import math
import re
import sqlite3
import weakref
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.errors import InputError
from photoreg.limits import Limits, variable
from photoreg.project.guard import DAMAGE, described
from photoreg.project.types import check_fields, check_value
from photoreg.sources import SourceFile

PART_CHARACTERS = 240
"""Text above this becomes a part of its own: a camera does, a setting does not."""

INLINE_NUMBERS = 16
"""Arrays up to this size are kept as text, exactly."""

MAX_TEXT_BYTES = 32 << 20
"""Size of one text; as objects it takes twenty times as much."""

MAX_VALUES = 5_000_000
"""Values of one reading: a few parts that refer to each other can expand to very many."""

MAX_DIMENSIONS = 4
DTYPE = re.compile(r"[<>|=]?[biuf][1248]")

Loaded = Mapping[tuple[type, Path, str], Any]
"""Values that were read from files already, by type, path and SHA-256."""


@dataclasses.dataclass(frozen=True)
class FromFile:
    """How a kind of value is read again from its ``source``."""

    load: Callable[[Path], Any]
    fields: tuple[str, ...]
    """What the file holds; the other fields are kept as they are."""


class Values:
    """Writes values to the table `parts` and reads them back.

    Args:
        connection: The open database.
        types: The dataclasses that may occur. No other is ever made, whatever a
            foreign database asks for.
        from_file: Those that are read from files.
        find_file: The file of a key, as it is now.
        add_file: Remembers a file; returns its key.
        limits: What a reading may unpack to.
        loaded: What need not be read from its file again while somebody holds it.
    """

    def __init__(
        self,
        connection: sqlite3.Connection,
        types: Iterable[type],
        from_file: Mapping[type, FromFile],
        find_file: Callable[[str], SourceFile],
        add_file: Callable[[SourceFile], str],
        limits: Limits | None = None,
        loaded: Loaded | None = None,
    ) -> None:
        self._connection = connection
        self._types = {kind.__name__: kind for kind in types}
        self._from_file = dict(from_file)
        self._find_file = find_file
        self._add_file = add_file
        self._limits = limits or Limits.of_environment()
        self._loaded = weakref.WeakValueDictionary(loaded or {})
        self._depth = self._n_bytes = self._n_values = 0
        # By identity: values are frozen, and hashing a photo's pixels takes long.
        self._encoded: dict[int, tuple[weakref.ref[Any], dict[str, Any]]] = {}
        self._decoded: weakref.WeakValueDictionary[str, Any] = (
            weakref.WeakValueDictionary()
        )

    def take(self, loaded: Loaded) -> None:
        """Takes more of what need not be read from its file again."""
        self._loaded.update(loaded)

    def text_of(self, value: object) -> str:
        """The text of a value; its long parts are written to the database.

        Raises:
            TypeError: if it holds something that cannot be kept.
        """
        return _dump(self._node(value))

    def value_of(self, text: object, hint: Any = Any, name: str = "a value") -> Any:
        """The value of a text.

        Args:
            text: What the database has.
            hint: The type that it should be of.
            name: What it is called.

        Raises:
            InputError: if it is damaged, not of that type, too large, of a newer
                photoreg, or a file it was read from is missing, changed or not valid
                any more.
        """
        with self.one_reading():
            try:
                value = self._value(self._parsed(text))
            except MemoryError as error:
                raise InputError(
                    f"The project's database cannot be read: {name} takes more memory "
                    "than there is."
                ) from error
            except DAMAGE as error:
                raise InputError(
                    f"The project's database is damaged: {name} in it cannot be read "
                    f"({described(error)})."
                ) from error
        check_value(value, hint, name)
        return value

    @contextlib.contextmanager
    def one_reading(self) -> Iterator[None]:
        """All that is read within it together stays within the limits."""
        if self._depth == 0:
            self._n_bytes = self._n_values = 0
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1

    def forget(self) -> None:
        """Drops what is remembered of values, after the transaction they were in failed."""
        self._encoded.clear()
        self._decoded.clear()

    def needs(self, text: object) -> tuple[set[str], set[str]]:
        """The hashes of all parts, and the keys of all files, that a text needs.

        Raises:
            InputError: if it is damaged.
        """
        parts: set[str] = set()
        files: set[str] = set()
        self.add_needs(text, parts, files)
        return parts, files

    def add_needs(self, text: object, parts: set[str], files: set[str]) -> None:
        """Adds what a text needs; what is in ``parts`` already is not followed again.

        Raises:
            InputError: if it is damaged.
        """
        try:
            with self.one_reading():
                self._collect(self._parsed(text), parts, files)
        except DAMAGE as error:
            raise InputError(
                f"The project's database is damaged: a value in it cannot be read "
                f"({described(error)})."
            ) from error

    # Writing.

    def _node(self, value: object) -> Any:
        match value:
            case None | bool() | int() | float() | str():
                # Subclasses (enums) as what they are.
                return value
            case np.generic():
                return value.item()
            case tuple() | list():
                return self._shared([self._node(item) for item in value])
            case frozenset():
                return {"set": sorted((self._node(item) for item in value), key=_dump)}
            case bytes():
                return {"bytes": self._put(value)}
            case np.ndarray():
                return self._array_node(value)
            case Path():
                return {"path": str(value)}
            case SourceFile():
                return {"file": self._add_file(value)}
            case Mapping():
                items = [[self._node(k), self._node(v)] for k, v in value.items()]
                return self._shared({"map": items})
        return self._dataclass_node(value)

    def _dataclass_node(self, value: object) -> Any:
        kind = type(value)
        if self._types.get(kind.__name__) is not kind:
            raise TypeError(f"A project cannot keep a {kind.__name__}.")
        known = self._encoded.get(id(value))
        if known is not None and known[0]() is value:
            return known[1]
        from_file = self._from_file.get(kind)
        left_out: tuple[str, ...] = ()
        if from_file is not None and getattr(value, "source", None) is not None:
            left_out = from_file.fields
        content = {
            field.name: self._node(getattr(value, field.name))
            for field in dataclasses.fields(value)  # pyright: ignore[reportArgumentType]
            if field.init and field.name not in left_out
        }
        # What is read from a file is read once, however short its text.
        least = 0 if from_file is not None else PART_CHARACTERS
        node = self._shared({"is": kind.__name__, "of": content}, least)
        if "at" in node:
            key = id(value)
            forget = weakref.ref(value, lambda _: self._encoded.pop(key, None))
            self._encoded[key] = (forget, node)
        return node

    def _array_node(self, array: np.ndarray) -> dict[str, Any]:
        if array.dtype.kind not in "biuf":
            raise TypeError(f"A project cannot keep an array of {array.dtype}.")
        about = {"type": array.dtype.str, "shape": list(array.shape)}
        if array.size <= INLINE_NUMBERS:
            return {"array": array.ravel().tolist(), **about}
        packed = zlib.compress(np.ascontiguousarray(array).tobytes(), 1)
        return {"array": self._put(packed), **about}

    def _shared(self, node: Any, least: int = PART_CHARACTERS) -> Any:
        text = _dump(node)
        if len(text) <= least:
            return node
        return {"at": self._put(text.encode())}

    def _put(self, content: bytes) -> str:
        key = hashlib.sha256(content).hexdigest()
        self._connection.execute(
            "INSERT OR IGNORE INTO parts VALUES (?, ?)", (key, content)
        )
        return key

    # Reading.

    def _parsed(self, text: object) -> Any:
        if not isinstance(text, str | bytes):
            raise TypeError(f"{type(text).__name__} instead of text")
        if len(text) > MAX_TEXT_BYTES:
            raise InputError(
                f"The project's database holds a text of {len(text) / 1e6:.0f} MB, which "
                "is far more than photoreg writes, so it is not read."
            )
        return json.loads(text)

    def _count(self, n_bytes: int) -> None:
        """Keeps account before anything of that size is made."""
        self._n_bytes += n_bytes
        if self._n_bytes > self._limits.project_bytes:
            raise InputError(
                f"The project's database unpacks to more than "
                f"{self._limits.project_mb:g} MB, so it is not read. If you trust it, set "
                f"{variable('project_mb')} higher."
            )

    def _value(self, node: Any) -> Any:
        self._n_values += 1
        if self._n_values > MAX_VALUES:
            raise InputError(
                f"The project's database expands to more than {MAX_VALUES} values, far more "
                "than photoreg writes, so it is not read."
            )
        if isinstance(node, list):
            return tuple(self._value(item) for item in node)
        if not isinstance(node, dict):
            return node
        if "at" in node:
            known = self._decoded.get(node["at"])
            if known is None:
                known = self._value(self._parsed(self._part(node["at"])))
                if dataclasses.is_dataclass(known):
                    self._decoded[node["at"]] = known
            return known
        if "is" in node:
            return self._dataclass(node)
        if "array" in node:
            return self._array(node)
        if "map" in node:
            return {self._value(k): self._value(v) for k, v in node["map"]}
        if "set" in node:
            return frozenset(self._value(item) for item in node["set"])
        if "bytes" in node:
            return self._part(node["bytes"])
        if "path" in node:
            return Path(node["path"])
        return self._find_file(node["file"])

    def _dataclass(self, node: dict[str, Any]) -> Any:
        kind = self._types.get(node["is"])
        if kind is None:
            raise InputError(
                f"The project holds a {node['is']!s:.40}, which this photoreg does not "
                "know. A newer one may have written it; update photoreg."
            )
        names = {field.name for field in dataclasses.fields(kind) if field.init}
        content = {
            name: self._value(child)
            for name, child in node["of"].items()
            if name in names
        }
        check_fields(kind, content)
        source, from_file = content.get("source"), self._from_file.get(kind)
        if source is None or from_file is None:
            return kind(**content)
        loaded = self._loaded.get((kind, source.path, source.sha256))
        if loaded is None:
            loaded = from_file.load(source.path)
        if loaded.source.sha256 != source.sha256:
            raise InputError(f"{source.path} has changed since it was last used.")
        content["source"] = loaded.source
        known = {field: getattr(loaded, field) for field in from_file.fields}
        # Kept arrays must be of the size of those in the file.
        check_fields(kind, known | content)
        return dataclasses.replace(loaded, **content)

    def _array(self, node: dict[str, Any]) -> np.ndarray:
        if not isinstance(node["type"], str) or not DTYPE.fullmatch(node["type"]):
            raise ValueError(f"array of {node['type']!r:.20}")
        dtype, shape = np.dtype(node["type"]), tuple(node["shape"])
        if len(shape) > MAX_DIMENSIONS or not all(
            type(side) is int and side >= 0 for side in shape
        ):
            raise ValueError(f"array of shape {shape!r:.40}")
        content, n_bytes = node["array"], math.prod(shape) * dtype.itemsize
        self._count(n_bytes)
        if isinstance(content, list):
            return np.array(content, dtype=dtype).reshape(shape)
        unpacker = zlib.decompressobj()
        raw = unpacker.decompress(self._part(content), n_bytes + 1)
        if len(raw) != n_bytes or not unpacker.eof:
            raise ValueError(f"an array of shape {shape} has not {n_bytes} bytes")
        return np.frombuffer(raw, dtype=dtype).reshape(shape).copy()

    def _part(self, key: str) -> bytes:
        row = self._connection.execute(
            "SELECT content FROM parts WHERE hash = ?", (key,)
        ).fetchone()
        if row is None:
            raise ValueError(f"part {key!s:.12} is missing")
        content = row[0]
        self._count(len(content))
        if hashlib.sha256(content).hexdigest() != key:
            raise ValueError(f"part {key!s:.12} has another content than it had")
        return content

    def _collect(self, node: Any, parts: set[str], files: set[str]) -> None:
        if isinstance(node, list):
            for item in node:
                self._collect(item, parts, files)
        elif isinstance(node, dict):
            if "at" in node and node["at"] not in parts:
                parts.add(node["at"])
                self._collect(self._parsed(self._part(node["at"])), parts, files)
            if "is" in node:
                self._collect(list(node["of"].values()), parts, files)
            if "file" in node:
                files.add(node["file"])
            for name in ("array", "bytes"):
                if isinstance(node.get(name), str):
                    parts.add(node[name])
            for name in ("map", "set"):
                self._collect(node.get(name), parts, files)


def _dump(node: Any) -> str:
    return json.dumps(node, separators=(",", ":"))
