"""Rotations: vectors, matrices, and how one changes with the other."""

import numpy as np
from jaxtyping import Float


def rotation_matrices(vectors: Float[np.ndarray, "*batch 3"]) -> np.ndarray:
    """Rotation matrices (*batch, 3, 3) of rotation vectors in radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    W = np.stack(
        [
            np.stack([zero, -z, y], axis=-1),
            np.stack([z, zero, -x], axis=-1),
            np.stack([-y, x, zero], axis=-1),
        ],
        axis=-2,
    )
    # np.sinc is sin(pi x) / (pi x), and exact at 0.
    sine = np.sinc(angle / np.pi)
    half = np.sinc(angle / (2.0 * np.pi))
    return np.eye(3) + sine * W + 0.5 * half * half * (W @ W)


def rotation_vectors(R: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Rotation vectors in radians; for angles below half a turn."""
    axis = 0.5 * np.stack(
        [
            R[:, 2, 1] - R[:, 1, 2],
            R[:, 0, 2] - R[:, 2, 0],
            R[:, 1, 0] - R[:, 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    return axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)[:, None]


def rotation_matrix(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    V = _cross(vector)
    if angle < 1e-8:
        return np.eye(3) + V
    return (
        np.eye(3)
        + np.sin(angle) / angle * V
        + (1.0 - np.cos(angle)) / angle**2 * (V @ V)
    )


def rotation_vector(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """The rotation vector of a rotation matrix of less than half a turn."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = float(np.linalg.norm(axis)), 0.5 * (float(np.trace(R)) - 1.0)
    if sine < 1e-12:
        return axis
    return axis * (np.arctan2(sine, cosine) / sine)


def left_jacobian(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """J with exp(v + dv) = exp(J dv) exp(v), to first order in dv.

    References:
        T. Barfoot, "State Estimation for Robotics", equation 7.77.
    """
    angle = float(np.linalg.norm(vector))
    V = _cross(vector)
    if angle < 1e-6:
        return np.eye(3) + 0.5 * V
    return (
        np.eye(3)
        + (1.0 - np.cos(angle)) / angle**2 * V
        + (angle - np.sin(angle)) / angle**3 * (V @ V)
    )


def _cross(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
