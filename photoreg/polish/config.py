"""Settings of the polish."""

import dataclasses

import numpy as np

from photoreg.errors import InputError

MOST_POINTS = 10_000_000
"""Of a level: each takes some hundred bytes for every pair of photos."""

MOST_ROUNDS = 1_000_000


@dataclasses.dataclass(frozen=True, kw_only=True)
class PolishConfig:
    """Settings of the polish."""

    blurs_px: tuple[float, ...] = (8.0, 4.0, 2.0, 1.0, 0.5)
    """Blur of each level, coarse to fine, in pixels of a photo 1,024 px wide."""
    points: tuple[int, ...] = (8_000, 12_000, 16_000, 30_000, 60_000)
    """Surface points of each level over all pairs of photos."""
    rounds: tuple[int, ...] = (3, 2, 2, 1, 2)
    """How often each level renews visibility, exposure and noise, at least."""
    extra_rounds: int = 6
    """Rounds more a level, at most, while a round still moves the surface in the photos
    by more than half the level's blur."""
    iterations: int = 8
    """Steps of the minimisation a round, at most."""
    min_cosine: float = 0.25
    """Least cosine between the surface's normal and the view of a point that counts."""
    cell_px: float = 32.0
    """Side of the cells that share an offset of light, in pixels of 1,024."""
    max_side_px: int = 2048
    """Photos are reduced to this many pixels on the longer side at most."""
    use_colour: bool = True
    """Compare the photos' colours on the surface."""
    use_silhouette: bool = True
    """Pull the mesh's rim to the photos' edges."""
    use_correspondences: bool = dataclasses.field(default=True, repr=False)
    """End by matching patches of the photos over the surface, where colours are used."""
    correspondence_rounds: int = dataclasses.field(default=2, repr=False)
    """How often patches are matched, from where the round before ended."""
    patches: int = dataclasses.field(default=6_000, repr=False)
    """Patches to match over all pairs of photos, at most about."""
    rim_reaches_px: tuple[float, ...] = (40.0, 25.0, 12.0, 6.0, 4.0)
    """How far each level looks for the edge, in pixels of a photo 1,024 px wide."""
    rim_points: int = 1200
    """Rim points a photo, at most about."""
    use_shading: bool = dataclasses.field(default=True, repr=False)
    """Where there is but one photo, compare it with the shading of the surface."""
    shading_reaches_px: tuple[float, ...] = dataclasses.field(
        default=(40.0, 30.0, 20.0, 12.0, 8.0), repr=False
    )
    """Changes of brightness slower than this are left out at each level, in pixels of a
    photo 1,024 px wide; the last at further levels, too."""
    shading_points: int = dataclasses.field(default=8_000, repr=False)
    """Pixels that are compared with the shading, at most."""

    def __post_init__(self) -> None:
        n = len(self.blurs_px)
        if n == 0 or len(self.points) != n or len(self.rounds) != n:
            raise InputError(
                "The polish needs blurs_px, points and rounds of one length, at least "
                f"one level, but they have {n}, {len(self.points)}, {len(self.rounds)}."
            )
        if not all(np.isfinite(b) and b >= 0.0 for b in self.blurs_px):
            raise InputError(f"blurs_px should be 0 or more, but is {self.blurs_px}.")
        if self.extra_rounds < 0:
            raise InputError(
                f"extra_rounds should be 0 or more, but is {self.extra_rounds}."
            )
        if min(self.points) < 100 or min(self.rounds) < 1 or self.iterations < 1:
            raise InputError(
                "A level of the polish needs at least 100 points, 1 round and 1 iteration."
            )
        if max(self.points) > MOST_POINTS:
            raise InputError(
                f"A level of the polish takes up to {MOST_POINTS:,} points, but points "
                f"is {max(self.points):g}."
            )
        if self.correspondence_rounds < 1:
            raise InputError(
                "correspondence_rounds should be 1 or more, but is "
                f"{self.correspondence_rounds}."
            )
        if max(*self.rounds, self.extra_rounds, self.iterations) > MOST_ROUNDS:
            raise InputError(
                f"The polish takes up to {MOST_ROUNDS:,} rounds and iterations."
            )
        if not 0.0 < self.min_cosine < 1.0:
            raise InputError(
                f"min_cosine should be between 0 and 1, but is {self.min_cosine}."
            )
        if not 0.0 < self.cell_px < np.inf:
            raise InputError(f"cell_px should be above 0, but is {self.cell_px}.")
        if self.max_side_px < 16:
            raise InputError(
                f"max_side_px should be at least 16, but is {self.max_side_px}."
            )
        if self.use_silhouette and len(self.rim_reaches_px) < n:
            raise InputError(
                f"rim_reaches_px should have one reach a level, {n}, but has "
                f"{len(self.rim_reaches_px)}."
            )
        if not all(0.0 <= reach < np.inf for reach in self.rim_reaches_px):
            raise InputError(
                f"rim_reaches_px should be 0 or more, but is {self.rim_reaches_px}."
            )
        reaches = self.shading_reaches_px
        if not reaches or not all(0.0 < reach < np.inf for reach in reaches):
            raise InputError(
                f"shading_reaches_px should be numbers above 0, but is {reaches}."
            )
        if not 1_000 <= self.shading_points <= MOST_POINTS:
            raise InputError(
                f"shading_points should be 1,000 to {MOST_POINTS:,}, but is "
                f"{self.shading_points:g}."
            )
        if not 0 <= self.patches <= MOST_POINTS:
            raise InputError(
                f"patches should be 0 to {MOST_POINTS:,}, but is {self.patches:g}."
            )
        if not 0 <= self.rim_points <= MOST_POINTS:
            raise InputError(
                f"rim_points should be 0 to {MOST_POINTS:,}, but is {self.rim_points:g}."
            )
