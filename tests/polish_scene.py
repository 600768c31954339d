"""A small world with truth for the polish: a bumpy ball in solid colours, two photos."""

import dataclasses
import functools

import numpy as np
import trimesh

from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo


@dataclasses.dataclass(frozen=True)
class PolishScene:
    mesh: Mesh
    photos: tuple[Photo, ...]
    cameras: tuple[Camera, ...]
    rough: tuple[Camera, ...]


def bumpy_ball(subdivisions=4):
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    directions = np.asarray(ball.vertices)
    phase = np.array([0.3, 1.1, 2.0])
    bumps = np.sin(4.0 * directions + phase).prod(axis=1)
    bumps += 0.6 * np.sin(7.0 * directions @ np.array([0.5, -0.7, 0.4]) + 0.9)
    radius = 1.0 + 0.08 * bumps
    stretch = np.array([1.3, 0.9, 1.0])
    return Mesh(directions * radius[:, None] * stretch, np.asarray(ball.faces))


def colours(points):
    rng = np.random.default_rng(11)
    values = np.full((len(points), 3), 128.0)
    for frequency in (3.0, 6.0, 12.0, 24.0):
        for _ in range(6):
            wave = rng.normal(size=3) * frequency
            tint = rng.normal(size=3) * 26.0 / np.sqrt(frequency)
            values += np.sin(points @ wave + rng.uniform(0, 6.3))[:, None] * tint
    return values


def photograph(mesh, camera, name, gain=1.0, offset=0.0, samples=2):
    """Area-averaged: samples x samples rays a pixel."""
    total = np.zeros((camera.height, camera.width, 3))
    xs, ys = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    for i in range(samples):
        for j in range(samples):
            shift = (np.array([i, j]) + 0.5) / samples - 0.5
            pixels = np.column_stack([xs.ravel(), ys.ravel()]) + shift
            center, directions = camera.rays(pixels)
            face, distance = mesh.first_hits(
                np.broadcast_to(center, directions.shape), directions
            )
            seen = face >= 0
            points = center + distance[seen, None] * directions[seen]
            values = np.full((len(pixels), 3), 25.0)
            values[seen] = colours(points) * gain + offset
            total += values.reshape(total.shape)
    pixels = np.clip(np.rint(total / samples**2), 0, 255).astype(np.uint8)
    return Photo(name, pixels)


@functools.cache
def make_polish_scene(
    gain=1.0, offset=0.0, width=400, height=300, n_photos=2, lens=IDEAL, share=1.45
):
    """Photos with a focal length of ``share`` times the width, filled alike."""
    mesh = bumpy_ball()
    cameras, photos, rough = [], [], []
    rng = np.random.default_rng(4)
    for i in range(n_photos):
        angle = np.deg2rad(25.0 * i - 12.0)
        distance = 5.0 * share / 1.45
        center = np.array([distance * np.sin(angle), -0.6, -distance * np.cos(angle)])
        camera = Camera.look_at(
            center, [0.02, 0.03, 0.0], [0.0, -1.0, 0.1], share * width, width, height
        )
        K = camera.K.copy()
        K[:2, 2] += (1.5, -1.0)
        camera = dataclasses.replace(camera, K=K, lens=lens)
        cameras.append(camera)
        factor, shift = (1.0, 0.0) if i == 0 else (gain, offset)
        photos.append(photograph(mesh, camera, f"{i}.png", factor, shift))
        turned = Camera.look_at(
            center * (1.0 + 0.02 * rng.normal()) + 0.07 * rng.normal(size=3),
            [0.02, 0.03, 0.0] + 0.02 * rng.normal(size=3),
            [0.02 * rng.normal(), -1.0, 0.1],
            share * width * (1.0 + 0.015 * rng.normal()),
            width,
            height,
        )
        rough.append(turned)
    return PolishScene(mesh, tuple(photos), tuple(cameras), tuple(rough))


def projection_error_px(mesh, true, estimated):
    errors = []
    for a, b in zip(true, estimated, strict=True):
        points = mesh.vertices[
            np.einsum("ij,ij->i", mesh.vertex_normals, a.center - mesh.vertices) > 0.0
        ]
        points = points[mesh.is_unoccluded(points, a.center)]
        errors.append(
            np.linalg.norm(a.project(points) - b.project(points), axis=1).mean()
        )
    return float(np.mean(errors))


def moved(scene, scale, R, t):
    """The same world in other units and axes."""
    mesh = Mesh(scale * scene.mesh.vertices @ R.T + t, scene.mesh.faces)

    def move(camera):
        turned = camera.R_cam_world @ R.T
        return dataclasses.replace(
            camera,
            R_cam_world=turned,
            t_cam_world=scale * camera.t_cam_world - turned @ t,
        )

    return PolishScene(
        mesh,
        scene.photos,
        tuple(move(c) for c in scene.cameras),
        tuple(move(c) for c in scene.rough),
    )
