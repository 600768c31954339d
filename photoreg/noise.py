"""Solid noise: smooth random colours at every point of space, at several scales."""

import numba as nb
import numpy as np
from jaxtyping import Float

TABLE_SIDE = 32
"""Lattice values along a side. The table repeats after it; each octave is turned and
shifted, so that the repetitions never meet. 400 kB: it stays in the cache."""
MAX_OCTAVES = 12


class SolidNoise:
    """Value noise of three independent channels, a function of its seed only."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 0x5011D])
        side = TABLE_SIDE
        self._table = rng.uniform(-1.0, 1.0, (side, side, side, 3)).astype(np.float32)
        turns = np.linalg.qr(rng.normal(size=(MAX_OCTAVES, 3, 3)))[0]
        self._turns = np.ascontiguousarray(turns)
        self._shifts = rng.uniform(0.0, side, (MAX_OCTAVES, 3))

    def __call__(
        self,
        points: Float[np.ndarray, "n 3"],
        frequency: float,
        octaves: int = 1,
        gain: float = 0.5,
    ) -> Float[np.ndarray, "n 3"]:
        """Noise at ``points``, (n, 3) float32, of about unit amplitude, mean zero.

        Args:
            points: where, in any unit.
            frequency: lattice cells per unit of the first octave; each next octave
                has twice the frequency and ``gain`` times the amplitude.
            octaves: how many octaves are summed, 1 to 12.
            gain: amplitude of an octave relative to the one before.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        return _sum_octaves(
            points, self._table, self._turns, self._shifts, frequency, octaves, gain
        )


@nb.njit(nogil=True, cache=True)
def _sum_octaves(points, table, turns, shifts, frequency, octaves, gain):  # noqa: ANN001, ANN202
    mask = table.shape[0] - 1
    out = np.zeros((points.shape[0], 3), dtype=np.float32)
    # Sums of octaves are scaled so that the variance does not depend on their number.
    power = 0.0
    for octave in range(octaves):
        power += gain ** (2 * octave)
    scale = np.float32(1.8 / np.sqrt(power))
    for n in range(points.shape[0]):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        r, g, b = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        step, amplitude = frequency, np.float32(1.0)
        for octave in range(octaves):
            turn, shift = turns[octave], shifts[octave]
            x = (turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz) * step + shift[0]
            y = (turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz) * step + shift[1]
            z = (turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz) * step + shift[2]
            ix, iy, iz = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
            fx, fy, fz = np.float32(x - ix), np.float32(y - iy), np.float32(z - iz)
            # Quintic steps: the noise has continuous second derivatives.
            fx = (
                fx
                * fx
                * fx
                * (fx * (fx * np.float32(6) - np.float32(15)) + np.float32(10))
            )
            fy = (
                fy
                * fy
                * fy
                * (fy * (fy * np.float32(6) - np.float32(15)) + np.float32(10))
            )
            fz = (
                fz
                * fz
                * fz
                * (fz * (fz * np.float32(6) - np.float32(15)) + np.float32(10))
            )
            for corner in range(8):
                cx, cy, cz = corner & 1, (corner >> 1) & 1, corner >> 2
                weight = amplitude
                weight *= fx if cx else np.float32(1) - fx
                weight *= fy if cy else np.float32(1) - fy
                weight *= fz if cz else np.float32(1) - fz
                i, j, k = (ix + cx) & mask, (iy + cy) & mask, (iz + cz) & mask
                r += weight * table[i, j, k, 0]
                g += weight * table[i, j, k, 1]
                b += weight * table[i, j, k, 2]
            step *= 2.0
            amplitude *= np.float32(gain)
        out[n, 0], out[n, 1], out[n, 2] = r * scale, g * scale, b * scale
    return out
