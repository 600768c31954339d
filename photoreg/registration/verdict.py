"""Whether the end of a polish convinces: one word, and one plain sentence."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from photoreg.polish.misfit import Disagreement
from photoreg.words import listed

Grade = Literal["convincing", "plausible", "unconvincing"]

COLOURS_AGREE = 0.06
"""Most disagreement of colours over the typical place of the surface for photos that
agree. Right ends had 0.04 or less where the light is the same in both photos, wrong
ones 0.09 or more unless both cameras had slid along the surface together."""

OUTLINE_FITS = 0.15
"""Most disagreement of an outline that is enough without colours. Where the light had
moved between the photos, right ends had 0.03 or less; wrong ends had 0.23 or more."""

OUTLINE_HOLDS = 0.3
"""Most disagreement of an outline that keeps a camera from sliding. Right ends had up
to 0.25 with a fat scan, 0.31 behind an occluder, and 0.5 to 0.9 where the mesh ends in
the middle of a wall."""

ONE_IN_20 = 1.645
"""Standard errors that a normal number exceeds by chance once in 20 times."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How far an answer is to be believed.

    Over 96 refinements of made scenes and of nine sets with known cameras (the bench
    ``verdicts``): of the 54 that ended within 2 px none was called unconvincing, 42 were
    convincing and 12 plausible. The 42 that ended 41 to 360 px off, from starts too far
    for the preset, were all unconvincing. Ends between are rarer and harder to tell: two
    of an earlier polish, 9 px off, were called plausible, because both cameras had slid
    along the surface together and agreed in colour as well as right ones do.
    """

    grade: Grade
    sentence: str
    """The grade and its reason, in plain words."""

    @property
    def is_credible(self) -> bool:
        """Whether nothing speaks against the answer."""
        return self.grade != "unconvincing"


def decide_verdict(fit: Disagreement, names: Sequence[str]) -> Verdict:
    """Judges cameras by colours and outlines apart.

    Together they would not do: on a wall without outlines right and wrong ends have
    the same sum, and so they have where the light changed.

    Args:
        fit: How badly the cameras fit, ``agreement.against_chance``.
        names: What the photos are called.
    """
    agrees = [fit.typical_colour_of(i) <= COLOURS_AGREE for i in range(len(names))]
    fits = [outline <= OUTLINE_FITS for outline in fit.outlines]
    wrong = [
        name
        for name, by_colour, by_outline in zip(names, agrees, fits, strict=True)
        if not by_colour and not by_outline
    ]
    if wrong:
        return Verdict(
            "unconvincing",
            f"Unconvincing: in {listed(wrong)} neither the colours on the surface nor "
            "the outline fit, so the cameras are probably wrong. Look at the overlay, "
            "align them more closely, or try the preset thorough.",
        )
    if not all(agrees):
        odd = [name for name, agree in zip(names, agrees, strict=True) if not agree]
        return Verdict(
            "plausible",
            f"Plausible: the outlines fit, but the colours of {listed(odd)} differ "
            "from the other photos', as under another light.",
        )
    loose = [
        name
        for name, outline in zip(names, fit.outlines, strict=True)
        if outline > OUTLINE_HOLDS
    ]
    if loose:
        return Verdict(
            "plausible",
            "Plausible: the photos agree on the surface, but the outline in "
            f"{listed(loose)} does not confirm it; cameras that slide along the "
            "surface together would look alike. Look at the overlay.",
        )
    return Verdict(
        "convincing",
        "Convincing: the photos agree on the surface, and the outlines fit.",
    )


def is_better(answer: Disagreement, start: Disagreement) -> bool:
    """Whether cameras are better than those they came from, by what the verdict measures.

    A polish draws colours and outlines together, noise too. So an outline counts where
    it holds, and else as chance does; and colours are better only by more than their
    cells' scatter gives once in 20 times.

    Args:
        answer: How badly the cameras fit, ``agreement.against_chance``.
        start: The same of those that they came from.
    """
    margin = ONE_IN_20 * float(np.hypot(_colour_error(answer), _colour_error(start)))
    before = _typical_colour(start) * _outline(start)
    return (_typical_colour(answer) + margin) * _outline(answer) < before


def _typical_colour(fit: Disagreement) -> float:
    colours = list(fit.typical_colours.values())
    return float(np.mean(colours)) if colours else 1.0


def _colour_error(fit: Disagreement) -> float:
    errors = list(fit.typical_errors.values())
    return float(np.linalg.norm(errors)) / max(1, len(errors))


def _outline(fit: Disagreement) -> float:
    held = [outline if outline <= OUTLINE_HOLDS else 1.0 for outline in fit.outlines]
    return float(np.mean(held))
