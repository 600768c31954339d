"""Cameras found without a click: how often, how near, how honestly, and at what price."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from photoreg.errors import PhotoregError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.imaging.photo import Photo
from photoreg.placing.outcome import Placed, PlacingGrade
from photoreg.registration.attempts import refine_in_attempts
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished
from photoreg.registration.find_cameras import find_cameras
from tests.bench.accuracy import load_set
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.worlds import world

FIRST_SEED = 40
"""Of scenes that nothing was chosen by."""
RIGHT_PX, PLACED_PX = 2.0, 40.0
"""What counts as refined, and as near enough to be; at a width of 1,024 px."""
WRONG_PX = 10.0
"""An answer farther off must not be called convincing, nor a camera found."""


@dataclasses.dataclass(frozen=True)
class Way:
    """From photos without cameras to refined ones."""

    grade: PlacingGrade
    rough_px: float
    end_px: float
    verdict: str
    cpu_s: float


@bench
def placing(setting: Setting) -> Iterator[Metric]:
    """Pairs before plain and cluttered backgrounds; with DATA= each pair of the sets."""
    for name, kind, background in (
        ("shell", "shell", "plain"),
        ("clean", "clean", "dark"),
        ("hard", "hard", "plain"),
        ("clutter", "clutter", "clutter"),
    ):
        ways = []
        for seed in range(FIRST_SEED, FIRST_SEED + setting.n):
            made = world(kind, seed, background=background)
            ways.append(way(made.mesh, made.photos, made.cameras, made.true_mesh, seed))
        yield from _figures(name, ways, None if kind == "clutter" else 0.95)
    if setting.data is None:
        return
    for folder in sorted(path for path in setting.data.iterdir() if path.is_dir()):
        yield from _figures(folder.name, list(_of_set(folder)), None)


def _of_set(folder: Path) -> Iterator[Way]:
    seen = set()
    for path in sorted((folder / "starts").glob("*-easy-*.json")):
        pair = path.stem.rsplit("-", 2)[0]
        if pair not in seen:
            seen.add(pair)
            mesh, photos, true, _ = load_set(folder, path, folder / "photos")
            yield way(mesh, photos, true, mesh, 0)


def way(
    mesh: Mesh,
    photos: Sequence[Photo],
    true: Sequence[Camera],
    true_mesh: Mesh,
    seed: int,
) -> Way:
    """Finds and refines the cameras of photos, of which no focal length is known."""
    began = time.process_time()
    *_, placed = find_cameras(mesh, photos, seed=seed)
    assert isinstance(placed, Placed)
    if any(not one.candidates for one in placed.placements):
        taken = time.process_time() - began
        return Way(placed.grade, np.inf, np.inf, "none", taken)
    scale = 1024.0 / photos[0].width
    rough = [one.candidates[0] for one in placed.placements]
    rough_px = scale * max(
        error.mean for error in projection_error(true_mesh, true, rough).cameras
    )
    config = RegistrationConfig.preset("default", seed)
    end_px, verdict = np.inf, "refused"
    try:
        *_, last = refine_in_attempts(mesh, photos, rough, config)
        assert isinstance(last, Finished)
        ends = projection_error(true_mesh, true, last.cameras).cameras
        end_px = scale * max(error.mean for error in ends)
        verdict = last.verdict.grade if last.verdict is not None else "none"
    except PhotoregError:
        pass
    return Way(placed.grade, rough_px, end_px, verdict, time.process_time() - began)


def _figures(name: str, ways: Sequence[Way], bar: float | None) -> Iterator[Metric]:
    name = f"placing.{name}"

    def share(
        what: str, claims: Sequence[bool], bar: float | None, note: str
    ) -> Metric:
        value = float(np.mean(claims)) if len(claims) else 1.0
        return Metric(f"{name}.{what}", value, "of pairs", "higher", bar, 0.1, note)

    rough = [way.rough_px for way in ways]
    ends = [way.end_px for way in ways]
    yield share(
        "placed",
        [px <= PLACED_PX for px in rough],
        None,
        "rough " + ", ".join(f"{px:.1f}" for px in rough),
    )
    yield share(
        "refined",
        [px <= RIGHT_PX for px in ends],
        bar,
        "ends " + ", ".join(f"{px:.2f}" for px in ends),
    )
    yield share(
        "not_called_found_wrongly",
        [not (way.grade == "found" and way.rough_px > PLACED_PX) for way in ways],
        1.0,
        ", ".join(way.grade for way in ways),
    )
    yield share(
        "not_convincing_wrongly",
        [not (way.verdict == "convincing" and way.end_px > WRONG_PX) for way in ways],
        1.0,
        ", ".join(way.verdict for way in ways),
    )
    cpu_s = [way.cpu_s for way in ways]
    yield Metric(
        f"{name}.cpu", float(np.mean(cpu_s)), "s", "lower", 25.0, tolerance=1.0
    )
