"""A bumpy closed body without symmetry, in solid colours: the plain test object."""

import numpy as np
from jaxtyping import Float, Int

from photoreg.geometry.mesh import Mesh
from photoreg.synthetic.noise import SolidNoise

MEAN_COLOUR = np.array([0.36, 0.30, 0.25])
"""Mean albedo, linear RGB: a warm grey."""
GREY = np.array([0.78, 0.78, 0.78])
WARMTH = np.array([0.22, 0.0, -0.28])
TINT = np.array([-0.06, 0.06, -0.02])
"""How each channel of the noise changes the colour, as fractions of the mean: light
and dark first, then ochre and slate, then a trace of green."""
CENTER = np.array([0.31, -0.22, 0.17])
"""Where the rock is: not at the origin, as scans are not."""


def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vertices and outward faces, 20 * 4**subdivisions of them."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    corners = [
        (-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0),
        (0, -1, golden), (0, 1, golden), (0, -1, -golden), (0, 1, -golden),
        (golden, 0, -1), (golden, 0, 1), (-golden, 0, -1), (-golden, 0, 1),
    ]  # fmt: skip
    vertices: Float[np.ndarray, "n 3"] = np.array(corners, dtype=np.float64)
    faces: Int[np.ndarray, "m 3"] = np.array([
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11),
        (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
        (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9),
        (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
    ])  # fmt: skip
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = index.reshape(-1, 3) + len(vertices)
        vertices = np.vstack([vertices, vertices[unique].sum(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.vstack(
            [
                np.column_stack(corner)
                for corner in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
            ]
        )
        vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def rock_mesh(seed: int, subdivisions: int = 5) -> Mesh:
    """A bumpy closed body of 20 * 4**subdivisions faces (20,480), about 2.5 long."""
    directions, faces = icosphere(subdivisions)
    noise = SolidNoise(seed)
    bumps = noise(directions, 1.1, octaves=3, gain=0.45)[:, 0].astype(np.float64)
    radii = 1.0 + 0.16 * np.clip(bumps, -2.2, 2.2)
    vertices = directions * radii[:, None] * np.array([1.15, 0.85, 0.8]) + CENTER
    return Mesh(vertices, faces, name="rock.ply")


def rock_albedo(
    points: Float[np.ndarray, "n 3"], noise: SolidNoise, contrast: float = 1.0
) -> Float[np.ndarray, "n 3"]:
    """Linear RGB (n, 3) of the rock's solid texture: clouds and grain at seven scales.

    ``contrast`` scales the differences from the mean colour.
    """
    clouds = noise(points, 1.7, octaves=7, gain=0.8)
    spread = clouds[:, :1] * GREY + clouds[:, 1:2] * WARMTH + clouds[:, 2:] * TINT
    colours = MEAN_COLOUR * (1.0 + np.float32(contrast) * spread)
    return np.clip(colours, 0.01, 0.98)
