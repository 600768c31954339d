"""How near the true cameras a refinement ends, in pixels by the paper's equation 5."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.formats.meshes.read import MESH_SUFFIXES, load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.imaging.photo import Photo
from photoreg.polish.polish_cameras import polish_cameras
from photoreg.registration.config import RegistrationConfig
from tests.bench.metrics import Metric, Setting, bench, spread
from tests.bench.outcomes import error_figures, figures, run
from tests.bench.worlds import worlds

DEMO = Path(__file__).parents[2] / "static" / "demo"

SET_BARS = {"clean": 0.1, "mid": 0.7, "clutter": 0.7, "hard": 1.0}
"""Mean errors to reach, in pixels, on the sets that are made; on real ones it is how
far the polish moves the set's own cameras, plus half a pixel."""

EXPOSURES: dict[str, dict[str, Any]] = {
    "gain_dark": {"gain": 0.8},
    "gain_bright": {"gain": 1.25},
    "gain_by_channel": {"gain": (0.8, 1.0, 1.25)},
    "offset": {"offset": (10.0, -10.0, 10.0)},
    "vignetting": {"vignetting": 0.4},
    "jpeg": {"jpeg_quality": 75},
    "noise": {"sensor_noise": 8.0},
}
"""What may differ between photos, singly."""

ALL_EXPOSURES: dict[str, Any] = {
    "gain": (0.8, 1.0, 1.25),
    "offset": (10.0, -10.0, 10.0),
    "vignetting": 0.4,
    "jpeg_quality": 75,
    "sensor_noise": 8.0,
}


@bench
def demo(setting: Setting) -> Iterator[Metric]:
    """The demo from its rough cameras, with several seeds."""
    mesh, photos, true, start = load_set(DEMO, DEMO / "rough.json", DEMO)
    outcomes = [
        run(mesh, photos, true, start, RegistrationConfig.preset("default", seed=seed))
        for seed in range(min(setting.n, 5))
    ]
    yield from error_figures("demo", outcomes, mean_bar=1.0)
    # The first run compiles the kernels where they are not cached yet.
    times = [o.elapsed_s for o in outcomes[1:]] or [outcomes[0].elapsed_s]
    yield from spread("demo.time", times, "s", 10.0, tolerance=1.0)


@bench
def clean(setting: Setting) -> Iterator[Metric]:
    """Exact mesh, flat light, rich texture; starts 15-25 px off."""
    yield from figures(
        "clean",
        worlds(setting.n, "clean"),
        mean_bar=0.10,
        worst_bar=0.3,
        under=(0.3, 1.0),
    )


@bench
def shell(setting: Setting) -> Iterator[Metric]:
    """The Shell in soft shading; starts 15-25 px off."""
    yield from figures(
        "shell",
        worlds(setting.n, "shell"),
        mean_bar=0.10,
        worst_bar=0.3,
        under=(0.3, 1.0),
    )


@bench
def far(setting: Setting) -> Iterator[Metric]:
    """Starts 40 px off."""
    yield from figures(
        "far",
        (world.starting((38.0, 42.0)) for world in worlds(setting.n, "clean")),
        under=(0.5, 0.99),
    )


@bench
def very_far(setting: Setting) -> Iterator[Metric]:
    """Starts 80 px off, by the thorough preset."""
    yield from figures(
        "very_far",
        (world.starting((77.0, 83.0)) for world in worlds(setting.n, "clean")),
        "thorough",
        under=(0.5, 0.95),
    )


@bench
def mesh_noise(setting: Setting) -> Iterator[Metric]:
    """Every vertex wrong by 0.05 % of the diagonal."""
    yield from figures(
        "mesh_noise", worlds(setting.n, "clean", mesh_noise=0.0005), mean_bar=0.5
    )


@bench
def exposure(setting: Setting) -> Iterator[Metric]:
    """Photos that differ in exposure, lens, coding and noise; each and all."""
    for name, settings in EXPOSURES.items():
        yield from figures(
            f"exposure.{name}",
            worlds(setting.n, "clean", **settings),
            mean_bar=0.5,
            worst_bar=1.0,
        )
    yield from figures(
        "exposure.all",
        worlds(setting.n, "clean", **ALL_EXPOSURES),
        mean_bar=0.5,
        worst_bar=1.0,
    )


@bench
def mid(setting: Setting) -> Iterator[Metric]:
    """Faint texture, noise, another exposure, a mesh wrong by 0.1 %."""
    yield from figures(
        "mid", worlds(setting.n, "mid"), mean_bar=0.7, worst_bar=2.0, under=(2.0, 1.0)
    )


@bench
def clutter(setting: Setting) -> Iterator[Metric]:
    """Mid before textured surroundings."""
    yield from figures(
        "clutter",
        worlds(setting.n, "clutter"),
        mean_bar=0.7,
        worst_bar=2.0,
        under=(2.0, 1.0),
    )


@bench
def hard(setting: Setting) -> Iterator[Metric]:
    """Fainter still, and the light moves between the photos."""
    yield from figures(
        "hard", worlds(setting.n, "hard"), mean_bar=1.0, worst_bar=2.0, under=(2.0, 1.0)
    )


@bench
def occluder(setting: Setting) -> Iterator[Metric]:
    """A fifth of one photo covered, before textured surroundings."""
    yield from figures(
        "occluder",
        worlds(setting.n, "clean", occluder_share=0.2, background="clutter"),
        mean_bar=0.5,
    )


@bench
def sets(setting: Setting) -> Iterator[Metric]:
    """Every set of the data folder, every pair and band that has starts."""
    if setting.data is None:
        print("sets: left out, because no --data folder is given.")
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
    *_, polished = polish_cameras(mesh, photos, true, true, config.polish)
    moved = projection_error(mesh, true, polished.cameras).mean
    bar = SET_BARS.get(folder.name, moved + 0.5)
    yield from error_figures(name, outcomes, bar)
    yield Metric(f"{name}.own_cameras_move", moved, "px", "lower")
    worse = sum(outcome.end_px > outcome.start_px for outcome in outcomes)
    yield Metric(f"{name}.made_worse", worse, "starts", "lower", 0.0)
    times = [outcome.elapsed_s for outcome in outcomes]
    yield Metric(f"{name}.time", sum(times) / len(times), "s", "lower", tolerance=1.0)


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
