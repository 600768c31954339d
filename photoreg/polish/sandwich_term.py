"""A term trusted as far as its scatter allows, direction by direction.

A term's weight says how much it knows on the whole. But colours that show to a tenth of
a pixel how the photos lie on each other may say nothing about both sliding over the surface
together, whatever their normal matrix says: slow differences of appearance pull there, and
the pulls of neighbouring blocks add up. The covariance S of the gradient, by its scatter
over blocks, shows it; N S^-1 N is then what the term knows, N being its normal matrix.
"""

import dataclasses

import numpy as np
import scipy.special
from jaxtyping import Float

from photoreg.polish.levenberg_marquardt import Quadratic, Term

RANGE = 1e-9
"""Directions with less than this share of the largest eigenvalue are not known."""
SURPRISE = 1e-3
"""Probability below which a term's disagreement is not due to chance."""


@dataclasses.dataclass(frozen=True, eq=False)
class SandwichTerm:
    """Half the square of the term's gradient in units of its own scatter.

    References:
        L. P. Hansen, "Large sample properties of generalized method of moments
        estimators", Econometrica 50(4), 1982, doi:10.2307/1912775.
    """

    term: Term
    inverse_scatter: Float[np.ndarray, "p p"]
    """S^-1 within what the term knows, in the numbers of its ``Quadratic.handy``."""
    factor: float = 1.0
    """By which S is larger than the blocks show, because others disagree with the term."""
    surprise: float = 1.0
    """Probability of such a disagreement by chance."""

    @classmethod
    def measured(
        cls,
        term: Term,
        normal: Float[np.ndarray, "p p"],
        scatter: Float[np.ndarray, "p p"],
    ) -> "SandwichTerm":
        """The term with its scatter, never below its normal matrix along any direction."""
        values, vectors = np.linalg.eigh(normal)
        known = values > RANGE * values.max(initial=1e-300)
        whiten = vectors[:, known] / np.sqrt(values[known])
        ratios, along = np.linalg.eigh(whiten.T @ scatter @ whiten)
        basis = whiten @ along
        return cls(term, (basis / np.maximum(ratios, 1.0)) @ basis.T)

    def linearise(self, x: Float[np.ndarray, "p"]) -> Quadratic:
        """The cost and its local model at ``x``."""
        model = self.term.linearise(x).handy(len(x))
        weighed = self.inverse_scatter @ model.gradient
        return Quadratic(
            0.5 * float(model.gradient @ weighed),
            model.normal @ weighed,
            model.normal @ self.inverse_scatter @ model.normal,
            model.rows,
        )

    def doubted(
        self, x: Float[np.ndarray, "p"], covariance: Float[np.ndarray, "p p"]
    ) -> "SandwichTerm":
        """The term with its scatter as large as its disagreement with others says.

        An outline that is fat all around, or haze over half a photo, is wrong in the same way
        in all blocks, so blocks do not show it. Other terms do.

        Args:
            x: Where the others lead.
            covariance: Of all of ``x``.

        References:
            R. C. Paule and J. Mandel, "Consensus values and weighting factors", Journal
            of Research of the NBS 87(5), 1982, doi:10.6028/jres.087.022.
        """
        model = self.term.linearise(x).handy(len(x))
        if model.rows is not None:
            covariance = covariance[np.ix_(model.rows, model.rows)]
        values, vectors = np.linalg.eigh(self.inverse_scatter)
        known = values > RANGE * values.max(initial=1e-300)
        # In these units S is one, and the others' covariance diagonal.
        unit = vectors[:, known] * np.sqrt(values[known])
        slopes = unit.T @ model.normal
        spreads, along = np.linalg.eigh(slopes @ covariance @ slopes.T)
        spreads = np.maximum(spreads, 0.0)
        squares = (along.T @ unit.T @ model.gradient) ** 2
        low, high = 1.0, max(1.0, float(squares.sum()) / max(len(squares), 1))
        for _ in range(60):
            middle = 0.5 * (low + high)
            if (squares / (middle + spreads)).sum() > len(squares):
                low = middle
            else:
                high = middle
        chi_square = float((squares / (1.0 + spreads)).sum())
        return dataclasses.replace(
            self,
            inverse_scatter=self.inverse_scatter / high,
            factor=high,
            surprise=float(scipy.special.chdtrc(len(squares), chi_square)),
        )
