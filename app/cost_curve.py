"""The cost of a refinement as one curve over search and polish."""

import numpy as np

from app.run import CurvePoint, Mark
from photoreg.registration import Progress


class CostCurve:
    """The cost relative to the first one, as one curve over all phases.

    Costs compare only while they are measured the same way: search and polish, and
    the polish's levels, have measures of their own. Where the measure changes, which
    shows as a rise of the best, the curve goes on from where it was.
    """

    def __init__(self) -> None:
        self._cost: float | None = None
        self._level = 1.0
        self._step = -1
        self._stage: tuple[str, int] | None = None

    def points(self, event: Progress) -> list[CurvePoint]:
        """The event's point; none before there is a cost."""
        best = event.best_cost
        if not 0.0 < best < np.inf:
            return []
        if self._cost is not None:
            self._level *= min(1.0, best / self._cost)
        self._cost = best
        self._step += 1
        return [
            CurvePoint(
                self._step,
                self._level,
                self._share(event.median_cost),
                None,
                None,
                self._mark(event),
            )
        ]

    def _share(self, cost: float) -> float:
        """A cost of the population relative to the first; the best's if it is none."""
        assert self._cost is not None
        if not self._cost <= cost < np.inf:
            return self._level
        return self._level * cost / self._cost

    def _mark(self, event: Progress) -> Mark:
        """Whether a restart of the search or a level of the polish begins here."""
        stage = (event.phase, _level(event) if event.phase == "polish" else 0)
        before, self._stage = self._stage, stage
        if before is None or before == stage:
            return ""
        return "level" if event.phase == "polish" else "restart"


def _level(event: Progress) -> int:
    """Which level of the polish; told by its words."""
    digits = [word for word in event.step.replace(",", " ").split() if word.isdigit()]
    return int(digits[0]) if digits else 0
