"""Where rays meet a surface, exactly."""

import dataclasses

import numba as nb
import numpy as np
from jaxtyping import Float, Int

from photoreg.geometry.mesh import Mesh


@dataclasses.dataclass(frozen=True, eq=False)
class Hits:
    """Where rays met a surface."""

    points: Float[np.ndarray, "n 3"]
    """Positions in world axes."""
    normals: Float[np.ndarray, "n 3"]
    """Unit normals, interpolated from the vertices."""
    directions: Float[np.ndarray, "n 3"]
    """Unit directions of the rays, away from the camera."""
    face: Int[np.ndarray, "n"]
    """Faces met."""
    weights: Float[np.ndarray, "n 3"]
    """Barycentric weights of the faces' corners."""


def surface_hits(
    mesh: Mesh,
    origin: Float[np.ndarray, "3"],
    directions: Float[np.ndarray, "n 3"],
) -> tuple[np.ndarray, Hits]:
    """The rays that meet ``mesh``, (n,) bool, and where these meet it.

    Embree tells the face in float32; the point is computed anew in float64 on the
    face's plane, so textures are read exactly on the surface.
    """
    face, _ = mesh.first_hits(np.broadcast_to(origin, directions.shape), directions)
    met = face >= 0
    face, rays = face[met], directions[met]
    points, normals, weights = _locate(
        origin, rays, face, mesh.faces, mesh.vertices, mesh.vertex_normals
    )
    return met, Hits(points, normals, rays, face, weights)


@nb.njit(nogil=True, cache=True)
def _locate(origin, rays, face, faces, vertices, vertex_normals):  # noqa: ANN001, ANN202
    """Points, unit normals and barycentric weights where rays meet their faces.

    Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    n = len(face)
    points = np.zeros((n, 3))
    normals = np.zeros((n, 3))
    weights = np.zeros((n, 3))
    for i in range(n):
        corners = faces[face[i]]
        a, b, c = vertices[corners[0]], vertices[corners[1]], vertices[corners[2]]
        ray = rays[i]
        e1x, e1y, e1z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        e2x, e2y, e2z = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        sx, sy, sz = origin[0] - a[0], origin[1] - a[1], origin[2] - a[2]
        px = ray[1] * e2z - ray[2] * e2y
        py = ray[2] * e2x - ray[0] * e2z
        pz = ray[0] * e2y - ray[1] * e2x
        determinant = e1x * px + e1y * py + e1z * pz
        u, v = 0.0, 0.0
        if determinant != 0.0:  # Edge on: the first corner stands for the face.
            u = (sx * px + sy * py + sz * pz) / determinant
            qx = sy * e1z - sz * e1y
            qy = sz * e1x - sx * e1z
            qz = sx * e1y - sy * e1x
            v = (ray[0] * qx + ray[1] * qy + ray[2] * qz) / determinant
        # Within float32 of an edge the exact ray may miss the face by a hair.
        u = min(max(u, 0.0), 1.0)
        v = min(max(v, 0.0), 1.0 - u)
        points[i, 0] = a[0] + u * e1x + v * e2x
        points[i, 1] = a[1] + u * e1y + v * e2y
        points[i, 2] = a[2] + u * e1z + v * e2z
        w = 1.0 - u - v
        weights[i, 0], weights[i, 1], weights[i, 2] = w, u, v
        na = vertex_normals[corners[0]]
        nb_, nc = vertex_normals[corners[1]], vertex_normals[corners[2]]
        nx = w * na[0] + u * nb_[0] + v * nc[0]
        ny = w * na[1] + u * nb_[1] + v * nc[1]
        nz = w * na[2] + u * nb_[2] + v * nc[2]
        length = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
        normals[i, 0], normals[i, 1], normals[i, 2] = (
            nx / length,
            ny / length,
            nz / length,
        )
    return points, normals, weights
