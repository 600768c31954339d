"""Collections of tiny made objects, as files."""

import functools
from pathlib import Path

from photoreg.synthetic.scene import Scene, write_scene
from tests.scenes import small_scene

QUICK = [
    *("--preset", "fast", "--population", "20", "--generations", "3"),
    "--no-polish-after",
]
"""Words of a refinement that takes a second."""

QUICK_BATCH = [*QUICK, "--model", "ply", "--texture.size", "64", "--workers", "1"]
"""Words of a batch that takes a second or two an object."""


@functools.cache
def tiny_scene(seed: int) -> Scene:
    """A rock in two photos of 160 x 120 px."""
    return small_scene(seed, n_faces=1_280, width=160, height=120, error_px=(2.0, 3.0))


def make_object(folder: Path, seed: int = 0) -> Path:
    """An object's folder: mesh, two photos and rough cameras; the truth is left out."""
    folder.mkdir(parents=True)
    write_scene(tiny_scene(seed), folder)
    (folder / "cameras.json").unlink()
    return folder


def make_collection(folder: Path, n: int, n_seeds: int = 3) -> Path:
    """So many objects, each the same as the one ``n_seeds`` before it."""
    for number in range(n):
        make_object(folder / f"object {number:04d}", number % n_seeds)
    return folder


def photoreg(*words: object) -> int:
    """Runs the command line; returns the exit status."""
    from photoreg.cli.commands import run

    return run([str(word) for word in words])
