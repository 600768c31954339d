"""What is wrong with scans as they come: bumps, rounded corners, fat edges, holes."""

import dataclasses

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float

from photoreg.geometry.mesh import Mesh
from photoreg.synthetic.options import SceneSettings

N_WAVES = 500
"""Waves that a field of bumps is the sum of."""
HOLES = 12
"""Holes that share the missing surface."""
EDGE_LENGTH = 0.02
"""What bends within this share of the diagonal is an edge."""


def scanned(mesh: Mesh, settings: SceneSettings, seed: int) -> Mesh:
    """The mesh that a scanner makes of a surface, with the errors of ``settings``."""
    rng = np.random.default_rng([seed, 0x3E54])
    diagonal = mesh.diagonal
    if settings.mesh_smoothing > 0.0:
        mesh = _moved(mesh, _smooth(mesh, settings.mesh_smoothing * diagonal))
    if settings.mesh_fat_edges > 0.0:
        outward = settings.mesh_fat_edges * diagonal * _convexity(mesh)
        mesh = _moved(mesh, mesh.vertices + outward[:, None] * mesh.vertex_normals)
    if settings.mesh_noise > 0.0:
        errors = settings.mesh_noise * diagonal * _bumps(mesh, settings, rng)
        mesh = _moved(mesh, mesh.vertices + errors[:, None] * mesh.vertex_normals)
    if settings.mesh_holes > 0.0:
        mesh = _with_holes(mesh, settings.mesh_holes, rng)
    return mesh


def _moved(mesh: Mesh, vertices: Float[np.ndarray, "n 3"]) -> Mesh:
    return dataclasses.replace(mesh, vertices=vertices.astype(np.float32))


def _bumps(
    mesh: Mesh, settings: SceneSettings, rng: np.random.Generator
) -> Float[np.ndarray, "n"]:
    """A random number of unit variance for each vertex, alike within a length.

    Its correlation over a distance d is exp(-d^2 / 2 l^2), by random Fourier features
    (Rahimi and Recht, "Random features for large-scale kernel machines", 2007).
    """
    n = len(mesh.vertices)
    if settings.mesh_noise_length == 0.0:
        return rng.standard_normal(n)
    length = settings.mesh_noise_length * mesh.diagonal
    waves = rng.standard_normal((3, N_WAVES)) / length
    phases = rng.uniform(0.0, 2.0 * np.pi, N_WAVES)
    return np.sqrt(2.0 / N_WAVES) * np.cos(mesh.vertices @ waves + phases).sum(axis=1)


def _smooth(mesh: Mesh, length: float) -> Float[np.ndarray, "n 3"]:
    """Vertices after heat has spread by about ``length``: one implicit step."""
    a, b = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    n = len(mesh.vertices)
    joined = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), (n, n)).tocsr()
    joined = ((joined + joined.T) > 0).astype(np.float64)
    counts = np.maximum(np.asarray(joined.sum(axis=1)).ravel(), 1.0)
    edge = np.linalg.norm(mesh.vertices[a] - mesh.vertices[b], axis=1).mean()
    laplacian = scipy.sparse.eye(n) - scipy.sparse.diags(1.0 / counts) @ joined
    heat = scipy.sparse.eye(n) + 0.5 * (length / edge) ** 2 * laplacian
    return scipy.sparse.linalg.splu(heat.tocsc()).solve(mesh.vertices)


def _convexity(mesh: Mesh) -> Float[np.ndarray, "n"]:
    """0 where the surface is flat or hollow, 1 at its sharpest edges."""
    above = mesh.vertices - _smooth(mesh, EDGE_LENGTH * mesh.diagonal)
    out = np.einsum("nd,nd->n", above, mesh.vertex_normals)
    return np.clip(out / max(float(np.quantile(out, 0.95)), 1e-12), 0.0, 1.0)


def _with_holes(mesh: Mesh, share: float, rng: np.random.Generator) -> Mesh:
    """Without the faces nearest to some places, until ``share`` of the area is gone."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    places = centres[rng.choice(len(centres), HOLES, replace=False)]
    apart = np.linalg.norm(centres[:, None] - places, axis=2).min(axis=1)
    order = np.argsort(apart)
    gone = np.cumsum(mesh.face_areas[order]) <= share * mesh.area
    kept = np.sort(order[~gone])
    return dataclasses.replace(mesh, faces=mesh.faces[kept])
