"""How far a camera may go from where it starts: the paper's intervals, and the utmost.

The gene intervals and the polish's prior are the paper's intervals or multiples of them;
the bounds of the polish are where a camera stops being one of the same photo.
"""

import dataclasses
import math

MAX_TURN_RAD = 0.5 * math.pi
MAX_SHIFT_SHARE = 0.75
MAX_FOCAL_FACTOR = 4.0
MAX_PRINCIPAL_SHARE = 0.5
"""How far the numbers may take a camera from its base: the turn about each axis, the
shift along each as a share of the distance, the focal length up or down, the principal
point as a share of the photo's size. It can still be a camera of the same photo there;
beyond, the object is behind it, or numbers overflow."""
MAX_LENS_TERM = 1.0
"""How far a term of the lens may go: ten times what phones and action cameras have."""


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

    def cropped(self) -> "PriorScales":
        """Those of a photo that was cropped; see ``CROPPED_PRINCIPAL``."""
        return PriorScales(
            rotation_deg=CROPPED_ROTATION * self.rotation_deg,
            translation=CROPPED_REST * self.translation,
            focal=CROPPED_REST * self.focal,
            principal_point=CROPPED_PRINCIPAL * self.principal_point,
        )


CROPPED_PRINCIPAL, CROPPED_ROTATION, CROPPED_REST = 24.0, 2.0, 1.5
"""How much wider the intervals of principal point, rotation and all else are where a
photo was cropped: its principal point may be a third of the photo off, and the rest was
aligned with a wrong one."""


LENS_SIGMAS = {"k1": 0.1, "k2": 0.1, "p1": 0.001, "p2": 0.001, "k3": 0.05}
"""One standard deviation of the prior of each term of a lens, as phones and cameras
differ from an ideal one (k1 of -0.15 to 0.12, k2 of -0.2 to 0.05, p1 and p2 about
0.001). It is a property of lenses, not of how well a start is aligned."""
