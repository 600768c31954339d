"""How far photos disagree with each other and with the mesh, as numbers."""

import dataclasses

import numpy as np

AGREEMENT_PX = 0.05
"""An error of the mesh below this is reported as none: matches are no better."""
OWN_UNITS = "of the scan's units"


@dataclasses.dataclass(frozen=True)
class MeshError:
    """How far the mesh is from the surface that the photos show."""

    sigma: float
    """Standard deviation along its normal, in model units."""
    sigma_px: float
    """How far that moves a place along the epipolar line, in pixels."""

    def in_words(self, diagonal: float, unit: str = "") -> str:
        """One sentence.

        Args:
            diagonal: The mesh's, in model units.
            unit: What these are called, as "mm"; empty where that is not known.
        """
        if self.sigma_px < AGREEMENT_PX:
            return f"Scan and photos agree to less than {AGREEMENT_PX:g} px."
        length = f"{self.sigma:.2g} {unit or OWN_UNITS}"
        return (
            f"Scan and photos disagree by about {length} along the surface's normal, "
            f"{100.0 * self.sigma / diagonal:.2g} % of its diagonal, or "
            f"{self.sigma_px:.2g} px in the photos."
        )


@dataclasses.dataclass(frozen=True)
class Disagreement:
    """How badly cameras fit, colours and outlines apart: 0 is perfect, 1 chance."""

    colours: dict[tuple[int, int], float]
    """Of each pair of photos: the mean squared difference over the surface points that
    both see, after gain and the slow changes of light, cut off at and relative to what
    unrelated colours of the same contrast would give; 1 where nothing is shared."""
    typical_colours: dict[tuple[int, int], float]
    """The same of each pair's median cell: what covers less than half of the surface in
    one photo is not in it."""
    outlines: tuple[float, ...]
    """Of each photo: the mean squared distance of the rim to the nearest clear edge,
    cut off at and relative to ``RIM_REACH_PX``; 1 where there is no rim."""
    typical_errors: dict[tuple[int, int], float] = dataclasses.field(
        default_factory=dict
    )
    """Standard errors of the typical colours, as their cells differ."""

    shadings: tuple[float, ...] = ()
    """Where there is but one photo: the share of its detail that the shape of the surface
    does not explain, 1 where it explains nothing. Empty where photos are compared."""

    @property
    def total(self) -> float:
        """One number to compare by: geometric mean of colours' and outlines' means.

        The noise of neither is known, and then the likelihood of cameras falls with
        the logarithms of both. Their sum would not: an outline that is rough everywhere
        hides colours that halve, and half a pixel with them. Of one photo, what the
        shading leaves open counts twice as much as the outline: it is no noise.
        """
        if self.shadings:
            shading, outline = (
                float(np.mean(self.shadings)),
                float(np.mean(self.outlines)),
            )
            return (2.0 * shading + outline) / 3.0
        colour = float(np.mean(list(self.colours.values()))) if self.colours else 1.0
        return float(np.sqrt(colour * np.mean(self.outlines)))

    def typical_colour_of(self, photo: int) -> float:
        """Typical colours of the pair of ``photo`` that agrees best; 1: no pair."""
        return min(
            (share for pair, share in self.typical_colours.items() if photo in pair),
            default=1.0,
        )
