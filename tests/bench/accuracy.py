"""How near the true cameras a refinement ends, in pixels by the paper's equation 5."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from photoreg.camera import Camera
from photoreg.evaluate import projection_error
from photoreg.formats.cameras_json import load_cameras
from photoreg.mesh import MESH_SUFFIXES, Mesh, load_mesh
from photoreg.photo import Photo, load_photo
from photoreg.registration import Finished, RegistrationConfig, refine
from tests.bench.metrics import Metric, Setting, bench, spread

DEMO = Path(__file__).parents[2] / "static" / "demo"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """One refinement against the truth."""

    start_px: float
    end_px: float
    elapsed_s: float
    finished: Finished


def run(
    mesh: Mesh,
    photos: Sequence[Photo],
    true: Sequence[Camera],
    start: Sequence[Camera],
    config: RegistrationConfig | None = None,
) -> Outcome:
    """Refines ``start`` and measures both ends of the way."""
    began = time.perf_counter()
    (finished,) = [
        event
        for event in refine(mesh, photos, start, config)
        if isinstance(event, Finished)
    ]
    elapsed_s = time.perf_counter() - began
    return Outcome(
        projection_error(mesh, true, start).mean,
        projection_error(mesh, true, finished.cameras).mean,
        elapsed_s,
        finished,
    )


@bench
def demo(setting: Setting) -> Iterator[Metric]:
    """The demo from its rough cameras, with several seeds."""
    mesh, photos, true, start = load_set(DEMO, DEMO / "rough.json", DEMO)
    outcomes = [
        run(mesh, photos, true, start, RegistrationConfig.preset("default", seed=seed))
        for seed in range(min(setting.n, 5))
    ]
    note = f"start {outcomes[0].start_px:.1f} px"
    yield from spread("demo.error", [o.end_px for o in outcomes], "px", 1.0, note=note)
    # The first run compiles the kernels where they are not cached yet.
    times = [o.elapsed_s for o in outcomes[1:]] or [outcomes[0].elapsed_s]
    yield from spread("demo.time", times, "s", 10.0, tolerance=1.0)


@bench
def sets(setting: Setting) -> Iterator[Metric]:
    """Every set of the data folder, every pair and band that has starts."""
    if setting.data is None:
        return
    for folder in sorted(path for path in setting.data.iterdir() if path.is_dir()):
        groups: dict[str, list[Path]] = {}
        for path in sorted((folder / "starts").glob("*.json")):
            groups.setdefault(path.stem.rsplit("-", 1)[0], []).append(path)
        for group, paths in groups.items():
            yield from _one_pair(f"sets.{folder.name}.{group}", folder, paths, setting)


def _one_pair(
    name: str, folder: Path, starts: Sequence[Path], setting: Setting
) -> Iterator[Metric]:
    preset = "thorough" if name.endswith("-hard") else "default"
    config = RegistrationConfig.preset(preset)
    outcomes = [
        run(*load_set(folder, path, folder / "photos"), config)
        for path in starts[: setting.n]
    ]
    mesh, photos, true, _ = load_set(folder, starts[0], folder / "photos")
    moved = run(mesh, photos, true, true, config).end_px
    start_px = [outcome.start_px for outcome in outcomes]
    note = f"start {min(start_px):.1f}-{max(start_px):.1f} px"
    yield from spread(
        f"{name}.error",
        [outcome.end_px for outcome in outcomes],
        "px",
        moved + 0.5,
        note=f"{note}; bar: own cameras move {moved:.2f} px, + 0.5",
    )
    worse = sum(outcome.end_px > outcome.start_px for outcome in outcomes)
    yield Metric(f"{name}.made_worse", worse, "starts", "lower", 0.0)
    yield Metric(
        f"{name}.time",
        sum(outcome.elapsed_s for outcome in outcomes) / len(outcomes),
        "s",
        "lower",
        tolerance=1.0,
    )


def load_set(
    folder: Path, start: Path, photo_folder: Path
) -> tuple[Mesh, list[Photo], list[Camera], list[Camera]]:
    """Mesh, photos of ``start``, their true cameras and the rough ones."""
    (mesh_path,) = (
        path
        for path in folder.iterdir()
        if path.suffix in MESH_SUFFIXES and path.is_file()
    )
    file = load_cameras(start)
    photos = [load_photo(photo_folder / name) for name in file.cameras]
    true = load_cameras(folder / "cameras.json").of_photos(photos)
    return load_mesh(mesh_path), photos, true, file.of_photos(photos)
