"""`photoreg convert`: cameras of one program for another, and what that loses."""

import json as json_text
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import tyro

from photoreg.cli.console import log, print_notes
from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import CameraSet, FormatName
from photoreg.formats.cameras.registry import (
    CAMERA_FORMATS,
    camera_format,
    format_to_read,
    format_to_write,
    photos_by_name,
    read_cameras,
    write_cameras,
)
from photoreg.formats.photos.registry import PHOTO_SUFFIXES


def convert_command(
    cameras: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAMERAS")],
    /,
    *,
    out: Path,
    from_format: Annotated[FormatName | None, tyro.conf.arg(name="from")] = None,
    to_format: Annotated[FormatName | None, tyro.conf.arg(name="to")] = None,
    mesh: Path | None = None,
    photos: tuple[Path, ...] = (),
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Convert the cameras of one program for another, and say what is lost.

    The format is recognised by suffix or contents: photoreg's JSON, a COLMAP folder
    (binary, or text), nerfstudio's transforms.json, MeshLab's .mlp, a texrecon folder of
    .cam, OpenCV's .yml, Bundler's .out, Blender's .py (written only), Metashape's .xml
    (read only), a RealityScan folder of .xmp, AliceVision's .sfm (Meshroom).

    Args:
        cameras: A camera file, or a folder for COLMAP, texrecon and RealityScan.
        out: Where the cameras go; a folder for COLMAP, texrecon and RealityScan.
        from_format: The format to read, if suffix and contents leave it open.
        to_format: The format to write, if the path leaves it open.
        mesh: The mesh that the cameras look at; a MeshLab project names it.
        photos: The photos, or their folder: MeshLab may need padded copies; Bundler,
            texrecon and RealityScan their sizes.
        overwrite: Also replace files that photoreg did not make, or cannot recognise.
        json: Print what was written and lost as JSON on standard output.
    """
    source = camera_format(from_format) if from_format else format_to_read(cameras)
    target = camera_format(to_format) if to_format else format_to_write(out)
    if mesh is not None and not mesh.is_file():
        raise InputError(f"The mesh {mesh} does not exist. Check the path.")
    paths = list(_photo_files(photos))
    file = read_cameras(cameras, source.name, paths)
    saved = write_cameras(
        out,
        CameraSet(file.cameras, photos_by_name(paths), mesh),
        target.name,
        overwrite,
    )
    n = len(file.cameras)
    log.print(
        f"{n} camera{'s' * (n != 1)}, {source.name} to {target.name}. Written: "
        f"{', '.join(map(str, saved.files))}.",
        markup=False,
    )
    notes = list(file.notes)
    if not paths and source.is_of_stored_pixels != target.is_of_stored_pixels:
        notes.append(
            "The photos were not given, so it is not known whether EXIF rotates them; if "
            "it does, pass them with --photos."
        )
    print_notes(notes)
    for loss in saved.losses:
        log.print(f"Lost: {loss}", markup=False)
    if not saved.losses:
        log.print("Nothing is lost.")
    if json:
        figures = {
            "from": source.name,
            "to": target.name,
            "cameras": n,
            "files": [str(path) for path in saved.files],
            "losses": saved.losses,
        }
        json_text.dump(figures, sys.stdout, indent=1)
        sys.stdout.write("\n")
    return 0


def _formats_in_words() -> str:
    """What each format keeps and loses, one line each, as in the Export tab."""
    return "\n".join(
        f"    - {name}: {known.in_words}" for name, known in CAMERA_FORMATS.items()
    )


# The registry knows best what its formats lose.
convert_command.__doc__ = (convert_command.__doc__ or "").replace(
    "\n\n    Args:", f"\n\n{_formats_in_words()}\n\n    Args:"
)


def _photo_files(photos: Iterable[Path]) -> Iterable[Path]:
    """The photos given, and those in the folders given."""
    for path in photos:
        if path.is_dir():
            yield from sorted(
                p for p in path.iterdir() if p.suffix.lower() in PHOTO_SUFFIXES
            )
        elif path.is_file():
            yield path
        else:
            raise InputError(f"The photo {path} does not exist. Check the path.")
