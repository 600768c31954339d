"""Checks of the public border: shapes, finiteness, ranges, files to read and write."""

import os
import reprlib
from pathlib import Path

import numpy as np

from photoreg.errors import InputError, OutputError


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
    return path


def check_output_file(path: Path, suffixes: tuple[str, ...]) -> Path:
    """Returns ``path`` if a file of one of ``suffixes`` can be written there.

    Called before long work starts, so that a wrong folder costs nothing.

    Raises:
        OutputError: if the suffix is unknown, the folder is missing or not
            writable, or the path is a folder.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise OutputError(
            f"Cannot write {path}: its suffix should be {' or '.join(suffixes)}, "
            f"but is {path.suffix or 'missing'}."
        )
    if path.is_dir():
        raise OutputError(f"Cannot write {path}: it is a folder; give a file name.")
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(
            f"Cannot write {path}: the folder {folder} does not exist. Make it first."
        )
    try:
        # Only opening tells: permission bits mislead for root and on network drives.
        with path.open("ab"):
            pass
    except OSError as error:
        raise OutputError(
            f"Cannot write {path}: {error.strerror or error}. Choose another place."
        ) from error
    if path.stat().st_size == 0:
        path.unlink()
    return path
