"""Made scenes for the benches, kept on disk: drawing one takes seconds."""

import dataclasses
import hashlib
import os
import pickle
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import photoreg
from photoreg.camera import Camera
from photoreg.mesh import Mesh
from photoreg.photo import Photo
from photoreg.rough import rough_start
from photoreg.scene_options import SceneOptions
from photoreg.synthetic import make_scene

STORE = Path(tempfile.gettempdir()) / "photoreg-bench-scenes"
"""Scenes made before, each under a digest of its options and of the source files that
draw scenes: a changed source makes a new scene."""

_SOURCES = (
    *("synthetic", "scene_options", "render", "rough", "noise", "rock", "shell"),
    *("shell_pattern", "raster", "mesh", "camera", "sampling"),
)


@dataclasses.dataclass(frozen=True, eq=False)
class World:
    """What a bench needs of a made scene."""

    seed: int
    mesh: Mesh
    """The mesh that a registration is given."""
    true_mesh: Mesh
    """The surface that the photos show."""
    photos: tuple[Photo, ...]
    cameras: tuple[Camera, ...]
    """The true cameras."""
    rough_cameras: tuple[Camera, ...]

    def starting(self, error_px: tuple[float, float]) -> "World":
        """The same scene with rough cameras whose error lies in another band."""
        rough = rough_start(self.true_mesh, self.cameras, error_px, self.seed)
        return dataclasses.replace(self, rough_cameras=tuple(rough))


def world(kind: str = "clean", seed: int = 0, **settings: Any) -> World:
    """The scene of these `SceneOptions`, 1024x768 unless they say otherwise."""
    size = {"width": 1024, "height": 768}
    options = SceneOptions(
        kind=kind,  # pyright: ignore[reportArgumentType]
        seed=seed,
        **{**size, **settings},
    )
    path = STORE / f"{kind}-{seed}-{_digest(options)}.pickle"
    if path.exists():
        return World(seed, *pickle.loads(path.read_bytes()))
    scene = make_scene(options)
    made = (
        scene.mesh,
        scene.true_mesh,
        scene.photos,
        scene.cameras,
        scene.rough_cameras,
    )
    STORE.mkdir(parents=True, exist_ok=True)
    # Written aside and renamed: another bench may be reading.
    aside = path.with_suffix(f".{os.getpid()}")
    aside.write_bytes(pickle.dumps(made))
    aside.replace(path)
    return World(seed, *made)


def worlds(n: int, kind: str = "clean", **settings: Any) -> Iterator[World]:
    """``n`` scenes of a kind, by their seeds from 0."""
    for seed in range(n):
        yield world(kind, seed, **settings)


def _digest(options: SceneOptions) -> str:
    digest = hashlib.sha256(repr(options).encode())
    folder = Path(photoreg.__file__).parent
    for name in _SOURCES:
        path = folder / f"{name}.py"
        digest.update(path.read_bytes() if path.exists() else b"")
    return digest.hexdigest()[:16]
