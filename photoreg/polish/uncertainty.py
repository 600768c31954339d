"""How sure a polish is: standard errors, expected pixel error, undetermined directions."""

import dataclasses

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import camera_rays, surface_view
from photoreg.parameters.increments import N_INCREMENTS, NAMES, Increments
from photoreg.polish.kernels import rim_rows
from photoreg.polish.polish_cameras import PolishStep
from photoreg.words import listed

WEAK_SHARE = 0.5
"""A direction is called undetermined when the photos leave at least this share of the
pre-registration's interval."""
MAX_DIRECTIONS = 6
"""At most so many directions are named, the weakest first."""
_VIEW_SIDE_PX = 96


@dataclasses.dataclass(frozen=True)
class CameraUncertainty:
    """Standard errors of one camera, and what they mean in its photo."""

    rotation_deg: tuple[float, float, float]
    """About the photo's x axis, y axis and in its plane, in degrees."""
    position_share: tuple[float, float, float]
    """Sideways, vertical and along the view, as shares of the camera's distance."""
    focal_share: float
    """Focal length, as a share of itself."""
    principal_px: tuple[float, float]
    """Principal point, in pixels."""
    expected_error_px: float
    """Expected distance, root of the mean square over the surface that the photo sees,
    between where the camera puts the surface and where it is, in pixels."""

    def in_words(self, name: str) -> str:
        """The standard errors in one sentence about the photo called ``name``."""
        aside, along = max(self.position_share[:2]), self.position_share[2]
        pose = "rotation and position held"
        if max(*self.rotation_deg, aside, along) > 0.0:
            pose = (
                f"rotation ±{max(self.rotation_deg):.2g}°, position ±{100.0 * aside:.2g} "
                f"% of the distance across the view and ±{100.0 * along:.2g} % along it"
            )
        focal, principal = self.focal_share, max(self.principal_px)
        focal_words = f"±{100.0 * focal:.2g} %" if focal > 0.0 else "held"
        principal_words = f"±{principal:.2g} px" if principal > 0.0 else "held"
        return (
            f"{name}: expected error {self.expected_error_px:.2g} px; {pose}, focal "
            f"length {focal_words}, principal point {principal_words}."
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """How sure the cameras of a polish are."""

    cameras: tuple[CameraUncertainty, ...]
    covariance: Float[np.ndarray, "p p"]
    """Of the nine increments of each camera, in units of the prior."""
    undetermined: tuple[str, ...]
    """Directions that the photos leave open, in plain words; the weakest first."""

    @property
    def expected_error_px(self) -> float:
        """Mean of the expected projection errors of the cameras that moved, in pixels."""
        errors = [camera.expected_error_px for camera in self.cameras]
        return float(np.mean([error for error in errors if error != 0.0]))


def estimate_uncertainty(
    mesh: Mesh, step: PolishStep, names: tuple[str, ...] | None = None
) -> Uncertainty:
    """The uncertainty of the cameras of a polish at the end of one of its levels.

    Inverse normal matrix, times the covariance of the gradient, times inverse normal
    matrix: the errors that neighbours share are in it, and that the polish weighted
    its terms otherwise than would be best. What all terms get wrong in the same way
    (a mesh of another size, say) is not in it.

    Args:
        mesh: The surface.
        step: The last step of a level of ``polish_cameras``.
        names: How the photos are called in the words; None: photo 1, photo 2, ...
    """
    along = step.directions
    if step.scatter is None:
        raise ValueError("Only the last step of a polish's level tells how sure it is.")
    inverse = np.linalg.inv(along.T @ step.normal @ along)
    free = inverse @ (along.T @ step.scatter @ along) @ inverse
    covariance = along @ free @ along.T
    names = names or tuple(f"photo {i + 1}" for i in range(len(step.cameras)))
    cameras = []
    for i, (increments, camera) in enumerate(
        zip(step.increments, step.cameras, strict=True)
    ):
        own = slice(i * N_INCREMENTS, (i + 1) * N_INCREMENTS)
        block = covariance[own, own]
        errors = np.sqrt(np.diag(block)) * plain_units(increments)
        cameras.append(
            CameraUncertainty(
                (float(errors[0]), float(errors[1]), float(errors[2])),
                (float(errors[3]), float(errors[4]), float(errors[5])),
                float(errors[6]),
                (float(errors[7]), float(errors[8])),
                _expected_error_px(mesh, increments, camera, step.x[own], block),
            )
        )
    return Uncertainty(
        tuple(cameras),
        covariance,
        undetermined_directions(free, step.increments, names, along),
    )


def plain_units(increments: Increments) -> Float[np.ndarray, "9"]:
    """One unit of each increment: degrees, shares of the distance, a share, pixels."""
    scales = increments.scales
    return np.array(
        [scales.rotation_deg] * 3
        + [scales.translation] * 3
        + [scales.focal]
        + list(increments.units[7:9])
    )


def undetermined_directions(
    covariance: Float[np.ndarray, "q q"],
    increments: tuple[Increments, ...],
    names: tuple[str, ...],
    directions: Float[np.ndarray, "p q"],
) -> tuple[str, ...]:
    """Sentences on the directions that stay open, the weakest first.

    ``covariance`` is that of what moved by itself, the columns of ``directions``. A
    focal length that photos share goes by the first one's name.
    """
    rows = directions.argmax(axis=0)
    values, vectors = np.linalg.eigh(covariance)
    sentences = []
    for k in np.argsort(-values)[:MAX_DIRECTIONS]:
        if not values[k] >= WEAK_SHARE**2:
            break
        amounts = np.sqrt(values[k]) * vectors[:, k]
        main = np.argsort(-np.abs(amounts))
        main = main[np.abs(amounts[main]) >= 0.5 * np.abs(amounts[main[0]])][:4]
        parts = []
        for index in main:
            photo, which = divmod(int(rows[index]), N_INCREMENTS)
            size = abs(amounts[index]) * plain_units(increments[photo])[which]
            parts.append(f"{NAMES[which]} of {names[photo]} (±{_amount(which, size)})")
        if len(parts) == 1:
            sentences.append(f"The photos hardly determine the {parts[0]}.")
        else:
            words = f"{listed(parts)} trade off."
            sentences.append(words[0].upper() + words[1:])
    return tuple(sentences)


def _amount(which: int, size: float) -> str:
    if which < 3:
        return f"{size:.2g}°"
    if which < 7:
        return f"{100.0 * size:.2g} %"
    return f"{size:.2g} px"


def _expected_error_px(
    mesh: Mesh,
    increments: Increments,
    camera: Camera,
    x: np.ndarray,
    covariance: np.ndarray,
) -> float:
    scale = min(1.0, _VIEW_SIDE_PX / max(camera.width, camera.height))
    small = camera.resized(
        max(2, round(camera.width * scale)), max(2, round(camera.height * scale))
    )
    view = surface_view(mesh, small)
    rows, columns = np.nonzero(view.covered)
    if len(rows) == 0:
        return float("nan")
    origins, directions = camera_rays(small, np.column_stack([columns, rows]) * 1.0)
    points = origins + view.depth[rows, columns][:, None] * directions
    _, by_increments = rim_rows(
        increments.geometry(x, camera.width, camera.height), points
    )
    variance = np.einsum("nij,jk,nik->n", by_increments, covariance, by_increments)
    return float(np.sqrt(variance.mean()))
