"""What a refinement reports while it runs, and how it ended."""

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera
from photoreg.imaging.photo import Pair
from photoreg.parameters.genes import GeneMap
from photoreg.polish.disagreement import MeshError
from photoreg.registration.checkpoint import Checkpoint
from photoreg.registration.verdict import Verdict

Phase = Literal["prepare", "search", "polish"]


@dataclasses.dataclass(frozen=True, eq=False)
class Population:
    """The living individuals of a search."""

    genes: Float[np.ndarray, "p g"]
    """One row an individual, each gene in [-1, 1]."""
    costs: Float[np.ndarray, "p"]
    """Their costs; +inf where an individual sees too little."""
    gene_map: GeneMap
    """What the genes mean, for the photos that take part, in order."""

    def centers(self, n: int = 100) -> Float[np.ndarray, "n c 3"]:
        """Camera centres in world axes of the best ``n`` individuals, best first.

        One for each photo that takes part: a cloud that shrinks as the search goes on.
        """
        best = np.argsort(self.costs, kind="stable")[:n]
        return self.gene_map.poses(self.genes[best]).centers


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Progress:
    """One step of a running refinement."""

    phase: Phase
    """What is going on."""
    step: str
    """The same in plain words."""
    fraction: float
    """Share of the whole run's budget spent, in [0, 1]. It does not predict the time left."""
    generation: int
    """Generations of the search so far, over all restarts."""
    evaluations: int
    """Cost evaluations of the search so far."""
    best_cost: float
    """Cost of the best so far; comparable only within one phase."""
    median_cost: float
    """Median cost of the living population; the best cost where there is none."""
    elapsed_s: float
    """Seconds since the start."""
    cameras: tuple[Camera, ...]
    """The best so far, one a photo: always a complete answer."""
    quartile_costs: tuple[float, float] | None = None
    """First and third quartile of the living population's costs; None where there is
    none."""
    begins: str | None = None
    """What begins with this event, in plain words, for a mark in a curve: a restart of
    the search, a level of the polish. None: nothing new begins."""
    expected_error_px: float | None = None
    """Expected projection error of the best in pixels, by the last finished level of the
    polish; None before."""
    population: Population | None = None
    """The living individuals; None outside the search. Not copied: leave it out of
    what is sent to another process (``dataclasses.replace``) unless it is needed."""
    checkpoint: Checkpoint | None = None
    """What ``refine`` needs to resume from here; None before the search has begun, and
    where more than four photos are searched for one after the other: that starts over, and
    ends at the same answer. Made of the same arrays as ``population``."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Finished:
    """How a refinement ended."""

    cameras: tuple[Camera, ...]
    """The answer, one a photo."""
    start_cost: float
    """Cost of the cameras given."""
    cost: float
    """Cost of the answer, measured the same way; above ``start_cost`` only where the photos'
    details lie better on each other than at the start."""
    reason: str
    """Why it ended, in one sentence."""
    warnings: tuple[str, ...]
    """What makes the answer doubtful, one sentence each."""
    elapsed_s: float
    """Seconds it took."""
    generations: int
    """Generations of the search."""
    evaluations: int
    """Cost evaluations of the search."""
    seconds_by_phase: dict[str, float]
    """Seconds by phase: prepare, search, polish."""
    expected_errors_px: tuple[float | None, ...] = ()
    """Expected projection error of each photo's camera in pixels; None where a photo
    took no part or its camera was held. Empty where no polish ran: the search alone
    cannot tell."""
    standard_errors: tuple[str, ...] = ()
    """How sure each camera is, in plain words: one sentence a photo that took part."""
    undetermined: tuple[str, ...] = ()
    """What the photos leave open, in plain words, the weakest first."""
    mesh_error: MeshError | None = None
    """How far the mesh is from the surface that the photos show, in pixels of these on
    average; None where too few patches of the photos match, and where the start was
    kept."""
    verdict: Verdict | None = None
    """Whether the answer convinces. An unconvincing one is the first of the warnings
    too. None where no polish ran: what the search alone finds is not precise enough to
    be judged."""
    pairs: tuple[Pair, ...] = ()
    """The photos that were compared with each other, by index."""

    @property
    def expected_error_px(self) -> float | None:
        """Mean of the expected errors in pixels; None where nothing is known."""
        known = [error for error in self.expected_errors_px if error is not None]
        return sum(known) / len(known) if known else None


Event = Progress | Finished
