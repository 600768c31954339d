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
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

import rich.console
import rich.progress
import rich.table
import tyro

from photoreg.checks import noting_inputs
from photoreg.cli.app import app_command
from photoreg.cli.batch import make_batch_command
from photoreg.cli.convert import convert_command
from photoreg.cli.stopping import asked_to_stop
from photoreg.cli.undistort import undistort_command
from photoreg.errors import InputError, OutputError, PhotoregError
from photoreg.formats.cameras.cameras_json import CameraFile, save_cameras
from photoreg.formats.cameras.registry import read_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.encode_texture import PictureKind, encode_picture
from photoreg.formats.models.registry import save_textured, textured_files
from photoreg.formats.writing import Content, check_outputs, check_suffix
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import N_SAMPLES, projection_error
from photoreg.geometry.unseen import why_unseen
from photoreg.geometry.visibility import samples_for, seen_points
from photoreg.imaging.pairs import pairs_in_words
from photoreg.imaging.photo import Photo
from photoreg.paper.reproduce import Reproduced, reproduce
from photoreg.parameters.freedom import Freedom
from photoreg.registration.attempts import refine_in_attempts
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.scene_files import cropped_by_exif, load_scene
from photoreg.registration.world import (
    in_world_of_mesh,
    judge,
    why_convincing_elsewhere,
    why_of_another_world,
)
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene, write_scene
from photoreg.texture.bake import BakingStep, TexturedMesh, baking
from photoreg.texture.config import TextureConfig
from photoreg.words import listed, nfc, percent

MeshPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
PhotoPaths = Annotated[
    tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PHOTO")
]

_log = rich.console.Console(stderr=True, highlight=False, soft_wrap=True)


def commands(argv: Sequence[str] = ()) -> dict[str, Callable[..., int]]:
    """The commands by name; the defaults of `refine` and `batch` are those of argv's --preset."""
    preset = RegistrationConfig.preset(_preset(argv))
    return {
        "app": app_command,
        "refine": _refine_command(preset),
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
        only: tuple[str, ...] = (),
        lock: tuple[str, ...] = (),
        lock_focal: tuple[str, ...] = (),
        lock_principal_point: tuple[str, ...] = (),
        lock_pose: tuple[str, ...] = (),
        lock_distortion: tuple[str, ...] = (),
        share_focal: tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]] = (),
        cropped: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
        overwrite: bool = False,
        json: bool = False,
        config: Annotated[RegistrationConfig, tyro.conf.arg(name="")] = preset,
    ) -> int:
        """Refine rough cameras until the photos agree over the whole surface.

        One photo is compared with the surface itself, by its shading and outline. Where
        the answer does not convince, a second attempt searches wider.

        Ctrl-C writes the best cameras found so far.

        Args:
            mesh: The scanned surface: OBJ, PLY, STL, GLB or OFF.
            photos: One or more photos: JPEG, PNG, TIFF, WebP, HEIC, AVIF, JPEG XL or RAW.
            cameras: Rough cameras to start from, in any format that `photoreg convert` reads.
            out: Where the refined cameras go (.json).
            preset: What the options below default to: default; fast, for a quick look;
                thorough, for very rough starts; paper, the paper's genetic algorithm.
            only: Photos, by file name, to refine, as those that were added to a finished
                set: all others stay as they are, to the last bit.
            lock: Photos, by file name, whose cameras are right and stay as they are;
                the others are registered against them.
            lock_focal: Photos whose focal length stays as it is.
            lock_principal_point: Photos whose principal point stays as it is.
            lock_pose: Photos whose camera keeps its position and rotation.
            lock_distortion: Photos whose lens distortion stays as the cameras have it.
            share_focal: Photos taken with one camera at one zoom: they get one focal
                length, and one lens. No names: all photos. Repeat it for another camera.
            cropped: Photos of which a part was cut off after they were taken, so that
                their principal points may be far off the middle. Repeat it for another;
                those whose EXIF tells it are known.
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
            lock=_all_but(only, lock, names),
            lock_focal=lock_focal,
            lock_principal_point=lock_principal_point,
            lock_pose=lock_pose,
            lock_distortion=lock_distortion,
            share_focal=share_focal,
            cropped=[*cropped, *_cropped_by_exif(pictures, cropped)],
        )
        last, interrupted = _watch(surface, pictures, start, config, freedom)
        best = dict(zip(names, last.cameras, strict=True))
        asked_for, out = out, _save_somewhere(out, file.with_cameras(best), overwrite)
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
            if last.mesh_error is not None:
                _log.print(last.mesh_error.in_words(surface.diagonal))
            if told := pairs_in_words(names, last.pairs):
                _log.print(told)
        if json:
            figures = {
                field.name: getattr(last, field.name)
                for field in dataclasses.fields(last)
                if field.name not in ("cameras", "population", "checkpoint")
            }
            if isinstance(last, Finished):
                figures["expected_error_px"] = last.expected_error_px
                figures["mesh_error"] = last.mesh_error and dataclasses.asdict(
                    last.mesh_error
                )
                figures["verdict"] = last.verdict and dataclasses.asdict(last.verdict)
                figures["pairs"] = [(names[i], names[k]) for i, k in last.pairs]
            _print_json({**figures, "stopped": interrupted, "out": str(out)})
        if out != asked_for:
            return 2
        return 1 if interrupted else 0

    return refine_command


def _cropped_by_exif(photos: Sequence[Photo], named: Sequence[str]) -> list[str]:
    """Names of photos that EXIF shows to be cropped and nobody named; each is told."""
    names = cropped_by_exif(photos, named)
    for name in names:
        _log.print(
            f"Note: {name} was cropped, as its EXIF tells; its principal point may be far "
            "off the middle.",
            markup=False,
        )
    return names


def _all_but(
    only: Sequence[str], lock: Sequence[str], names: Sequence[str]
) -> tuple[str, ...]:
    """The photos to lock, where only some are to be refined."""
    if not only:
        return tuple(lock)
    # Names are compared in one form of Unicode, as photos have them.
    only = [nfc(name) for name in only]
    for name in only:
        if name not in names:
            raise InputError(
                f"There is no photo {name} to refine; there are {', '.join(names)}."
            )
    both = [name for name in only if name in {nfc(name) for name in lock}]
    if both:
        raise InputError(
            f"{listed(both)} cannot be both refined (--only) and locked (--lock)."
        )
    return (*lock, *(name for name in names if name not in only))


def _save_somewhere(out: Path, file: CameraFile, overwrite: bool) -> Path:
    """Writes cameras that took long to find; returns where to.

    If they cannot be written to ``out`` any more, because somebody else's file is there
    by now or the folder is gone, they go beside it under a free name, or elsewhere.

    Raises:
        OutputError: if they can be written nowhere.
    """
    try:
        save_cameras(out, file, overwrite)
    except OutputError as error:
        for folder in (out.parent, Path.cwd(), Path(tempfile.gettempdir())):
            for number in range(2, 100):
                beside = folder / f"{out.stem}-{number}{out.suffix}"
                if os.path.lexists(beside):
                    continue
                with contextlib.suppress(OutputError):
                    save_cameras(beside, file)
                    _log.print(
                        f"{error} The cameras were written to {beside} instead.",
                        markup=False,
                    )
                    return beside
                break
        raise
    return out


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
    surface = _surface(mesh)
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
            if why := _why_blind(surface, found[name]):
                raise InputError(f"The camera of {name} in {path.name} {why}")
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


def _why_blind(surface: Mesh, camera: Camera) -> str:
    """Why a camera sees nothing of the surface; empty where it sees some."""
    points = samples_for(surface, [camera], N_SAMPLES, seed=0).points
    if seen_points(surface, camera, points).any():
        return ""
    return f"sees nothing of {surface.name}. {why_unseen(surface, [camera])}"


LITTLE_SEEN = 0.1
"""A texture that covers less of the surface is told as what may be a fault."""

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
        cameras: Their refined cameras, in any format that `photoreg convert` reads.
        out: Where the model goes: .glb, all in one file; .obj, with MTL and PNG beside
            it; .ply, with a PNG.
        at_vertices: For .ply: colours at the vertices instead of a texture.
        picture: The texture as PNG, or as JPEG, which is several times smaller.
        coverage: Also write a picture (.png) of which photo each texel is from (hue) and
            how well it is seen (brightness).
        overwrite: Also replace files that photoreg did not make.
        config: How the texture is made.
        json: Print the figures as JSON on standard output.
    """
    targets = textured_files(out, at_vertices, picture)
    if coverage is not None:
        targets.append(check_suffix(coverage, (".png",)))
    check_outputs(targets, (mesh, *photos, cameras), overwrite)
    surface, pictures, _, exact = _load_scene(mesh, photos, cameras)
    verdict = judge(surface, pictures, exact)
    why = why_of_another_world(surface, pictures, exact)
    if why is None and verdict.grade != "convincing":
        why = why_convincing_elsewhere(surface, pictures, exact)
    if why is not None:
        raise InputError(why)
    # Once more: the mesh may have named a material and a texture of its own.
    check_outputs(targets, (mesh, *photos, cameras), overwrite)
    began = time.perf_counter()
    with _bar() as bar, asked_to_stop() as stop:
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
    beside: dict[Path, Content] = {}
    if coverage is not None:
        beside[coverage] = encode_picture(textured.coverage_picture())
    written = save_textured(out, textured, at_vertices, picture, overwrite, beside)
    elapsed_s = time.perf_counter() - began
    height, width = textured.texture.shape[:2]
    _log.print(
        f"{percent(textured.seen_share)} of the surface is seen by a photo "
        f"({_shares(pictures, textured)}). Texture "
        f"{width}x{height}, {textured.layout_in_words}, {elapsed_s:.1f} s. "
        f"Written: {', '.join(str(path) for path in written)}."
    )
    if not verdict.is_credible:
        _log.print(f"Warning: {verdict.sentence}", markup=False)
    if textured.seen_share < LITTLE_SEEN:
        _log.print(
            "Warning: little of the surface is seen. If the photos show more of it, cameras "
            "and mesh are not of one world: check the axes, the units and the origin of both."
        )
    if told := _left_out(pictures, textured):
        _log.print(told)
    for photo, camera, share in zip(
        pictures, exact, textured.seen_share_by_photo, strict=True
    ):
        if share == 0.0 and (why := _why_blind(surface, camera)):
            _log.print(f"Warning: the camera of {photo.name} {why}", markup=False)
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
                "left_out_share_by_photo": dict(
                    zip(
                        (photo.name for photo in pictures),
                        textured.left_out_share_by_photo,
                        strict=True,
                    )
                ),
                "elapsed_s": elapsed_s,
            }
        )
    return 0


def _shares(photos: Sequence[Photo], textured: TexturedMesh) -> str:
    shares = zip(photos, textured.seen_share_by_photo, strict=True)
    return ", ".join(f"{photo.name} {percent(share)}" for photo, share in shares)


def _left_out(photos: Sequence[Photo], textured: TexturedMesh) -> str:
    """What was not painted because other photos disagree; empty if nothing."""
    shares = zip(photos, textured.left_out_share_by_photo, strict=True)
    parts = [f"{photo.name} {percent(share)}" for photo, share in shares if share > 0.0]
    if not parts:
        return ""
    return (
        "Not painted, because other photos show something else there, as where something "
        f"stands before the object, of what each photo sees: {', '.join(parts)}."
    )


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
        seed: Seed of the rough cameras and the searches.
        overwrite: Also replace files in the folder that photoreg did not make.
    """
    with _bar() as bar, asked_to_stop() as stop:
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
            "or close other programs."
        )


def _refused(sentence: str) -> int:
    with contextlib.suppress(OSError):
        _log.print(f"photoreg: {sentence}", markup=False)
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


def _load_scene(
    mesh: Path, photos: Sequence[Path], cameras: Path
) -> tuple[Mesh, list[Photo], CameraFile, list[Camera]]:
    scene = load_scene(mesh, photos, cameras)
    _print_notes(scene.notes)
    return scene.mesh, list(scene.photos), scene.file, list(scene.cameras)


def _told(file: CameraFile) -> CameraFile:
    """Cameras whose notes were printed."""
    _print_notes(file.notes)
    return file


def _surface(path: Path) -> Mesh:
    """The mesh of a file; prints a note for each thing that was left out."""
    surface = load_mesh(path)
    _print_notes(f"{surface.name}: {note}" for note in surface.notes)
    return surface


def _print_notes(notes: Iterable[str]) -> None:
    for note in notes:
        _log.print(f"Note: {note}", markup=False)


def _watch(
    mesh: Mesh,
    photos: Sequence[Photo],
    start: Sequence[Camera],
    config: RegistrationConfig,
    freedom: Freedom,
) -> tuple[Progress | Finished, bool]:
    """Runs a refinement under a progress bar; its last event, and whether Ctrl-C came."""
    with _bar() as bar, asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, cost="")
        event = None
        for event in refine_in_attempts(mesh, photos, start, config, freedom):
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


def _print_json(figures: dict[str, Any]) -> None:
    json.dump(figures, sys.stdout, indent=1)
    print()
