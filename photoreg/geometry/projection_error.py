"""Projection error against known cameras: the paper's measure, its equation 5."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.unseen import why_unseen
from photoreg.geometry.visibility import samples_for, seen_points

N_SAMPLES = 10_000
"""Surface points over which errors are measured, seen or not."""


@dataclasses.dataclass(frozen=True)
class CameraError:
    """How far one camera puts the surface from where the true camera puts it."""

    mean: float
    """Mean distance over the surface points that the true camera sees, in pixels."""
    rms: float
    """Root of the mean squared distance, in pixels."""
    median: float
    """Median distance, in pixels."""
    max: float
    """Largest distance, in pixels."""
    n_points: int
    """Surface points that the true camera sees."""


@dataclasses.dataclass(frozen=True)
class ProjectionError:
    """The projection error of several cameras (the paper's equation 5)."""

    cameras: tuple[CameraError, ...]
    """One entry a camera, in the order given."""

    @property
    def mean(self) -> float:
        """Mean over the cameras of each camera's mean distance, in pixels."""
        return float(np.mean([camera.mean for camera in self.cameras]))

    @property
    def max(self) -> float:
        """Largest distance of any point in any camera, in pixels."""
        return max(camera.max for camera in self.cameras)


def projection_error(
    mesh: Mesh,
    true: Sequence[Camera],
    estimated: Sequence[Camera],
    n_samples: int = N_SAMPLES,
) -> ProjectionError:
    """Mean distance in pixels between projections by the true and the estimated camera.

    Measured over area-weighted surface points that the true camera sees: in its frame
    and not hidden (by rays). A point behind the estimated camera is infinitely far off.
    The points depend on the mesh and ``n_samples`` only, so results compare.

    Args:
        mesh: the surface, in the cameras' world axes.
        true: the cameras to measure against.
        estimated: one camera for each true camera, for photos of the same size.
        n_samples: points drawn over the whole surface, seen or not.

    References:
        Janko and Chetverikov, 3DPVT 2004, equation 5.

    Raises:
        InputError: if the numbers of cameras or their photo sizes differ, there are
            none, or a true camera sees nothing of the mesh.
    """
    return Truth(mesh, true, n_samples).projection_error(estimated)


class Truth:
    """True cameras, to measure others against again and again: looked through once."""

    def __init__(
        self, mesh: Mesh, cameras: Sequence[Camera], n_samples: int = N_SAMPLES
    ) -> None:
        """The arguments and errors are those of the function ``projection_error``."""
        self.cameras = tuple(cameras)
        points = samples_for(mesh, cameras, n_samples, seed=0).points
        self._points: list[Float[np.ndarray, "n 3"]] = []
        self._pixels: list[Float[np.ndarray, "n 2"]] = []
        for number, camera in enumerate(cameras, 1):
            seen = points[seen_points(mesh, camera, points)]
            if len(seen) == 0:
                raise InputError(
                    f"True camera {number} sees nothing of {mesh.name}. "
                    f"{why_unseen(mesh, [camera])}"
                )
            self._points.append(seen)
            self._pixels.append(camera.project(seen))

    def projection_error(self, estimated: Sequence[Camera]) -> ProjectionError:
        """As the function ``projection_error``, against these cameras."""
        if len(self.cameras) == 0 or len(self.cameras) != len(estimated):
            raise InputError(
                "Cameras are compared one to one, at least one, but there are "
                f"{len(self.cameras)} true and {len(estimated)} estimated cameras."
            )
        return ProjectionError(
            tuple(self._camera_error(i, camera) for i, camera in enumerate(estimated))
        )

    def _camera_error(self, index: int, estimate: Camera) -> CameraError:
        truth = self.cameras[index]
        if (truth.width, truth.height) != (estimate.width, estimate.height):
            raise InputError(
                f"Camera {index + 1}: the true camera is for a photo of {truth.width}x"
                f"{truth.height} px, the estimated one for {estimate.width}x"
                f"{estimate.height} px; they should be for the same photo."
            )
        offsets = estimate.project(self._points[index]) - self._pixels[index]
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        distances[np.isnan(distances)] = np.inf
        return CameraError(
            mean=float(distances.mean()),
            rms=float(np.sqrt(np.mean(distances**2))),
            median=float(np.median(distances)),
            max=float(distances.max()),
            n_points=len(distances),
        )
