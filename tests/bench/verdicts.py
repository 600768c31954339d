"""How often a refinement's verdict is right about where it ended."""

from collections.abc import Iterator
from pathlib import Path

from photoreg.synthetic.rough_cameras import rough_start
from tests.bench.accuracy import load_set
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.outcomes import Outcome, run, run_world
from tests.bench.worlds import worlds

RIGHT_PX = 2.0
"""An end within this is right."""

TOO_FAR_SHARE = (0.1, 0.2)
"""How far those starts are off that shall end wrong, over a photo's longer side. The
default preset's box holds about 0.04."""


@bench
def verdicts(setting: Setting) -> Iterator[Metric]:
    """Verdicts on right and on wrong ends, of made scenes and of the folder's sets.

    Half of the starts are such as the default preset is made for, half are too far for
    it.
    """
    outcomes = list(_made(setting.n))
    if setting.data is not None:
        for folder in sorted(path for path in setting.data.iterdir() if path.is_dir()):
            outcomes += _of_set(folder, setting.n)
    right = [outcome for outcome in outcomes if outcome.end_px <= RIGHT_PX]
    wrong = [outcome for outcome in outcomes if outcome.end_px > RIGHT_PX]
    yield from _graded("verdicts.right", right, fault="unconvincing")
    yield from _graded("verdicts.wrong", wrong, fault="convincing")


def _graded(name: str, outcomes: list[Outcome], fault: str) -> Iterator[Metric]:
    ends: dict[str, list[float]] = {
        "convincing": [],
        "plausible": [],
        "unconvincing": [],
    }
    for outcome in outcomes:
        assert outcome.finished.verdict is not None
        ends[outcome.finished.verdict.grade].append(outcome.end_px)
    for grade, errors in ends.items():
        yield Metric(
            f"{name}.{grade}",
            len(errors),
            "ends",
            "lower" if grade == fault else "higher",
            0.0 if grade == fault else None,
            0.5,
            f"of {len(outcomes)}"
            + (f"; {min(errors):.2g} to {max(errors):.2g} px" if errors else ""),
        )


def _made(n: int) -> Iterator[Outcome]:
    for kind in ("clean", "mid", "clutter", "hard"):
        for scene in worlds(n, kind):
            yield run_world(scene)
            width = scene.photos[0].width
            low, high = TOO_FAR_SHARE
            yield run_world(scene.starting((low * width, high * width)))


def _of_set(folder: Path, n: int) -> Iterator[Outcome]:
    """Every pair of a set from its easy starts, and from as many that are too far."""
    for path in sorted((folder / "starts").glob("*-easy-*.json")):
        seed = int(path.stem.rsplit("-", 1)[1])
        if seed < n:
            mesh, photos, true, start = load_set(folder, path, folder / "photos")
            yield run(mesh, photos, true, start)
            side = max(true[0].width, true[0].height)
            low, high = TOO_FAR_SHARE
            far = rough_start(mesh, true, (low * side, high * side), seed)
            yield run(mesh, photos, true, far)
