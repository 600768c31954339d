"""Checks of the public border: shapes, finiteness, ranges, files that are read."""

import contextlib
import os
import reprlib
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated

import numpy as np

from photoreg.errors import InputError

Measured = Annotated[float, "may be infinite or NaN"]
"""A number that was measured. Every other one that a project keeps must be finite."""

_inputs: ContextVar[set[Path] | None] = ContextVar("inputs", default=None)


def check_points(points: np.ndarray, name: str) -> np.ndarray:
    """Returns ``points`` as (n, 3) float64.

    Raises:
        InputError: if the shape is not (n, 3) or a row is not finite.
    """
    return check_rows(points, 3, name)


def check_rows(values: np.ndarray, n_columns: int, name: str) -> np.ndarray:
    """Returns ``values`` as (n, n_columns) float64, every row finite.

    Raises:
        InputError: if the shape differs or a row is not finite.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != n_columns:
        raise InputError(
            f"{name} should have shape (n, {n_columns}), one row per item, "
            f"but has shape {values.shape}."
        )
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size > 0:
        rows = "1 row that is" if bad.size == 1 else f"{bad.size} rows that are"
        raise InputError(
            f"{name} has {rows} not finite (first: row {bad[0]}). Remove what is not "
            "and load again."
        )
    return values


def check_finite_array(values: object, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Returns ``values`` as a float64 array of exactly ``shape``, all finite.

    Raises:
        InputError: if it is not numeric, has another shape or is not finite.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{name} should be numbers of shape {shape}, but {reprlib.repr(values)} could "
            "not be read as numbers."
        ) from error
    if array.shape != shape:
        raise InputError(
            f"{name} should have shape {shape}, but has shape {array.shape}."
        )
    if not np.isfinite(array).all():
        raise InputError(f"{name} should be finite, but holds NaN or infinity.")
    return array


def check_input_file(path: Path, what: str, max_mb: float | None = None) -> Path:
    """Returns ``path`` if it is a readable file, not empty and not above ``max_mb``.

    Raises:
        InputError: if it does not exist, is a folder, is empty, too large or cannot be
            read.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"The {what} {path} does not exist. Check the path.")
    if not path.is_file():
        raise InputError(f"The {what} {path} is not a file.")
    if not os.access(path, os.R_OK):
        raise InputError(f"The {what} {path} cannot be read: permission denied.")
    if path.stat().st_size == 0:
        raise InputError(f"The {what} {path} is empty (0 bytes).")
    size_mb = path.stat().st_size / 1e6
    if max_mb is not None and size_mb > max_mb:
        raise InputError(
            f"The {what} {path.name} has {size_mb:,.1f} MB; up to {max_mb:,.0f} MB are "
            "read. Reduce it, or raise the limit (SECURITY.md names its variable)."
        )
    note_input(path)
    return path


@contextlib.contextmanager
def noting_inputs() -> Iterator[None]:
    """Until the end, every file that is read is noted as one not to be written over.

    For a command, which ends; a library's user may well save what was loaded.
    """
    token = _inputs.set(set())
    try:
        yield
    finally:
        _inputs.reset(token)


def note_input(path: Path) -> None:
    """Notes a file that is read, if anybody wants to know."""
    noted = _inputs.get()
    if noted is not None:
        noted.add(path)


def inputs_read() -> frozenset[Path]:
    """The files noted so far."""
    return frozenset(_inputs.get() or ())
