"""The command line: files in, files out, figures on request.

Exit status 0: done. 1: stopped early or crashed. 2: bad input, in one sentence.
"""

import contextlib
import errno
import itertools
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, get_args

import rich.console
import rich.progress
import rich.table
import tyro

from photoreg.checks import noting_inputs
from photoreg.cli.app import app_command
from photoreg.cli.batch import make_batch_command
from photoreg.cli.console import log, print_json, print_notes, progress_bar
from photoreg.cli.convert import convert_command
from photoreg.cli.place import place_command
from photoreg.cli.refine import make_refine_command
from photoreg.cli.scene import MeshPath, surface_told
from photoreg.cli.stopping import asked_to_stop
from photoreg.cli.texture import texture_command
from photoreg.cli.undistort import undistort_command
from photoreg.errors import InputError, OutputError, PhotoregError
from photoreg.formats.cameras.cameras_json import CameraFile
from photoreg.formats.cameras.registry import read_cameras
from photoreg.geometry.projection_error import projection_error
from photoreg.paper.reproduce import Reproduced, reproduce
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.texture_doubts import why_blind
from photoreg.registration.world import in_world_of_mesh
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene, write_scene


def commands(argv: Sequence[str] = ()) -> dict[str, Callable[..., int]]:
    """The commands by name; the defaults of `refine` and `batch` are those of argv's --preset."""
    preset = RegistrationConfig.preset(_preset(argv))
    return {
        "app": app_command,
        "place": place_command,
        "refine": make_refine_command(preset),
        "batch": make_batch_command(preset),
        "evaluate": evaluate_command,
        "texture": texture_command,
        "convert": convert_command,
        "undistort": undistort_command,
        "synthesize": synthesize_command,
        "reproduce": reproduce_command,
    }


def _preset(argv: Sequence[str]) -> PresetName:
    """The preset that argv names.

    It decides the defaults of other options, so it is looked up before tyro parses the
    rest and refuses what is not a preset.
    """
    pairs = set(itertools.pairwise(argv))
    for name in get_args(PresetName):
        if f"--preset={name}" in argv or ("--preset", name) in pairs:
            return name
    return "default"


def evaluate_command(
    mesh: MeshPath, /, *, cameras: Path, truth: Path, json: bool = False
) -> int:
    """Measure cameras against the true ones: projection error in pixels.

    The paper's equation 5, over surface points visible in the true camera.

    Args:
        mesh: The scanned surface.
        cameras: The cameras to judge, in any format that `photoreg convert` reads.
        truth: The true cameras; photos are matched by name.
        json: Print the figures as JSON on standard output.
    """
    surface = surface_told(mesh)
    estimated, true = (
        _told(in_world_of_mesh(surface, (), read_cameras(path))).cameras
        for path in (cameras, truth)
    )
    if not estimated:
        raise InputError(f"{cameras.name} has no cameras.")
    missing = [name for name in estimated if name not in true]
    if missing:
        raise InputError(
            f"{truth.name} has no camera for {', '.join(missing)}; it has "
            f"{', '.join(true) or 'none at all'}. Photos are matched by file name."
        )
    for name, camera in estimated.items():
        if (camera.width, camera.height) != (true[name].width, true[name].height):
            raise InputError(
                f"{name} is {camera.width}x{camera.height} px in {cameras.name}, but "
                f"{true[name].width}x{true[name].height} px in {truth.name}."
            )
    for path, found in ((truth, true), (cameras, estimated)):
        for name in estimated:
            if why := why_blind(surface, found[name]):
                raise InputError(f"The camera of {name} in {path.name} {why}")
    error = projection_error(
        surface, [true[name] for name in estimated], list(estimated.values())
    )
    by_photo = dict(zip(estimated, error.cameras, strict=True))
    if json:
        print_json(
            {
                "mean_px": error.mean,
                "cameras": {
                    name: {f"{word}_px": getattr(figures, word) for word in _FIGURES}
                    for name, figures in by_photo.items()
                },
            }
        )
        return 0
    table = rich.table.Table("photo", *(f"{word} px" for word in _FIGURES))
    for name, figures in by_photo.items():
        cells = (f"{getattr(figures, word):.3f}" for word in _FIGURES)
        table.add_row(name, *cells)
    rich.console.Console(highlight=False).print(table)
    print(f"Mean projection error {error.mean:.3f} px")
    return 0


_FIGURES = ("mean", "rms", "median", "max")


def synthesize_command(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    /,
    *,
    options: Annotated[SceneOptions, tyro.conf.arg(name="")] = SceneOptions(),
) -> int:
    """Make a scene with truth: mesh, photos, true cameras and rough ones.

    Args:
        folder: A new or empty folder for the files.
        options: What the scene is.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(f"{folder} is not empty; give a new folder.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"Cannot make {folder}: {error.strerror}.") from error
    written = write_scene(make_scene(options), folder)
    log.print(f"Written: {', '.join(str(path) for path in written)}.")
    return 0


def reproduce_command(
    *, out: Path, runs: int = 10, seed: int = 0, overwrite: bool = False
) -> int:
    """Make the paper's experiment on the synthetic Shell and write a report.

    Args:
        out: Folder for report.html, report.md, results.json and the figures.
        runs: Runs of each column of the paper's Table 1.
        seed: Seed of the rough cameras and the searches.
        overwrite: Also replace files in the folder that photoreg did not make.
    """
    with progress_bar() as bar, asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, told="")
        for step in reproduce(out, runs, seed, overwrite=overwrite):
            if isinstance(step, Reproduced):
                log.print(f"Written: {', '.join(str(path) for path in step.paths)}.")
                return 0
            bar.update(task, completed=step.fraction, description=step.text)
            if stop.is_set():
                break
    log.print("Stopped; no report was written.")
    return 1


def run(argv: Sequence[str]) -> int:
    """Runs the command that ``argv`` names; returns the exit status.

    Where arguments are invalid, tyro itself prints a message and exits with status 2.
    """
    try:
        with noting_inputs():
            try:
                return tyro.extras.subcommand_cli_from_dict(
                    commands(argv),
                    prog="photoreg",
                    description="Lays photographs onto a scanned 3-D surface, precisely.",
                    args=list(argv),
                )
            finally:
                sys.stdout.flush()
    except PhotoregError as error:
        return _refused(str(error))
    except KeyboardInterrupt:
        log.print("Stopped.")
        return 1
    except BrokenPipeError:
        # The reader of the output has closed it: photoreg ... | head -1.
        _drop_output()
        return 1
    except OSError as error:
        _drop_output()
        return _refused(_in_words(error))
    except MemoryError:
        return _refused(
            "There is not enough memory for this. Give smaller photos or a coarser mesh, "
            "or close other programs."
        )


def _refused(sentence: str) -> int:
    with contextlib.suppress(OSError):
        log.print(f"photoreg: {sentence}", markup=False)
    return 2


def _in_words(error: OSError) -> str:
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return (
            "Too many files are open. Close other programs, or raise the limit "
            "(ulimit -n), and try again."
        )
    what = "The output" if error.filename is None else error.filename
    return f"{what} could not be read or written: {error.strerror or error}."


def _drop_output() -> None:
    """Discards the rest of standard output, so that closing it does not fail again."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _told(file: CameraFile) -> CameraFile:
    """Cameras whose notes were printed."""
    print_notes(file.notes)
    return file
