"""Compiles the kernels once, on both cores, before the tests' processes need them.

Else each test process and each worker of the app compiles them for itself: five times
a minute of one core on a clean checkout. With compiled kernels this takes seconds.
"""

import dataclasses
import multiprocessing
from collections.abc import Callable

from app.engine.warm_up import toy_scene, warm_up_steps
from photoreg.polish.polish_cameras import polish_cameras
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from photoreg.texture.bake import bake_texture
from photoreg.texture.config import TextureConfig


def _polish() -> None:
    mesh, photos, cameras = toy_scene()
    for n in (2, 1):
        next(iter(polish_cameras(mesh, photos[:n], cameras[:n], cameras[:n])))


def _search_and_bake() -> None:
    mesh, photos, cameras = toy_scene()
    default = RegistrationConfig()
    for config in (default, RegistrationConfig.preset("paper")):
        genetic = dataclasses.replace(config.genetic, population=20, generations=2)
        config = dataclasses.replace(config, genetic=genetic, polish_after=False)
        list(refine(mesh, photos, cameras, config))
    list(refine(mesh, photos[:1], cameras[:1], config))
    make_scene(SceneOptions(kind="clean", width=80, height=60))
    for config in (TextureConfig(size=64), TextureConfig(size=64, mode="best")):
        bake_texture(mesh, photos, cameras, config)


def _run(part: Callable[[], None]) -> None:
    part()


def main() -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        pool.map(_run, [_polish, _search_and_bake], chunksize=1)
    list(warm_up_steps())


if __name__ == "__main__":
    main()
