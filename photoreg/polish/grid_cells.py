"""Neighbouring points in one cell: what they share, and how they differ within it.

Points are ordered by cell; ``cell_starts`` holds the first point of each cell and, at
its end, the number of points.
"""

import numpy as np
from jaxtyping import Float, Int


def cell_means(
    values: Float[np.ndarray, "n *k"], cell_starts: Int[np.ndarray, "cells+1"]
) -> Float[np.ndarray, "cells *k"]:
    """Mean of the rows of each cell."""
    sums = np.add.reduceat(values, cell_starts[:-1], axis=0)
    counts = np.diff(cell_starts)
    return sums / counts.reshape(-1, *[1] * (values.ndim - 1))


def within_cells(
    values: Float[np.ndarray, "n *k"], cell_starts: Int[np.ndarray, "cells+1"]
) -> Float[np.ndarray, "n *k"]:
    """How far each row is from the mean of its cell."""
    means = cell_means(values, cell_starts)
    return values - np.repeat(means, np.diff(cell_starts), axis=0)
