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


@nb.njit(nogil=True, cache=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
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
        red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        step, amplitude = frequency, scale
        for octave in range(octaves):
            turn, shift = turns[octave], shifts[octave]
            x = (turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz) * step + shift[0]
            y = (turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz) * step + shift[1]
            z = (turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz) * step + shift[2]
            floor_x, floor_y, floor_z = np.floor(x), np.floor(y), np.floor(z)
            i, j, k = int(floor_x) & mask, int(floor_y) & mask, int(floor_z) & mask
            i1, j1, k1 = (i + 1) & mask, (j + 1) & mask, (k + 1) & mask
            fx = _quintic(np.float32(x - floor_x))
            fy = _quintic(np.float32(y - floor_y))
            fz = amplitude * _quintic(np.float32(z - floor_z))
            gx, gy, gz = np.float32(1) - fx, np.float32(1) - fy, amplitude - fz
            w00, w01, w10, w11 = gx * gy, gx * fy, fx * gy, fx * fy
            for channel in range(3):
                near = w00 * table[i, j, k, channel] + w01 * table[i, j1, k, channel]
                near += w10 * table[i1, j, k, channel] + w11 * table[i1, j1, k, channel]
                far = w00 * table[i, j, k1, channel] + w01 * table[i, j1, k1, channel]
                far += (
                    w10 * table[i1, j, k1, channel] + w11 * table[i1, j1, k1, channel]
                )
                value = gz * near + fz * far
                if channel == 0:
                    red += value
                elif channel == 1:
                    green += value
                else:
                    blue += value
            step *= 2.0
            amplitude *= np.float32(gain)
        out[n, 0], out[n, 1], out[n, 2] = red, green, blue
    return out


@nb.njit(nogil=True, cache=True)
def _quintic(t):  # noqa: ANN001, ANN202
    """A step from 0 to 1 with continuous second derivatives (Perlin, 2002)."""
    six, fifteen, ten = np.float32(6), np.float32(15), np.float32(10)
    return t * t * t * (t * (t * six - fifteen) + ten)
