"""The overlap of silhouettes written down plainly: one turn after another, cell by cell."""

import numpy as np

from photoreg.placing.silhouette_grid import ANGLES, RADII, cell_areas


def naive_overlaps(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Common area over joint area for each turn of ``other``."""
    areas = cell_areas()
    found = []
    for turn in range(ANGLES):
        common = total = 0.0
        for r in range(RADII):
            for a in range(ANGLES):
                turned = other[r, (a - turn) % ANGLES]
                common += areas[r] * one[r, a] * turned
                total += areas[r] * (one[r, a] + turned)
        found.append(common / (total - common))
    return np.array(found)
