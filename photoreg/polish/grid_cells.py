"""Neighbouring points in one cell: what they share, and how they differ within it.

Points are ordered by cell; ``cell_starts`` holds the first point of each cell and, at
its end, the number of points.
"""

import numpy as np
from jaxtyping import Float, Int

ROW = 100_003
"""From one row of cells to the next, in keys: more than a photo has columns of cells."""


def cell_keys(cells: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "n"]:
    """One number a cell, of its column and row; in order, row by row."""
    column, row = cells.T
    return row * ROW + column


def cells_at(keys: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n 2"]:
    """Column and row, neither below 0, of each key."""
    row, column = np.divmod(keys, ROW)
    return np.column_stack([column, row])


def starts_of_cells(keys: Int[np.ndarray, "n"]) -> Int[np.ndarray, "bounds"]:
    """``cell_starts`` of points whose keys are in order."""
    is_first = np.concatenate([[True], keys[1:] != keys[:-1]])[: len(keys)]
    return np.append(np.flatnonzero(is_first), len(keys)).astype(np.int64)


def cell_means(
    values: Float[np.ndarray, "n *k"], cell_starts: Int[np.ndarray, "bounds"]
) -> Float[np.ndarray, "cells *k"]:
    """Mean of the rows of each cell."""
    sums = np.add.reduceat(values, cell_starts[:-1], axis=0)
    counts = np.diff(cell_starts)
    return sums / counts.reshape(-1, *[1] * (values.ndim - 1))


def within_cells(
    values: Float[np.ndarray, "n *k"], cell_starts: Int[np.ndarray, "bounds"]
) -> Float[np.ndarray, "n *k"]:
    """How far each row is from the mean of its cell."""
    means = cell_means(values, cell_starts)
    return values - np.repeat(means, np.diff(cell_starts), axis=0)
