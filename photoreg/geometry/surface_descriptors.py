"""What the shape of a mesh says of how its surface looks: normals, occlusion, curvature.

Shading follows the normal, crevices are dark because they see little of the sky, and ridges
are worn or dusty where hollows are not. So a photo can be compared with the surface alone.
"""

import dataclasses
import functools
import weakref

import cv2
import numpy as np
import scipy.sparse
from jaxtyping import Float, Float32
from scipy.spatial import KDTree

from photoreg.geometry.mesh import Mesh, unit_rows

MAX_FACES = 200_000
"""Finer meshes are reduced first: a photo of 768 px shows no smaller faces."""
FINE, COARSE = 0.003, 0.01
"""How far normals are evened out, as shares of the mesh's diagonal."""
N_RAYS = 32
N_OCCLUSION = 10_000
"""Vertices from which rays are cast; the others take theirs from the nearest ones."""
NEAREST = 4
NORMAL_WEIGHT = 0.1
"""Distance between opposite normals, in diagonals, where nearest vertices are sought: the
other side of a thin wall is not near."""
LEAST_TEXTURE = 64
"""A texture is reduced to no fewer texels a side than this."""
RAY_START = 1e-3
"""How far above the surface rays start, in diagonals."""


@dataclasses.dataclass(frozen=True, eq=False)
class SurfaceDescriptors:
    """Numbers at the vertices of a mesh that say how its shape may look."""

    mesh: Mesh
    """The mesh described, reduced to ``MAX_FACES`` where it was finer."""
    normals: Float[np.ndarray, "n 3"]
    """Unit normals, evened out over ``FINE`` of the diagonal."""
    coarse_normals: Float[np.ndarray, "n 3"]
    """Unit normals, evened out over ``COARSE``."""
    occlusion: Float[np.ndarray, "n"]
    """Share of the sky that the mesh hides, by the cosine, in [0, 1]."""
    curvature: Float[np.ndarray, "n"]
    """Height over the surface evened out over ``COARSE``, in units of its own spread:
    above 0 on ridges, below 0 in hollows."""
    colours: Float[np.ndarray, "n 3"] | None
    """Colours of the mesh's own at its vertices, 0 to 255; None where it has none."""

    @functools.cached_property
    def textures(self) -> tuple[Float32[np.ndarray, "h w 3"], ...]:
        """The mesh's own texture, and reduced by half again and again; empty: none."""
        if self.mesh.own_texture is None:
            return ()
        pyramid = [self.mesh.own_texture.astype(np.float32)]
        while min(pyramid[-1].shape[:2]) > LEAST_TEXTURE:
            height, width = pyramid[-1].shape[:2]
            half = (width // 2, height // 2)
            reduced = cv2.resize(pyramid[-1], half, interpolation=cv2.INTER_AREA)
            pyramid.append(np.asarray(reduced, dtype=np.float32))
        return tuple(pyramid)


_known: weakref.WeakKeyDictionary[Mesh, SurfaceDescriptors] = (
    weakref.WeakKeyDictionary()
)


def surface_descriptors(mesh: Mesh) -> SurfaceDescriptors:
    """The descriptors of ``mesh``, made once; up to a second for 200,000 faces."""
    if mesh not in _known:
        _known[mesh] = _described(mesh)
    return _known[mesh]


def _described(full: Mesh) -> SurfaceDescriptors:
    mesh = full.decimated(MAX_FACES)
    first, index = np.unique(mesh.position_index, return_inverse=True)
    points, normals = mesh.vertices[first], mesh.vertex_normals[first]
    step, edge = _diffusion(index[mesh.faces], points)
    fine, coarse = FINE * mesh.diagonal, COARSE * mesh.diagonal
    smooth = _spread_out(step, edge, normals, fine)
    smoother = _spread_out(step, edge, smooth, np.sqrt(coarse**2 - fine**2))
    height = points - _spread_out(step, edge, points, coarse)
    curvature = np.einsum("nd,nd->n", height, unit_rows(smoother))
    curvature -= np.median(curvature)
    spread = 1.4826 * float(np.median(np.abs(curvature)))
    curvature = np.tanh(0.5 * curvature / max(spread, 1e-9 * mesh.diagonal))
    occlusion = _occlusion(mesh, points, normals)
    return SurfaceDescriptors(
        mesh,
        unit_rows(smooth)[index],
        unit_rows(smoother)[index],
        occlusion[index],
        curvature[index],
        _own_colours(full, mesh),
    )


def _diffusion(
    faces: np.ndarray, points: np.ndarray
) -> tuple[scipy.sparse.csr_array, float]:
    """One step of diffusion over the edges, and the root mean square of their lengths."""
    n = len(points)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    rows = np.concatenate([ends[:, 0], ends[:, 1]])
    columns = np.concatenate([ends[:, 1], ends[:, 0]])
    joined = scipy.sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    degree = np.maximum(joined.sum(axis=1), 1.0)
    average = scipy.sparse.diags_array(1.0 / degree) @ joined
    lengths = points[ends[:, 0]] - points[ends[:, 1]]
    step = scipy.sparse.csr_array(0.5 * (scipy.sparse.eye_array(n) + average))
    return step, float(np.sqrt((lengths**2).sum(axis=1).mean()))


def _spread_out(
    step: scipy.sparse.csr_array, edge: float, values: np.ndarray, sigma: float
) -> np.ndarray:
    """Values evened out over about ``sigma``, a standard deviation along the surface.

    Half a step along edges of length e has the variance e^2 / 4 along each axis.
    """
    for _ in range(round(4.0 * (sigma / edge) ** 2)):
        values = step @ values
    return values


def _occlusion(mesh: Mesh, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(0)
    n = len(points)
    some = np.sort(rng.permutation(n)[:N_OCCLUSION])
    origins = points[some] + RAY_START * mesh.diagonal * normals[some]
    # Cosine-weighted directions: evenly over the disc, raised to the sphere; a golden
    # angle apart, and turned at random about each normal.
    radius = np.sqrt((np.arange(N_RAYS) + 0.5) / N_RAYS)
    angle = np.arange(N_RAYS) * np.pi * (3.0 - np.sqrt(5.0))
    turned = angle + rng.uniform(0.0, 2.0 * np.pi, (len(some), 1))
    up = normals[some]
    least = np.eye(3)[np.argmin(np.abs(up), axis=1)]
    across = unit_rows(np.cross(up, least))
    along = np.cross(up, across)
    directions = (
        (radius * np.cos(turned))[..., None] * across[:, None]
        + (radius * np.sin(turned))[..., None] * along[:, None]
        + np.sqrt(1.0 - radius**2)[:, None] * up[:, None]
    )
    face, _ = mesh.first_hits(
        np.repeat(origins, N_RAYS, axis=0), directions.reshape(-1, 3)
    )
    hidden = (face >= 0).reshape(len(some), N_RAYS).mean(axis=1)
    if len(some) == n:
        return hidden
    weight = 0.5 * NORMAL_WEIGHT * mesh.diagonal
    places = np.hstack([points, weight * normals])
    k = min(NEAREST, len(some))
    distance, nearest = KDTree(places[some]).query(places, k=k)
    closeness = 1.0 / (distance.reshape(n, k) + 1e-9 * mesh.diagonal)
    found = hidden[nearest.reshape(n, k)]
    return (closeness * found).sum(axis=1) / closeness.sum(axis=1)


def _own_colours(full: Mesh, mesh: Mesh) -> np.ndarray | None:
    """Colours at the vertices of ``mesh``, which may be ``full`` reduced."""
    colours = vertex_colours(full)
    if colours is None or mesh is full:
        return colours
    _, nearest = KDTree(full.vertices).query(mesh.vertices)
    return colours[nearest]


def vertex_colours(mesh: Mesh) -> Float[np.ndarray, "n 3"] | None:
    """The mesh's own colours at its vertices, of its texture where it has one."""
    if mesh.vertex_colours is not None:
        return mesh.vertex_colours.astype(np.float64)
    if mesh.own_texture is None or mesh.corner_uv is None:
        return None
    # A vertex stands for what is nearer to it than to others: the texture is reduced to
    # about four pixels a vertex.
    texture = mesh.own_texture
    side = int(np.ceil(2.0 * np.sqrt(len(mesh.vertices))))
    height, width = min(side, texture.shape[0]), min(side, texture.shape[1])
    small = cv2.resize(texture, (width, height), interpolation=cv2.INTER_AREA)
    uv = mesh.corner_uv.reshape(-1, 2) % 1.0
    columns = np.clip(uv[:, 0] * width, 0, width - 1).astype(np.int64)
    rows = np.clip((1.0 - uv[:, 1]) * height, 0, height - 1).astype(np.int64)
    corner = small[rows, columns].astype(np.float64)
    place = mesh.position_index[mesh.faces].ravel()
    n = len(mesh.vertices)
    count = np.maximum(np.bincount(place, minlength=n), 1)
    sums = [np.bincount(place, corner[:, k], n) / count for k in range(3)]
    return np.column_stack(sums)[mesh.position_index]
