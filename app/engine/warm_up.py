"""A toy scene on which the worker compiles its kernels before the user needs them."""

import dataclasses
from collections.abc import Iterator

import cv2
import numpy as np

from app.engine.agreement_meter import AgreementMeter
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.imaging.photo import Photo
from photoreg.overlay.pictures import LiveOverlay
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.refinement import refine
from photoreg.synthetic.rock import rock_mesh

WIDTH, HEIGHT = 160, 120


def toy_scene() -> tuple[Mesh, tuple[Photo, ...], tuple[Camera, ...]]:
    """A rock, two blotchy photos of the right size, and cameras that see it."""
    mesh = rock_mesh(seed=0, subdivisions=3)
    rng = np.random.default_rng(0)
    photos, cameras = [], []
    for i, angle in enumerate((-0.2, 0.2)):
        noise = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
        pixels = cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        photos.append(Photo(f"toy-{i}.png", pixels))
        centre = mesh.centroid + 4.0 * np.array([np.sin(angle), 0.0, np.cos(angle)])
        cameras.append(
            Camera.look_at(centre, mesh.centroid, (0, 1, 0), 180.0, WIDTH, HEIGHT)
        )
    return mesh, tuple(photos), tuple(cameras)


def warm_up_steps() -> Iterator[str]:
    """Runs each kernel once; what comes is only a chance to leave off."""
    mesh, photos, cameras = toy_scene()
    overlay = LiveOverlay(mesh, photos, WIDTH)
    overlay.picture(cameras, 0, 1)
    yield "overlay"
    AgreementMeter(mesh, photos).agreement(cameras)
    yield "judge"
    projection_error(mesh, cameras, cameras, n_samples=200)
    yield "error"
    config = RegistrationConfig.preset("fast")
    config = dataclasses.replace(
        config,
        genetic=dataclasses.replace(config.genetic, population=20, generations=2),
    )
    for n in (2, 1):
        for event in refine(mesh, photos[:n], cameras[:n], config):
            yield type(event).__name__
