"""`photoreg refine`."""

import contextlib
import dataclasses
import math
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import tyro

from photoreg.cli.console import log, print_json, progress_bar
from photoreg.cli.place import Boxes, cameras_of_unplaced
from photoreg.cli.scene import MeshPath, PhotoPaths, load_told
from photoreg.cli.stopping import asked_to_stop
from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.cameras_json import CameraFile, save_cameras
from photoreg.formats.writing import check_outputs, check_suffix
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.pairs import pairs_in_words
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.registration.attempts import refine_in_attempts
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.scene_files import cropped_by_exif
from photoreg.words import listed, nfc


def make_refine_command(preset: RegistrationConfig) -> Callable[..., int]:
    """The command, with the defaults of a preset."""

    def refine_command(
        mesh: MeshPath,
        photos: PhotoPaths,
        /,
        *,
        out: Path,
        cameras: Path | None = None,
        box: Boxes = (),
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
            out: Where the refined cameras go (.json).
            cameras: Rough cameras to start from, in any format that `photoreg convert` reads.
                Without them they are found first, as by `photoreg place`.
            box: Where there are no cameras: a box around the object in a photo, by file
                name: left, top, width and height in pixels. Repeat it for another photo.
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
                those whose EXIF shows it are known.
            overwrite: Also replace a file that photoreg did not make.
            json: Print the figures as JSON on standard output.
            config: How to refine.
        """
        del preset  # `config` began as it.
        read = (mesh, *photos) if cameras is None else (mesh, *photos, cameras)
        check_outputs([check_suffix(out, (".json",))], read, overwrite)
        if cameras is None:
            locks = (lock, lock_focal, lock_principal_point, lock_pose, lock_distortion)
            if only or any(locks):
                raise InputError(
                    "Without --cameras there is nothing that --only or --lock could keep; "
                    "give the cameras that are right."
                )
            found = cameras_of_unplaced(mesh, photos, box, config.seed)
            if found is None:
                return 1
            surface, pictures, start = found
            file = CameraFile({})
        elif box:
            raise InputError(
                "--box is a hint for finding cameras; leave out --cameras to find them."
            )
        else:
            surface, pictures, file, start = load_told(mesh, photos, cameras)
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
            log.print(f"Stopped. The best cameras so far are in {out}.")
        if isinstance(last, Finished):
            for warning in last.warnings:
                log.print(f"Warning: {warning}")
            log.print(
                f"Cost {last.start_cost:.4g} -> {last.cost:.4g} in "
                f"{last.elapsed_s:.1f} s. {last.reason} Cameras written to {out}."
            )
            if last.verdict is not None and last.verdict.is_credible:
                log.print(last.verdict.sentence)
            for sentence in (*last.standard_errors, *last.undetermined):
                log.print(sentence)
            if last.mesh_error is not None:
                log.print(last.mesh_error.in_words(surface.diagonal))
            if told := pairs_in_words(names, last.pairs):
                log.print(told)
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
            print_json({**figures, "stopped": interrupted, "out": str(out)})
        if out != asked_for:
            return 2
        return 1 if interrupted else 0

    return refine_command


def _cropped_by_exif(photos: Sequence[Photo], named: Sequence[str]) -> list[str]:
    """Names of photos that EXIF shows to be cropped and nobody named; prints each."""
    names = cropped_by_exif(photos, named)
    for name in names:
        log.print(
            f"Note: {name} was cropped, as its EXIF shows; its principal point may be far "
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
    """Writes cameras that took long to find; returns the path.

    If they can no longer be written to ``out``, because another file is there by now or
    the folder is gone, they go beside it under a free name, or elsewhere.

    Raises:
        OutputError: if they cannot be written anywhere.
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
                    log.print(
                        f"{error} The cameras were written to {beside} instead.",
                        markup=False,
                    )
                    return beside
                break
        raise
    return out


def _watch(
    mesh: Mesh,
    photos: Sequence[Photo],
    start: Sequence[Camera],
    config: RegistrationConfig,
    freedom: Freedom,
) -> tuple[Progress | Finished, bool]:
    """Runs a refinement under a progress bar; its last event, and whether it was stopped."""
    with progress_bar() as bar, asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, told="")
        event = None
        for event in refine_in_attempts(mesh, photos, start, config, freedom):
            if isinstance(event, Progress) and math.isfinite(event.best_cost):
                bar.update(
                    task,
                    completed=event.fraction,
                    description=event.step,
                    told=f"cost {event.best_cost:.4g}",
                )
            if stop.is_set():
                break
    assert event is not None  # The last event of every refinement is its end.
    return event, stop.is_set() and not isinstance(event, Finished)
