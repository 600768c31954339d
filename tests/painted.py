"""A world with truth: a surface whose colour is a smooth function of position."""

import numpy as np
import trimesh

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo

BACKDROP = np.array([255, 0, 255], dtype=np.uint8)
"""Far from every colour of the surface: one bleeding pixel shows."""


def paint(points: np.ndarray) -> np.ndarray:
    """Colours (n, 3) in 0 ... 255 of surface points (n, 3); always green > 110."""
    x, y, z = np.moveaxis(np.asarray(points), -1, 0)
    red = 110 + 60 * np.sin(5.0 * x + 2.0 * y) + 30 * np.sin(9.0 * z)
    green = 180 + 60 * np.sin(4.0 * y - 3.0 * z + 1.0)
    blue = 90 + 50 * np.sin(6.0 * z + 3.0 * x) + 20 * np.cos(8.0 * y)
    return np.stack([red, green, blue], axis=-1)


def ball_and_moon(subdivisions: int = 4) -> Mesh:
    """A bumpy ball with a small ball in front of it that hides part of it."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y = ball.vertices[:, :1], ball.vertices[:, 1:2]
    big = ball.vertices * (1.0 + 0.1 * np.sin(6.0 * x) * np.cos(5.0 * y))
    small = ball.vertices * 0.25 + np.array([1.6, 0.2, 0.1])
    vertices = np.vstack([big, small])
    return Mesh(vertices, np.vstack([ball.faces, ball.faces + len(big)]))


def cameras_around(n: int = 2, width: int = 480, height: int = 360) -> list[Camera]:
    """Cameras 30 degrees apart, each with another focal length and principal point."""
    cameras = []
    for i in range(n):
        angle = np.deg2rad(30.0 * i - 10.0)
        center = np.array([4.5 * np.cos(angle), 4.5 * np.sin(angle), 0.8 - 0.3 * i])
        camera = Camera.look_at(
            center, [0.1, 0, 0], [0.1, 0, 1], (1.4 + 0.1 * i) * width, width, height
        )
        K = camera.K + np.array([[0, 0, 5.0 + i], [0, 0, -7.0 - 2 * i], [0, 0, 0]])
        cameras.append(Camera(K, camera.R_cam_world, camera.t_cam_world, width, height))
    return cameras


def photograph(
    mesh: Mesh, camera: Camera, name: str = "photo.png", gain: float = 1.0
) -> Photo:
    """The painted surface before the backdrop, each pixel at its centre."""
    buffer = render_geometry(mesh, camera)
    pixels = np.tile(BACKDROP, (camera.height, camera.width, 1))
    colours = gain * paint(buffer.points[buffer.covered])
    pixels[buffer.covered] = np.rint(np.clip(colours, 0, 255)).astype(np.uint8)
    return Photo(name, pixels)


def render_textured(
    mesh: Mesh, corner_uv: np.ndarray, texture: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """The textured surface by bilinear lookup, as any viewer shows it.

    Returns:
        Picture (h, w, 3) float, and the texel (row, column) nearest to each pixel,
        (h, w, 2); -1 off the mesh.
    """
    buffer = render_geometry(mesh, camera)
    face = buffer.face_index[buffer.covered]
    points = buffer.points[buffer.covered]
    a, b, c = (mesh.vertices[mesh.faces[face, i]] for i in range(3))
    bary = trimesh.triangles.points_to_barycentric(np.stack([a, b, c], axis=1), points)
    uv = (bary[:, :, None] * corner_uv[face]).sum(axis=1)
    height, width = texture.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip((1.0 - uv[:, 1]) * height - 0.5, 0, height - 1)
    ix = np.minimum(x.astype(int), width - 2)
    iy = np.minimum(y.astype(int), height - 2)
    fx, fy = (x - ix)[:, None], (y - iy)[:, None]
    t = texture.astype(np.float64)
    upper = (1 - fx) * t[iy, ix] + fx * t[iy, ix + 1]
    lower = (1 - fx) * t[iy + 1, ix] + fx * t[iy + 1, ix + 1]
    picture = np.zeros((camera.height, camera.width, 3))
    picture[buffer.covered] = (1 - fy) * upper + fy * lower
    texel = np.full((camera.height, camera.width, 2), -1)
    texel[buffer.covered] = np.column_stack([np.rint(y), np.rint(x)]).astype(int)
    return picture, texel
