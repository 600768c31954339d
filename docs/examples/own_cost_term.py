"""A cost term of one's own: the distance between two cameras, measured with a tape.

Two cameras were solved from few clicked points, which leaves their distance to the
object uncertain. The solver of the polish minimises a sum of terms: here the prior of
what the clicks say of both centres, and the tape.
"""

import dataclasses

import numpy as np

from photoreg.polish.levenberg_marquardt import Damping, Prior, Quadratic, minimise


@dataclasses.dataclass(frozen=True)
class TapeMeasure:
    """Half the squared error of the distance between two points, in its sigmas."""

    distance: float
    sigma: float

    def linearise(self, x: np.ndarray) -> Quadratic:
        """The cost at ``x``, both points in a row, with its derivatives."""
        apart = x[:3] - x[3:]
        length = float(np.linalg.norm(apart))
        residual = (length - self.distance) / self.sigma
        row = np.concatenate([apart, -apart]) / length / self.sigma
        return Quadratic(0.5 * residual**2, residual * row, np.outer(row, row))


clicked = np.array([0.0, 0.1, -3.0, 1.4, 0.0, -2.6])
"""Both centres as the clicks have them, in metres; 1.46 m apart."""
clicks = Prior(clicked, np.diag(np.tile([0.02, 0.02, 0.15], 2) ** -2.0))
"""Good to 2 cm across the view, and to 15 cm along it."""
tape = TapeMeasure(distance=1.50, sigma=0.005)

*_, last = minimise([clicks, tape], clicked, Damping())
apart = np.linalg.norm(last.x[:3] - last.x[3:])
print(f"The cameras are {apart:.3f} m apart; the first moved to {last.x[:3].round(3)}.")
