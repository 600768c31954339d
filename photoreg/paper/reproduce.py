"""`photoreg reproduce`: the paper's experiment, from scene to report."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

from photoreg.errors import InputError, OutputError
from photoreg.formats.writing import check_outputs
from photoreg.imaging.encoding import encode_jpeg
from photoreg.paper.experiment import Method, MethodRun, count, methods, runs
from photoreg.paper.report import Setup, report_files, write_report
from photoreg.paper.report_plots import check_plots
from photoreg.polish.config import PolishConfig
from photoreg.registration.config import RegistrationConfig
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import Scene, make_scene

PHOTO_SIZE = (1024, 768)
"""Width and height of the Shell's photos. The paper gives no size that we could read;
its errors of 5 to 6 px were small beside it."""


@dataclasses.dataclass(frozen=True)
class ReproductionStep:
    """What has just been done."""

    text: str
    """One line for a person."""
    fraction: float
    """Share of all runs done, in [0, 1]."""


@dataclasses.dataclass(frozen=True)
class Reproduced:
    """The end: everything is written."""

    paths: tuple[Path, ...]
    """The files; report.html is the one to open."""
    runs: tuple[MethodRun, ...] = dataclasses.field(repr=False)
    """Every run of every method."""


def reproduce(
    out_dir: Path | str,
    n_runs: int = 10,
    seed: int = 0,
    populations: Sequence[int] = (500, 1000),
    generations: int = 100,
    scene: Scene | None = None,
    polish: PolishConfig | None = None,
    overwrite: bool = False,
) -> Iterator[ReproductionStep | Reproduced]:
    """Makes the paper's experiment and writes a report; yields after each run.

    The comparisons of colour spaces, costs and so on take half as many runs as
    Table 1. Stop iterating to cancel; nothing is written then.

    Args:
        out_dir: Where report.html, report.md, results.json and the figures go.
        n_runs: Runs of each column of Table 1, at least 1.
        seed: Of the manual starts and the searches; the Shell is always the same.
        populations: Individuals of Table 1's columns.
        generations: Generations of each of the 5 restarts.
        scene: Another scene than the Shell.
        polish: Other settings of our polish.
        overwrite: Whether files in ``out_dir`` without photoreg's mark may be replaced.

    Raises:
        InputError: if ``n_runs`` is not positive or matplotlib is not installed.
        OutputError: if ``out_dir`` cannot be written, or other files are there.
    """
    if n_runs < 1:
        raise InputError(f"runs is {n_runs}; give at least 1.")
    check_plots()
    n_photos = 2 if scene is None else len(scene.photos)
    folder = _writable(Path(out_dir), n_photos, overwrite)
    rows = methods(populations, generations, polish)
    return _steps(folder, rows, n_runs, seed, generations, scene, overwrite)


def _steps(
    folder: Path,
    rows: Sequence[Method],
    n_runs: int,
    seed: int,
    generations: int,
    scene: Scene | None,
    overwrite: bool,
) -> Iterator[ReproductionStep | Reproduced]:
    yield ReproductionStep("Drawing the Shell.", 0.0)
    if scene is None:
        width, height = PHOTO_SIZE
        scene = make_scene(SceneOptions(kind="shell", width=width, height=height))
    n_compared = max(1, n_runs // 2)
    n_all = sum(count(row, n_runs, n_compared) for row in rows)
    done: list[MethodRun] = []
    for run in runs(scene, rows, n_runs, n_compared, seed):
        done.append(run)
        yield ReproductionStep(
            f"{run.method}, run {run.run}: {run.start_px:.1f} -> {run.end_px:.2f} px "
            f"in {run.seconds:.1f} s",
            len(done) / n_all,
        )
    paper = RegistrationConfig.preset("paper")
    camera = scene.cameras[0]
    setup = Setup(
        (camera.width, camera.height),
        len(scene.mesh.faces),
        paper.samples,
        generations,
        paper.genetic.restarts,
        tuple(
            (photo.name, encode_jpeg(photo.pixels, 88, 640)) for photo in scene.photos
        ),
    )
    said = {(row.table, row.name): row.paper for row in rows}
    paths = write_report(folder, setup, done, said, overwrite)
    yield Reproduced(tuple(paths), tuple(done))


def _writable(folder: Path, n_photos: int, overwrite: bool) -> Path:
    """Makes the folder and tries to write in it, before the first run.

    Raises:
        OutputError: if that fails.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot write the report to {folder}: {error.strerror or error}."
        ) from error
    check_outputs(report_files(folder, n_photos), overwrite=overwrite)
    return folder
