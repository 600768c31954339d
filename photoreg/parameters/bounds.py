"""How far a camera may go from where it starts: the paper's intervals, and the utmost.

The gene intervals and the polish's prior are the paper's intervals or multiples of them;
the bounds of the polish are where a camera stops being one of the same photo.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import MAX_FOCAL_PX, Camera

MAX_TURN_RAD = 0.5 * np.pi
MAX_SHIFT_SHARE = 0.75
MAX_FOCAL_FACTOR = 4.0
MAX_PRINCIPAL_SHARE = 0.5
"""How far the numbers may take a camera from its base: the turn about each axis, the
shift along each as a share of the distance, the focal length up or down, the principal
point as a share of the photo's size. It can still be a camera of the same photo there;
beyond, the object is behind it, or numbers overflow."""


@dataclasses.dataclass(frozen=True)
class PriorScales:
    """One standard deviation of the prior around the pre-registration.

    The defaults are the paper's gene intervals (section 4), one sigma each; those of
    ``genes.GeneBox`` are these.
    """

    rotation_deg: float = 1.0
    """Rotation about each camera axis, in degrees."""
    translation: float = 0.03
    """Shift along each camera axis, as a share of the camera's distance."""
    focal: float = 0.02
    """Focal length, as a share of itself."""
    principal_point: float = 0.005
    """Principal point, as a share of the photo's width and height."""


def farthest_from(base: Camera, distance: float) -> Float[np.ndarray, "9"]:
    """How far the polish may take a camera from ``base``, in the order of the increments.

    Args:
        base: The camera at the start.
        distance: From its centre to the pivot of its rotation, in model units.

    Returns:
        The turn about each axis in radians, the shift along each in model units, the
        logarithm of the focal length's factor, and the principal point's way in pixels.
    """
    # No base comes near to it but one that is absurd already.
    focal = min(MAX_FOCAL_FACTOR, MAX_FOCAL_PX / float(np.abs(base.K[:2, :2]).max()))
    return np.array(
        [MAX_TURN_RAD] * 3
        + [MAX_SHIFT_SHARE * distance] * 3
        + [np.log(focal)]
        + [MAX_PRINCIPAL_SHARE * base.width, MAX_PRINCIPAL_SHARE * base.height]
    )
