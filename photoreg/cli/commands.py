"""The command line: files in, files out, figures on request.

Exit status 0: done. 1: stopped early or crashed. 2: bad input, in one sentence.
"""

import contextlib
import dataclasses
import errno
import itertools
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

import rich.console
import rich.progress
import rich.table
import tyro

from photoreg.checks import noting_inputs
from photoreg.cli.app import app_command
from photoreg.cli.convert import convert_command
from photoreg.errors import InputError, OutputError, PhotoregError
from photoreg.formats.cameras.cameras_json import CameraFile, save_cameras
from photoreg.formats.cameras.registry import photos_by_name, read_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.encode_texture import PictureKind, encode_picture
from photoreg.formats.models.registry import save_textured, textured_files
from photoreg.formats.photos.read import load_photo
from photoreg.formats.writing import check_outputs, check_suffix, write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.imaging.photo import Photo
from photoreg.paper.reproduce import Reproduced, reproduce
from photoreg.parameters.freedom import Freedom
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene, write_scene
from photoreg.texture.bake import BakingStep, TexturedMesh, baking
from photoreg.texture.blend import TextureConfig

MeshPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
PhotoPaths = Annotated[
    tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PHOTO")
]

_log = rich.console.Console(stderr=True, highlight=False, soft_wrap=True)


def commands(argv: Sequence[str] = ()) -> dict[str, Callable[..., int]]:
    """The commands by name; the defaults of `refine` are those of argv's --preset."""
    return {
        "app": app_command,
        "refine": _refine_command(RegistrationConfig.preset(_preset(argv))),
        "evaluate": evaluate_command,
        "texture": texture_command,
        "convert": convert_command,
        "synthesize": synthesize_command,
        "reproduce": reproduce_command,
    }


def _preset(argv: Sequence[str]) -> PresetName:
    """The preset that argv names.

    It decides other options' defaults, so it is looked for before tyro reads the rest
    and refuses what is not a preset.
    """
    pairs = set(itertools.pairwise(argv))
    for name in get_args(PresetName):
        if f"--preset={name}" in argv or ("--preset", name) in pairs:
            return name
    return "default"


def _refine_command(preset: RegistrationConfig) -> Callable[..., int]:
    def refine_command(
        mesh: MeshPath,
        photos: PhotoPaths,
        /,
        *,
        cameras: Path,
        out: Path,
        preset: PresetName = "default",
        lock: tuple[str, ...] = (),
        lock_focal: tuple[str, ...] = (),
        lock_principal_point: tuple[str, ...] = (),
        lock_pose: tuple[str, ...] = (),
        share_focal: tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]] = (),
        overwrite: bool = False,
        json: bool = False,
        config: Annotated[RegistrationConfig, tyro.conf.arg(name="")] = preset,
    ) -> int:
        """Refine rough cameras until the photos agree over the whole surface.

        Ctrl-C writes the best cameras found so far.

        Args:
            mesh: The scanned surface: OBJ, PLY, STL, GLB or OFF.
            photos: Two or more photos: JPEG, PNG, TIFF, WebP, HEIC, AVIF, JPEG XL or RAW.
            cameras: Rough cameras to start from, in any format of `photoreg convert`.
            out: Where the refined cameras go (.json).
            preset: Where the options below start from: default; fast, for a look;
                thorough, for very rough starts; paper, the paper's genetic algorithm.
            lock: Photos, by file name, whose cameras are right and stay as they are;
                the others are registered against them.
            lock_focal: Photos whose focal length stays as it is.
            lock_principal_point: Photos whose principal point stays as it is.
            lock_pose: Photos whose camera stays where it stands and as it is turned.
            share_focal: Photos taken with one camera at one zoom: they get one focal
                length. No names: all photos. Repeat it for another camera.
            overwrite: Also replace a file that photoreg did not make.
            json: Print the figures as JSON on standard output.
            config: How to refine.
        """
        del preset  # `config` began as it.
        check_outputs(
            [check_suffix(out, (".json",))], (mesh, *photos, cameras), overwrite
        )
        surface, pictures, file, start = _load_scene(mesh, photos, cameras)
        names = [photo.name for photo in pictures]
        freedom = Freedom.of_photos(
            names,
            lock=lock,
            lock_focal=lock_focal,
            lock_principal_point=lock_principal_point,
            lock_pose=lock_pose,
            share_focal=share_focal,
        )
        last, interrupted = _watch(surface, pictures, start, config, freedom)
        best = dict(zip(names, last.cameras, strict=True))
        save_cameras(out, file.with_cameras(best), overwrite)
        if interrupted:
            _log.print(f"Stopped. The best cameras so far are in {out}.")
        if isinstance(last, Finished):
            for warning in last.warnings:
                _log.print(f"Warning: {warning}")
            _log.print(
                f"Cost {last.start_cost:.4g} -> {last.cost:.4g} in "
                f"{last.elapsed_s:.1f} s. {last.reason} Cameras written to {out}."
            )
            if last.verdict is not None and last.verdict.is_credible:
                _log.print(last.verdict.sentence)
            for sentence in (*last.standard_errors, *last.undetermined):
                _log.print(sentence)
        if json:
            figures = {
                field.name: getattr(last, field.name)
                for field in dataclasses.fields(last)
                if field.name not in ("cameras", "population", "checkpoint")
            }
            if isinstance(last, Finished):
                figures["expected_error_px"] = last.expected_error_px
                figures["verdict"] = last.verdict and dataclasses.asdict(last.verdict)
            _print_json({**figures, "stopped": interrupted, "out": str(out)})
        return 1 if interrupted else 0

    return refine_command


def evaluate_command(
    mesh: MeshPath, /, *, cameras: Path, truth: Path, json: bool = False
) -> int:
    """Measure cameras against the true ones: projection error in pixels.

    The paper's equation 5, over surface points visible in the true camera.

    Args:
        mesh: The scanned surface.
        cameras: The cameras to judge, in any format of `photoreg convert`.
        truth: The true cameras; photos are matched by name.
        json: Print the figures as JSON on standard output.
    """
    surface = _surface(mesh)
    estimated, true = read_cameras(cameras).cameras, read_cameras(truth).cameras
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
    error = projection_error(
        surface, [true[name] for name in estimated], list(estimated.values())
    )
    by_photo = dict(zip(estimated, error.cameras, strict=True))
    if json:
        _print_json(
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


def texture_command(
    mesh: MeshPath,
    photos: PhotoPaths,
    /,
    *,
    cameras: Path,
    out: Path,
    at_vertices: bool = False,
    picture: PictureKind = "png",
    coverage: Path | None = None,
    overwrite: bool = False,
    config: Annotated[TextureConfig, tyro.conf.arg(name="")] = TextureConfig(),
    json: bool = False,
) -> int:
    """Lay the photos onto the mesh: a textured OBJ, GLB or PLY.

    Args:
        mesh: The scanned surface.
        photos: The photos to lay onto it.
        cameras: Their refined cameras, in any format of `photoreg convert`.
        out: Where the model goes: .glb, all in one file; .obj, with MTL and PNG beside
            it; .ply, with a PNG.
        at_vertices: For .ply: colours at the vertices instead of a texture.
        picture: The texture as PNG, or as JPEG, which is several times smaller.
        coverage: Also draw here (.png) which photo each texel is from, by hue, and how
            well it is seen, by brightness.
        overwrite: Also replace files that photoreg did not make.
        config: How the texture is made.
        json: Print the figures as JSON on standard output.
    """
    targets = textured_files(out, at_vertices, picture)
    if coverage is not None:
        targets.append(check_suffix(coverage, (".png",)))
    check_outputs(targets, (mesh, *photos, cameras), overwrite)
    surface, pictures, _, exact = _load_scene(mesh, photos, cameras, at_least=1)
    # Once more: the mesh may have named a material and a texture of its own.
    check_outputs(targets, (mesh, *photos, cameras), overwrite)
    began = time.perf_counter()
    with _bar() as bar, _asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, cost="")
        textured = None
        for textured in baking(surface, pictures, exact, config):
            if isinstance(textured, BakingStep):
                bar.update(
                    task, completed=textured.fraction, description=textured.title
                )
                if stop.is_set():
                    _log.print("Stopped. Nothing was written.")
                    return 1
    assert isinstance(textured, TexturedMesh)
    written = save_textured(out, textured, at_vertices, picture, overwrite)
    if coverage is not None:
        shown = encode_picture(textured.coverage_picture())
        written += write_files({coverage: shown}, overwrite=overwrite)
    elapsed_s = time.perf_counter() - began
    height, width = textured.texture.shape[:2]
    _log.print(
        f"{textured.seen_share:.0%} of the surface is seen by a photo "
        f"({_shares(pictures, textured)}). Texture "
        f"{width}x{height}, {textured.layout_in_words}, {elapsed_s:.1f} s. "
        f"Written: {', '.join(str(path) for path in written)}."
    )
    if json:
        _print_json(
            {
                "files": [str(path) for path in written],
                "texture": [width, height],
                "own_uv": textured.atlas.is_own,
                "seen_share": textured.seen_share,
                "seen_share_by_photo": dict(
                    zip(
                        (photo.name for photo in pictures),
                        textured.seen_share_by_photo,
                        strict=True,
                    )
                ),
                "elapsed_s": elapsed_s,
            }
        )
    return 0


def _shares(photos: Sequence[Photo], textured: TexturedMesh) -> str:
    shares = zip(photos, textured.seen_share_by_photo, strict=True)
    return ", ".join(f"{photo.name} {share:.0%}" for photo, share in shares)


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
    _log.print(f"Written: {', '.join(str(path) for path in written)}.")
    return 0


def reproduce_command(
    *, out: Path, runs: int = 10, seed: int = 0, overwrite: bool = False
) -> int:
    """Make the paper's experiment on the synthetic Shell and write a report.

    Args:
        out: Folder for report.html, report.md, results.json and the figures.
        runs: Runs of each column of the paper's Table 1.
        seed: Of the rough cameras and the searches.
        overwrite: Also replace files in the folder that photoreg did not make.
    """
    with _bar() as bar, _asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, cost="")
        for step in reproduce(out, runs, seed, overwrite=overwrite):
            if isinstance(step, Reproduced):
                _log.print(f"Written: {', '.join(str(path) for path in step.paths)}.")
                return 0
            bar.update(task, completed=step.fraction, description=step.text)
            if stop.is_set():
                break
    _log.print("Stopped; no report was written.")
    return 1


def run(argv: Sequence[str]) -> int:
    """Runs the command that ``argv`` names; returns the exit status.

    tyro itself ends with status 2 and its message where the words are off.
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
        _log.print("Stopped.")
        return 1
    except BrokenPipeError:
        # Whoever read the output has seen enough of it: photoreg ... | head -1.
        _drop_output()
        return 1
    except OSError as error:
        _drop_output()
        return _refused(_in_words(error))
    except MemoryError:
        return _refused(
            "There is not enough memory for this. Give smaller photos or a coarser mesh, "
            "or end other programs."
        )


def _refused(sentence: str) -> int:
    with contextlib.suppress(OSError):
        _log.print(f"photoreg: {sentence}", markup=False)
    return 2


def _in_words(error: OSError) -> str:
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return (
            "Too many files are open. End other programs, or raise the limit "
            "(ulimit -n), and try again."
        )
    what = "The output" if error.filename is None else error.filename
    return f"{what} could not be read or written: {error.strerror or error}."


def _drop_output() -> None:
    """Lets what is left of standard output go nowhere, lest its end fails once more."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _load_scene(
    mesh: Path, photos: Sequence[Path], cameras: Path, at_least: int = 2
) -> tuple[Mesh, list[Photo], CameraFile, list[Camera]]:
    if len(photos) < at_least:
        raise InputError(
            f"Give at least {at_least} photo{'s' * (at_least > 1)}; {len(photos)} came."
        )
    file = read_cameras(cameras, photos=photos_by_name(photos))
    for note in file.notes:
        _log.print(f"Note: {note}", markup=False)
    surface = _surface(mesh)
    pictures = [load_photo(path) for path in photos]
    return surface, pictures, file, file.of_photos(pictures)


def _surface(path: Path) -> Mesh:
    """The mesh of a file; what of it was left out is told."""
    surface = load_mesh(path)
    for note in surface.notes:
        _log.print(f"Note: {surface.name}: {note}", markup=False)
    return surface


def _watch(
    mesh: Mesh,
    photos: Sequence[Photo],
    start: Sequence[Camera],
    config: RegistrationConfig,
    freedom: Freedom,
) -> tuple[Progress | Finished, bool]:
    """Runs a refinement under a progress bar; its last event, and whether Ctrl-C came."""
    with _bar() as bar, _asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, cost="")
        event = None
        for event in refine(mesh, photos, start, config, freedom):
            if isinstance(event, Progress) and math.isfinite(event.best_cost):
                bar.update(
                    task,
                    completed=event.fraction,
                    description=event.step,
                    cost=f"cost {event.best_cost:.4g}",
                )
            if stop.is_set():
                break
    assert event is not None  # The last event of every refinement is its end.
    return event, stop.is_set() and not isinstance(event, Finished)


def _bar() -> rich.progress.Progress:
    return rich.progress.Progress(
        rich.progress.TextColumn("{task.description}"),
        rich.progress.BarColumn(),
        rich.progress.TaskProgressColumn(),
        rich.progress.TextColumn("{task.fields[cost]}"),
        rich.progress.TimeRemainingColumn(),
        console=_log,
        transient=True,
    )


@contextlib.contextmanager
def _asked_to_stop() -> Iterator[threading.Event]:
    """An event that Ctrl-C sets; a second Ctrl-C interrupts at once.

    An exception raised by the signal itself would land in the middle of compiled
    code, which cannot pass it on.
    """
    asked = threading.Event()
    previous = signal.getsignal(signal.SIGINT)

    def ask(*_: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, previous)


def _print_json(figures: dict[str, Any]) -> None:
    json.dump(figures, sys.stdout, indent=1)
    print()
