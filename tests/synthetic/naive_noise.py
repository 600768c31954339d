"""The slow twin of photoreg.synthetic.noise: one point, one octave, one corner at a time."""

import numpy as np


def solid_noise(noise, points, frequency, octaves, gain):
    table, turns, shifts = noise._table, noise._turns, noise._shifts
    side = len(table)
    values = []
    for point in points:
        total = np.zeros(3)
        for octave in range(octaves):
            place = turns[octave] @ point * frequency * 2.0**octave + shifts[octave]
            cell = np.floor(place).astype(int)
            t = place - cell
            t = 6 * t**5 - 15 * t**4 + 10 * t**3
            for corner in np.ndindex(2, 2, 2):
                weight = np.prod(np.where(corner, t, 1.0 - t))
                total += gain**octave * weight * table[tuple((cell + corner) % side)]
        power = sum(gain ** (2 * octave) for octave in range(octaves))
        values.append(1.8 * total / np.sqrt(power))
    return np.array(values)
