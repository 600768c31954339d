"""Slow, obvious twins of ``photoreg.search.trimmed_mean``."""

import numpy as np


def trimmed_mean(values, n_low: int, n_high: int) -> float:
    kept = sorted(float(value) for value in values)[n_low : len(values) - n_high]
    return float(np.mean(kept)) if kept else np.inf
