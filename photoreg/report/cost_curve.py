"""The cost of a refinement as one curve over search and polish."""

import dataclasses
from typing import Literal

import numpy as np

from photoreg.checks import Measured
from photoreg.registration.events import Progress

Mark = Literal["", "restart", "level"]


@dataclasses.dataclass(frozen=True)
class CurvePoint:
    """One point of the cost curve."""

    step: int
    """Which step of search and polish it is, from 0."""
    best: Measured
    """Cost of the best, relative to the first."""
    median: Measured
    """The same of the population's median; equal to ``best`` without one."""
    low: Measured | None = None
    """The same of the population's lower quartile; None without a population."""
    high: Measured | None = None
    """The same of the population's upper quartile; None without a population."""
    mark: Mark = ""
    """What begins here: a restart of the search, a level of the polish."""


class CostCurve:
    """The cost relative to the first one, as one curve over all phases.

    Costs compare only while they are measured the same way: search and polish, and
    the polish's levels, have measures of their own. Where the measure changes, which
    shows as a rise of the best, the curve goes on from where it was.
    """

    def __init__(
        self, cost: float | None = None, level: float = 1.0, step: int = -1
    ) -> None:
        """Begins a curve, or goes on with one.

        Args:
            cost: The best cost at its last step.
            level: The curve there.
            step: Which step that was.
        """
        self._cost, self._level, self.step = cost, level, step

    def points(self, event: Progress) -> list[CurvePoint]:
        """The event's point; none before there is a cost."""
        best = event.best_cost
        if not 0.0 < best < np.inf:
            return []
        if self._cost is not None:
            self._level *= min(1.0, best / self._cost)
        self._cost = best
        self.step += 1
        low, high = event.quartile_costs or (None, None)
        return [
            CurvePoint(
                self.step,
                self._level,
                self._share(event.median_cost),
                None if low is None else self._share(low),
                None if high is None else self._share(high),
                _mark(event, is_first=self.step == 0),
            )
        ]

    def _share(self, cost: float) -> float:
        """A cost of the population relative to the first; the best's if it is none."""
        assert self._cost is not None
        if not self._cost <= cost < np.inf:
            return self._level
        return self._level * cost / self._cost


def _mark(event: Progress, *, is_first: bool) -> Mark:
    """Whether a restart of the search or a level of the polish begins here."""
    if event.begins is None or is_first:
        return ""
    return "level" if event.phase == "polish" else "restart"
