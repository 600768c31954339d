"""How sure a polish is: standard errors, expected pixel error, undetermined directions."""

import dataclasses

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import TERMS, Lens
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.surface_view import camera_rays, surface_view
from photoreg.parameters.camera_parameters import (
    FOCAL,
    LENS_TERMS,
    POSITION,
    PRINCIPAL,
    ROTATION,
    Parameter,
)
from photoreg.parameters.increments import Increments
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

    errors: tuple[float, ...]
    """Of each parameter, in the units shown to users: degrees, percent of the distance and of the
    focal length, pixels; 0 where it was held."""
    parameters: tuple[Parameter, ...]
    """What the errors are of."""
    lens: Lens
    """The lens that the errors of its terms are about."""
    expected_error_px: float
    """Expected distance, root of the mean square over the surface that the photo sees,
    between where the camera puts the surface and where it is, in pixels. Of a single photo
    how far a wrong scan draws it is in it too."""

    def in_words(self, name: str) -> str:
        """The standard errors in one sentence about the photo called ``name``."""
        turn = max(self.errors[ROTATION])
        *across, along = self.errors[POSITION]
        pose = "rotation and position held"
        if max(turn, *across, along) > 0.0:
            pose = (
                f"rotation ±{turn:.2g}°, position ±{max(across):.2g} % of the distance "
                f"across the view and ±{along:.2g} % along it"
            )
        focal, principal = self.errors[FOCAL], max(self.errors[PRINCIPAL])
        focal_words = f"±{focal:.2g} %" if focal > 0.0 else "held"
        principal_words = f"±{principal:.2g} px" if principal > 0.0 else "held"
        return (
            f"{name}: expected error {self.expected_error_px:.2g} px; {pose}, focal "
            f"length {focal_words}, principal point {principal_words}"
            f"{self._lens_words()}."
        )

    def _lens_words(self) -> str:
        errors = self.errors[LENS_TERMS]
        if not errors:
            return ""
        if not max(errors) > 0.0:
            return ", lens held"
        told = ", ".join(
            f"{term} {value:.3f} ± {error:.2g}"
            for term, value, error in zip(TERMS, self.lens.terms, errors, strict=False)
            if error > 0.0
        )
        return f", lens {told}"


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """How sure the cameras of a polish are."""

    cameras: tuple[CameraUncertainty, ...]
    covariance: Float[np.ndarray, "p p"]
    """Of the increments of each camera, in units of the prior."""
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
        own = increments.own(i)
        block = covariance[own, own]
        errors = np.sqrt(np.diag(block)) * increments.plain_units
        cameras.append(
            CameraUncertainty(
                tuple(errors.tolist()),
                increments.parameters,
                camera.lens,
                float(
                    np.hypot(
                        _expected_error_px(
                            mesh, increments, camera, step.x[own], block
                        ),
                        step.bias_px,
                    )
                ),
            )
        )
    return Uncertainty(
        tuple(cameras),
        covariance,
        undetermined_directions(free, step.increments, names, along),
    )


def undetermined_directions(
    covariance: Float[np.ndarray, "q q"],
    increments: tuple[Increments, ...],
    names: tuple[str, ...],
    directions: Float[np.ndarray, "p q"],
) -> tuple[str, ...]:
    """Sentences on the directions that stay open, the weakest first.

    ``covariance`` is that of the independent parameters, the columns of ``directions``. A
    focal length that photos share has the name of the first.
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
            photo, which = divmod(int(rows[index]), increments[0].n)
            size = abs(amounts[index]) * increments[photo].plain_units[which]
            one = increments[photo].parameters[which]
            amount = one.words.format(size)
            parts.append(f"{one.name} of {names[photo]} (±{amount})")
        if len(parts) == 1:
            sentences.append(f"The photos hardly determine the {parts[0]}.")
        else:
            words = f"{listed(parts)} trade off."
            sentences.append(words[0].upper() + words[1:])
    return tuple(sentences)


def _expected_error_px(
    mesh: Mesh,
    increments: Increments,
    camera: Camera,
    x: np.ndarray,
    covariance: np.ndarray,
) -> float:
    small = camera.reduced(_VIEW_SIDE_PX)
    view = surface_view(mesh, small)
    rows, columns = np.nonzero(view.covered)
    if len(rows) == 0:
        return float("nan")
    origins, directions = camera_rays(small, np.column_stack([columns, rows]) * 1.0)
    points = origins + view.depth[rows, columns][:, None] * directions
    _, by_increments = rim_rows(
        increments.record(x, camera.width, camera.height), points, increments.n
    )
    variance = np.einsum("nij,jk,nik->n", by_increments, covariance, by_increments)
    return float(np.sqrt(variance.mean()))
