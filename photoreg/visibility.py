"""Which surface points a camera sees: by normals, by rays, by a depth buffer."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool

from photoreg.camera import Camera
from photoreg.mesh import Mesh
from photoreg.sampling import SurfaceSamples

VisibilityMethod = Literal["normals", "rays", "depth"]


def visible(
    samples: SurfaceSamples,
    cameras: Sequence[Camera],
    mesh: Mesh,
    method: VisibilityMethod = "normals",
    min_cosine: float = 0.5,
) -> Bool[np.ndarray, "n_cameras n"]:
    """Whether each camera sees each sample.

    Seen means: in front of the camera, inside its photo, the normal within
    ``acos(min_cosine)`` of the direction to the camera, and, for ``rays`` and
    ``depth``, nothing of the mesh in between.

    Args:
        samples: Points on ``mesh``.
        cameras: The cameras.
        mesh: What may occlude.
        method: ``normals``: the paper's test, blind to occlusion. ``rays``: exact,
            by embree. ``depth``: against a depth buffer of the camera's own view.
        min_cosine: Least cosine between the normal and the direction to the camera.
    """
    rows = []
    for camera in cameras:
        to_camera = camera.center - samples.points
        cosine = np.einsum("nd,nd->n", samples.normals, to_camera)
        facing = cosine >= min_cosine * np.linalg.norm(to_camera, axis=1)
        # NaN, behind the camera, compares as outside.
        seen = facing & camera.contains(camera.project(samples.points))
        if method != "normals" and seen.any():
            free = mesh.is_unoccluded(samples.points[seen], camera.center)
            seen[np.flatnonzero(seen)[~free]] = False
        rows.append(seen)
    return np.array(rows)
