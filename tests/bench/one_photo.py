"""One photo against the surface alone: its outline, and with the shading."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from photoreg.imaging.photo import Photo
from photoreg.registration.config import RegistrationConfig
from tests.bench.accuracy import load_set
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.outcomes import Outcome, error_figures, run
from tests.bench.worlds import World, worlds

WHOLE = RegistrationConfig()
OUTLINE = dataclasses.replace(
    WHOLE, polish=dataclasses.replace(WHOLE.polish, use_shading=False)
)
RAPID_PX = {"clean": 0.96, "mid": 0.86, "clutter": 2.8, "hard": 1.25}
"""What OpenCV's `rapid` reaches on the sets of these names."""
BARS_PX = {
    "clean": 0.25,
    "mid": 0.86,
    "hard": 0.4,
    "head": 0.3,
    "coral": 0.3,
    "temple": 0.45,
    "granite": 1.3,
    "fountain": 1.6,
}


@bench
def one_photo(setting: Setting) -> Iterator[Metric]:
    """Every photo of made scenes by itself, and with DATA= the easy starts of each set."""
    for kind in ("clean", "mid", "hard", "shell"):
        made = list(worlds(setting.n, kind))
        yield from _figures(kind, [case for world in made for case in _alone(world)])
    made = list(worlds(setting.n, "hard"))
    inverted = [
        (world, dataclasses.replace(photo, pixels=255 - photo.pixels), i)
        for world in made
        for world, photo, i in _alone(world)
    ]
    yield from _figures("hard_inverted", inverted)
    if setting.data is None:
        return
    for folder in sorted(path for path in setting.data.iterdir() if path.is_dir()):
        groups: dict[str, list[World]] = {}
        for path in sorted((folder / "starts").glob("*-easy-*.json")):
            group = groups.setdefault(path.stem.rsplit("-", 2)[0], [])
            if len(group) < setting.n:
                mesh, photos, true, start = load_set(folder, path, folder / "photos")
                mesh = group[0].mesh if group else mesh
                group.append(
                    World(0, mesh, mesh, tuple(photos), tuple(true), tuple(start))
                )
        for group, found in groups.items():
            cases = [case for world in found for case in _alone(world)]
            yield from _figures(
                f"{folder.name}.{group}",
                cases,
                BARS_PX.get(folder.name),
                RAPID_PX.get(folder.name),
            )


Case = tuple[World, Photo, int]


def _alone(world: World) -> list[Case]:
    return [(world, photo, i) for i, photo in enumerate(world.photos)]


def _outcomes(cases: Sequence[Case], config: RegistrationConfig) -> list[Outcome]:
    return [
        run(
            world.mesh,
            [photo],
            world.cameras[i : i + 1],
            world.rough_cameras[i : i + 1],
            dataclasses.replace(config, seed=world.seed),
            world.true_mesh,
        )
        for world, photo, i in cases
    ]


def _figures(
    name: str,
    cases: Sequence[Case],
    bar_px: float | None = None,
    rapid_px: float | None = None,
) -> Iterator[Metric]:
    name = f"one_photo.{name}"
    alone, whole = _outcomes(cases, OUTLINE), _outcomes(cases, WHOLE)
    yield from error_figures(f"{name}.outline", alone)
    yield from error_figures(name, whole, bar_px)
    if rapid_px is not None:
        yield Metric(
            f"{name}.rapid", rapid_px, "px", "lower", note="OpenCV, for comparison"
        )
    cpu_s = [outcome.cpu_s for outcome in whole]
    yield Metric(f"{name}.cpu", float(np.mean(cpu_s)), "s", "lower", tolerance=1.0)
    expected = [outcome.finished.expected_error_px for outcome in whole]
    told = [
        outcome.end_px <= 2.0 * px
        for outcome, px in zip(whole, expected, strict=True)
        if px is not None
    ]
    yield Metric(
        f"{name}.within_twice_expected",
        float(np.mean(told)) if told else 0.0,
        "of runs",
        "higher",
        0.8,
        note=", ".join("kept" if px is None else f"{px:.2f}" for px in expected[:6]),
    )
    grades = [outcome.finished.verdict for outcome in whole]
    counts = {
        word: sum(v is not None and v.grade == word for v in grades)
        for word in ("convincing", "plausible", "unconvincing")
    }
    yield Metric(
        f"{name}.credible",
        1.0 - counts["unconvincing"] / max(1, len(whole)),
        "of runs",
        "higher",
        note=", ".join(f"{count} {word}" for word, count in counts.items()),
    )
