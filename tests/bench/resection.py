"""Cameras from clicked pairs on the real sets, against what the clicks can tell."""

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.formats.meshes.read import MESH_SUFFIXES, load_mesh
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.geometry.sampling import SurfaceSamples, sample_surface
from photoreg.geometry.visibility import seen_points
from photoreg.resection.solver import (
    CLICK_SIGMA_PX,
    FOCAL_SIGMA,
    GUESSED_FOCAL_SIDES,
    GUESSED_FOCAL_SIGMA,
    PRINCIPAL_SIGMA_SIDES,
    solve_camera,
)
from tests.bench.metrics import Metric, Setting, bench, spread
from tests.resection.naive_resection import refined_from_truth

EXIF_ERROR = 0.03
"""Relative error of a focal length as EXIF gives it."""
MARGIN_SHARE = 0.03
"""Nobody clicks nearer than this to the photo's border."""
N_CONSIDERED = 60
"""Points among which the widest spread ones are clicked."""
GROSS_PX = (50.0, 200.0)
MEAN_BAR_PX, WORST_BAR_PX = 3.0, 20.0
"""From 20 px on the refinement takes over."""


@dataclasses.dataclass(frozen=True)
class Case:
    """What is clicked, and what is known beforehand."""

    name: str
    n_pairs: int
    n_gross: int
    exif: bool


CASES = (
    Case("six", 6, 0, False),
    Case("six_exif", 6, 0, True),
    Case("eight", 8, 0, False),
    Case("eight_exif", 8, 0, True),
    Case("gross", 8, 2, False),
    Case("gross_exif", 8, 2, True),
)


@bench
def resection(setting: Setting) -> Iterator[Metric]:
    """Pairs clicked at 1 px noise on every set of the data folder."""
    if setting.data is None:
        print("resection: left out, because no --data folder is given.")
        return
    times: dict[str, list[float]] = {case.name: [] for case in CASES}
    for folder in sorted(path for path in setting.data.iterdir() if path.is_dir()):
        (mesh_path,) = (p for p in folder.iterdir() if p.suffix in MESH_SUFFIXES)
        mesh = load_mesh(mesh_path)
        cameras = list(load_cameras(folder / "cameras.json").cameras.values())
        for case in CASES:
            yield from _figures(folder, mesh, cameras, case, setting.n, times)
    for name, taken in times.items():
        yield Metric(
            f"resection.time.{name}",
            1e3 * float(np.median(taken)),
            "ms",
            "lower",
            30.0,
            tolerance=1.0,
            note=f"of a processor, median; slowest {1e3 * max(taken):.0f}",
        )


def _figures(
    folder: Path,
    mesh: Mesh,
    cameras: list[Camera],
    case: Case,
    n_trials: int,
    times: dict[str, list[float]],
) -> Iterator[Metric]:
    samples = sample_surface(mesh, 20_000, seed=1)
    errors, bounds, expected, named = [], [], [], 0
    for trial in range(n_trials):
        camera = cameras[trial % len(cameras)]
        seen = samples.points[seen_points(mesh, camera, samples.points)]
        rng = np.random.default_rng([trial, case.n_pairs])
        points = clicked_points(mesh, samples, camera, case.n_pairs, rng)
        pixels = camera.project(points) + rng.normal(size=(case.n_pairs, 2))
        gross = rng.permutation(case.n_pairs)[: case.n_gross]
        angle = rng.uniform(0.0, 2.0 * np.pi, case.n_gross)
        far = rng.uniform(*GROSS_PX, case.n_gross)[:, None]
        pixels[gross] += far * np.column_stack([np.cos(angle), np.sin(angle)])
        side = max(camera.width, camera.height)
        f = camera.K[0, 0] * np.exp(EXIF_ERROR * rng.normal())
        if not case.exif:
            f = GUESSED_FOCAL_SIDES * side
        prior = Camera.look_at(
            (0, 0, 0), (0, 0, 1), (0, 1, 0), f, camera.width, camera.height
        )
        began = time.thread_time()
        solved = solve_camera(
            points,
            pixels,
            camera.width,
            camera.height,
            prior if case.exif else None,
            surface=seen[::20],
        )
        times[case.name].append(time.thread_time() - began)
        keep = np.ones(case.n_pairs, dtype=bool)
        keep[gross] = False
        named += np.array_equal(solved.inliers, keep)
        best = refined_from_truth(
            points,
            pixels,
            camera,
            prior,
            FOCAL_SIGMA if case.exif else GUESSED_FOCAL_SIGMA,
            PRINCIPAL_SIGMA_SIDES * side,
            CLICK_SIGMA_PX,
            used=keep,
        )
        found = projection_error(mesh, [camera] * 2, [solved.camera, best])
        errors.append(found.cameras[0].mean)
        bounds.append(found.cameras[1].mean)
        expected.append(solved.expected_error_px)
    name = f"resection.{folder.name}.{case.name}"
    note = f"from truth {np.mean(bounds):.2f}; foretold {np.median(expected):.1f}"
    yield from spread(name, errors, "px", MEAN_BAR_PX, WORST_BAR_PX, note=note)
    if case.n_gross > 0:
        share = named / n_trials
        yield Metric(f"{name}.named", share, "share", "higher", 0.95, tolerance=0.05)


def clicked_points(
    mesh: Mesh,
    samples: SurfaceSamples,
    camera: Camera,
    n: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Surface points as a person chooses them: seen well, spread over the photo.

    Each is the farthest, in the photo, from those before it, among some that face the
    camera and lie off the border.
    """
    points = samples.points
    toward = camera.center - points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    pixels = camera.project(points)
    margin = MARGIN_SHARE * np.array([camera.width, camera.height])
    size = np.array([camera.width, camera.height])
    good = seen_points(mesh, camera, points)
    good &= (np.abs(pixels - 0.5 * size) < 0.5 * size - margin).all(axis=1)
    good &= np.abs((samples.normals * toward).sum(axis=1)) > 0.5
    some = rng.permutation(np.flatnonzero(good))[:N_CONSIDERED]
    chosen = [int(some[0])]
    while len(chosen) < n:
        apart = np.linalg.norm(pixels[some][:, None] - pixels[chosen], axis=2)
        chosen.append(int(some[apart.min(axis=1).argmax()]))
    return points[chosen]
