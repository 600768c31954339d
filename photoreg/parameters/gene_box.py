"""The intervals of the genes, and how far they reach in the photos."""

import dataclasses
from typing import Literal

import numpy as np

from photoreg.errors import InputError
from photoreg.parameters.bounds import (
    CROPPED_PRINCIPAL,
    CROPPED_REST,
    CROPPED_ROTATION,
    PriorScales,
)

CameraModel = Literal["pinhole", "full"]

Coordinates = Literal["camera", "object"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class GeneBox:
    """Half-widths of the gene intervals around the pre-registration.

    The defaults are the paper's, in ``camera`` coordinates: focal length, principal
    point, rotation about the camera's own centre, camera centre. In ``object``
    coordinates rotation is about the object's centroid, and ``scale`` and ``shift``
    take the place of ``translation``.
    """

    focal: float = PriorScales.focal
    """Focal length, as a share of itself, above 0. In ``object`` coordinates the
    distance goes with it, so the object keeps its size in the photo."""
    principal_point: float = PriorScales.principal_point
    """Principal point, as a share of the photo's width and height, above 0."""
    rotation_deg: float = PriorScales.rotation_deg
    """Rotation about each axis of the camera, in degrees, in (0, 90]."""
    translation: float = PriorScales.translation
    """Camera centre along each world axis, as a share of its distance to the
    object's centroid, above 0. Only in ``camera`` coordinates."""
    scale: float = 0.05
    """Size of the object in the photo, as a share, above 0. Only in ``object``
    coordinates."""
    shift: float = 0.03
    """Place of the object in the photo, as a share of the photo's longer side, above
    0. Only in ``object`` coordinates."""
    aspect: float = 0.02
    """fy / fx, as a share, above 0. Only in the ``full`` model in ``object``
    coordinates; in ``camera`` coordinates fx and fy each have the ``focal`` interval."""
    skew: float = 0.005
    """Skew, as a share of the focal length, above 0. Only in the ``full`` model. The
    paper gives no interval for it."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < np.inf:
                raise InputError(f"box.{field.name} is {value}; give a number above 0.")
        if self.rotation_deg > 90.0:
            raise InputError(
                f"box.rotation_deg is {self.rotation_deg}; give at most 90 degrees."
            )

    def widened(self, factor: float) -> "GeneBox":
        """The box with every half-width but the principal point's times ``factor``.

        The principal point stays: it is a property of the lens, not of how well the
        start was aligned.
        """
        return dataclasses.replace(
            self,
            focal=self.focal * factor,
            rotation_deg=min(90.0, self.rotation_deg * factor),
            translation=self.translation * factor,
            scale=self.scale * factor,
            shift=self.shift * factor,
        )

    def cropped(self) -> "GeneBox":
        """The box of a photo that was cropped; see ``bounds.CROPPED_PRINCIPAL``."""
        return dataclasses.replace(
            self,
            focal=CROPPED_REST * self.focal,
            principal_point=CROPPED_PRINCIPAL * self.principal_point,
            rotation_deg=min(90.0, CROPPED_ROTATION * self.rotation_deg),
            translation=CROPPED_REST * self.translation,
            scale=CROPPED_REST * self.scale,
            shift=CROPPED_REST * self.shift,
        )


@dataclasses.dataclass(frozen=True)
class BoxReach:
    """How far a search may move the object in the photos.

    Distances are means over the surface that a camera sees, and over the cameras, in
    pixels of the photos: the paper's equation 5 against the start.
    """

    typical_px: float
    """Median over cameras drawn evenly from the box: the box suits starts that are off
    by less than this."""
    farthest_px: float
    """One draw in twenty goes further than this: a start so far off is hardly within."""
    by_gene: tuple[tuple[str, float], ...]
    """What each gene does by itself at the end of its interval: its name, pixels."""
