"""Made scenes for the benches, kept on disk: drawing one takes seconds."""

import dataclasses
import functools
import hashlib
import os
import pickle
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import photoreg
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.paper.experiment import manual_start
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.rough_cameras import rough_start
from photoreg.synthetic.scene import make_scene

STORE = Path(tempfile.gettempdir()) / "photoreg-bench-scenes"
"""Scenes made before, each under a digest of its options and of the source files that
draw scenes: a changed source makes a new scene."""


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

    def by_hand(self) -> "World":
        """The same scene with manual cameras inside the paper's gene intervals."""
        manual = manual_start(self.true_mesh, self.cameras, seed=self.seed)
        return dataclasses.replace(self, rough_cameras=tuple(manual))


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
    digest.update(_sources())
    return digest.hexdigest()[:16]


@functools.cache
def _sources() -> bytes:
    """All source text that drawing a scene rests on: what synthetic imports, in turn."""
    root = Path(photoreg.__file__).parents[1]
    texts: dict[str, str] = {}
    left = ["photoreg.synthetic.scene"]
    while left:
        name = left.pop()
        path = root / f"{name.replace('.', '/')}.py"
        if name not in texts and path.exists():
            texts[name] = path.read_text(encoding="utf-8")
            left += re.findall(r"^from (photoreg[\w.]*) import", texts[name], re.M)
    return "".join(texts[name] for name in sorted(texts)).encode()
