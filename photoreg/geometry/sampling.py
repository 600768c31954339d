"""Points of a surface, spread evenly over its area."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from photoreg.errors import InputError
from photoreg.geometry.mesh import Mesh


@dataclasses.dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points on a mesh with their normals."""

    points: Float[np.ndarray, "n 3"]
    """Positions in world axes, model units."""
    normals: Float[np.ndarray, "n 3"]
    """Unit outward normals, interpolated from the vertices."""
    face_index: Int[np.ndarray, "n"]
    """The face each point lies on."""

    def __len__(self) -> int:
        return len(self.points)

    def subset(self, keep: np.ndarray) -> "SurfaceSamples":
        """The samples that ``keep`` (a boolean mask or indices) selects."""
        return SurfaceSamples(
            self.points[keep], self.normals[keep], self.face_index[keep]
        )


def sample_surface(mesh: Mesh, n_samples: int, seed: int) -> SurfaceSamples:
    """Draws points from a mesh, each part of the surface by its area.

    Stratified: the k-th point falls into the k-th of ``n_samples`` equal shares of
    the area in the order of the faces, so the density is even where independent
    draws would leave holes and clusters.

    Args:
        mesh: The surface.
        n_samples: How many points, at least 1.
        seed: Same seed, same points.

    Raises:
        InputError: if fewer than one point is asked for.
    """
    if n_samples < 1:
        raise InputError(
            f"The number of surface samples is {n_samples}; give at least 1."
        )
    rng = np.random.default_rng(seed)
    cumulative = np.cumsum(mesh.face_areas)
    shares = (np.arange(n_samples) + rng.random(n_samples)) / n_samples
    face_index = np.searchsorted(cumulative, shares * cumulative[-1], side="right")
    # Rounding may point past the end; the last face with area is meant then.
    last = int(np.flatnonzero(mesh.face_areas)[-1])
    face_index = np.minimum(face_index, last).astype(np.int32)
    # Turk: uniform in a triangle by the square root of the first number.
    root, second = np.sqrt(rng.random(n_samples)), rng.random(n_samples)
    weights = np.column_stack([1.0 - root, root * (1.0 - second), root * second])
    corners = mesh.faces[face_index]
    points = np.einsum("nc,ncd->nd", weights, mesh.vertices[corners])
    normals = np.einsum("nc,ncd->nd", weights, mesh.vertex_normals[corners])
    lengths = np.linalg.norm(normals, axis=1)
    # Opposite vertex normals can cancel on a sheet; the face's own normal is then right.
    flat = lengths < 1e-6
    normals[flat] = mesh.face_normals[face_index[flat]]
    normals[~flat] /= lengths[~flat, None]
    return SurfaceSamples(points, normals, face_index)


def surface_patches(
    mesh: Mesh,
    samples: SurfaceSamples,
    step: Float[np.ndarray, "n"],
    side: int,
) -> Float[np.ndarray, "n q 3"]:
    """A small grid of surface points around each sample, q = side * side.

    The grid lies in the tangent plane and is carried onto the surface along the
    normal; where there is no surface within two steps it stays in the plane.

    Args:
        mesh: The surface.
        samples: Middles of the patches, on ``mesh``.
        step: Distance between neighbours of each grid, in model units.
        side: Points along a side, odd, at least 3.

    Raises:
        InputError: if ``side`` is even or below 3.
    """
    if side < 3 or side % 2 == 0:
        raise InputError(f"A patch has {side} points a side; give an odd number >= 3.")
    normals = samples.normals
    # Any axis that is not along the normal starts the tangent frame.
    least = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    right = np.cross(normals, least)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(normals, right)
    ticks = np.arange(side) - side // 2
    across, along = (grid.ravel() for grid in np.meshgrid(ticks, ticks))
    plane = samples.points[:, None] + step[:, None, None] * (
        across[None, :, None] * right[:, None] + along[None, :, None] * up[:, None]
    )
    reach = 2.0 * step[:, None, None]
    origins = plane + reach * normals[:, None]
    downward = np.broadcast_to(-normals[:, None], plane.shape)
    _, distance = mesh.first_hits(origins.reshape(-1, 3), downward.reshape(-1, 3))
    distance = distance.reshape(len(samples), -1, 1)
    found = distance <= 2.0 * reach
    return np.where(found, origins + np.where(found, distance, 0.0) * downward, plane)
