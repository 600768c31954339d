"""In which ways a surface can move along itself: round ones turn, drawn-out ones slide."""

import numpy as np
from jaxtyping import Float

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface

N_SAMPLES = 2_000
STILL = 0.02
"""Most speed along the normals, root mean square and as a share of that along the surface,
of a motion that leaves the shape as it is. A turn of a degree moves an object of 300 px
by 0.1 px then."""


def slippable_motions(mesh: Mesh) -> Float[np.ndarray, "k 6"]:
    """Small motions that leave the surface's shape nearly as it is, one row each.

    A row is a turn about the three axes through the centroid, and a shift in units of the
    surface's root mean square distance from there; its length is 1.

    References:
        N. Gelfand and L. Guibas, "Shape segmentation using local slippage analysis",
        SGP 2004, doi:10.1145/1057432.1057461.
    """
    samples = sample_surface(mesh, N_SAMPLES, 0)
    arms = samples.points - samples.points.mean(axis=0)
    arms /= np.sqrt((arms**2).sum(axis=1).mean())
    speeds = np.hstack([np.cross(arms, samples.normals), samples.normals])
    values, motions = np.linalg.eigh(speeds.T @ speeds / len(speeds))
    return motions.T[np.sqrt(np.maximum(values, 0.0)) < STILL]


def slippage_words(mesh: Mesh) -> tuple[str, ...]:
    """What the shape alone can tell of no camera, in sentences; empty for most."""
    motions = slippable_motions(mesh)
    if len(motions) == 0:
        return ()
    if (np.linalg.norm(motions[:, :3], axis=1) < 0.1).all():
        return (
            "The surface can slide along itself and looks the same, so one photo does not "
            "tell where along it the camera stands: that is as the start had it.",
        )
    about = "its axis" if len(motions) == 1 else "more than one axis"
    return (
        f"The surface is round: turned about {about} it looks the same, so one photo does "
        "not tell that turn: it is as the start had it.",
    )
