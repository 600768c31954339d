"""`photoreg place`: cameras found without a click."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from photoreg.cli.console import log, print_json, progress_bar
from photoreg.cli.scene import MeshPath, PhotoPaths, surface_told
from photoreg.cli.stopping import asked_to_stop
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import CameraFile, save_cameras
from photoreg.formats.cameras.registry import photos_by_name
from photoreg.formats.mark import marked_picture
from photoreg.formats.photos.read import load_photo
from photoreg.formats.writing import (
    Content,
    check_outputs,
    check_suffix,
    make_folder,
    write_files,
)
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.encoding import encode_jpeg
from photoreg.imaging.photo import Photo
from photoreg.overlay.pictures import pose_picture
from photoreg.placing.outcome import MOST_CANDIDATES, Box, Placed, PlacingStep
from photoreg.registration.find_cameras import find_cameras
from photoreg.words import nfc

Boxes = tyro.conf.UseAppendAction[
    tuple[
        Annotated[
            tuple[str, float, float, float, float],
            tyro.conf.arg(metavar="PHOTO LEFT TOP WIDTH HEIGHT"),
        ],
        ...,
    ]
]

THUMBNAIL_PX = 512


def place_command(
    mesh: MeshPath,
    photos: PhotoPaths,
    /,
    *,
    out: Path,
    box: Boxes = (),
    focal: tyro.conf.UseAppendAction[
        tuple[
            Annotated[tuple[str, float], tyro.conf.arg(metavar="PHOTO PX")],
            ...,
        ]
    ] = (),
    candidates: Path | None = None,
    seed: int = 0,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Find rough cameras without a click, by the object's outline and its colours.

    It works where the object stands before a plain background, or has a mask (the
    photo's opacity) or a box around it; and before any other where two photos or more show
    the same details. Where it is unsure it says so, writes the most likely cameras and
    ends with status 2; refine them only if they look right.

    Args:
        mesh: The scanned surface: OBJ, PLY, STL, GLB or OFF.
        photos: One or more photos: JPEG, PNG, TIFF, WebP, HEIC, AVIF, JPEG XL or RAW.
        out: Where the rough cameras go (.json).
        box: A box around the object in a photo, by file name: left, top, width and height
            in pixels. Repeat it for another photo.
        focal: The focal length of a photo in pixels, by file name, where EXIF does not give
            it. Repeat it for another photo.
        candidates: A folder for pictures of the most likely poses of each photo, up to
            three, with the mesh drawn over the photo.
        seed: Of the search that decides where outlines and colours do not. Same seed, same
            cameras.
        overwrite: Also replace files that photoreg did not make.
        json: Print how sure each camera is as JSON on standard output.
    """
    by_name = photos_by_name(photos)
    thumbnails = {
        name: [candidates / f"{path.stem}-{k + 1}.jpg" for k in range(MOST_CANDIDATES)]
        for name, path in by_name.items()
        if candidates is not None
    }
    if candidates is not None:
        make_folder(candidates)
    check_outputs(
        [
            check_suffix(out, (".json",)),
            *(p for row in thumbnails.values() for p in row),
        ],
        (mesh, *photos),
        overwrite,
    )
    focals_px = {nfc(name): focal_px for name, focal_px in focal}
    surface, pictures = _read(mesh, list(by_name.values()))
    placed = _watch(surface, pictures, box, focals_px, seed)
    if placed is None:
        log.print("Stopped. Nothing was written.")
        return 1
    for placement in placed.placements:
        log.print(placement.sentence, markup=False)
    cameras = {
        photo.name: placement.candidates[0]
        for photo, placement in zip(pictures, placed.placements, strict=True)
        if placement.candidates
    }
    if candidates is not None:
        drawn = _thumbnails(surface, pictures, placed, thumbnails)
        write_files(drawn, (mesh, *photos), overwrite)
        log.print(f"Candidates drawn in {candidates}.", markup=False)
    if cameras:
        save_cameras(out, CameraFile(cameras), overwrite)
        n = len(cameras)
        log.print(f"{n} camera{'s' * (n != 1)} written to {out}.", markup=False)
    if json:
        figures = {
            "grade": placed.grade,
            "photos": {
                photo.name: {
                    "grade": placement.grade,
                    "sentence": placement.sentence,
                    "overlap": placement.overlap,
                    "found_by": placement.how,
                    "candidates": len(placement.candidates),
                }
                for photo, placement in zip(pictures, placed.placements, strict=True)
            },
            "out": str(out) if cameras else None,
        }
        print_json(figures)
    return 0 if placed.grade == "found" else 2


def cameras_of_unplaced(
    mesh: Path, photos: Sequence[Path], boxes: Boxes, seed: int
) -> tuple[Mesh, list[Photo], list[Camera]] | None:
    """Mesh and photos from files, and the most likely cameras; prints what is unsure.

    Returns:
        None after Ctrl-C.

    Raises:
        InputError: if the camera of a photo cannot be found.
    """
    surface, pictures = _read(mesh, list(photos_by_name(photos).values()))
    log.print("No cameras were given (--cameras), so they are looked for.")
    placed = _watch(surface, pictures, boxes, {}, seed)
    if placed is None:
        log.print("Stopped. Nothing was written.")
        return None
    lost = [one.sentence for one in placed.placements if not one.candidates]
    if lost:
        raise InputError(" ".join(lost))
    for placement in placed.placements:
        doubt = "" if placement.grade == "found" else "Warning: "
        log.print(f"{doubt}{placement.sentence}", markup=False)
    return surface, pictures, [one.candidates[0] for one in placed.placements]


def _read(mesh: Path, photos: Sequence[Path]) -> tuple[Mesh, list[Photo]]:
    if not photos:
        raise InputError("Give at least 1 photo, not 0.")
    return surface_told(mesh), [load_photo(path) for path in photos]


def _watch(
    mesh: Mesh,
    photos: Sequence[Photo],
    boxes: Boxes,
    focals_px: dict[str, float],
    seed: int,
) -> Placed | None:
    """Finds cameras under a progress bar; None after Ctrl-C."""
    hints: dict[str, Box] = {nfc(name): (x, y, w, h) for name, x, y, w, h in boxes}
    events = find_cameras(mesh, photos, boxes=hints, focals_px=focals_px, seed=seed)
    with progress_bar() as bar, asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, told="")
        for event in events:
            if stop.is_set():
                return None
            if isinstance(event, PlacingStep):
                bar.update(task, completed=event.fraction, description=event.step)
            else:
                return event
    return None


def _thumbnails(
    mesh: Mesh,
    photos: Sequence[Photo],
    placed: Placed,
    targets: dict[str, list[Path]],
) -> dict[Path, Content]:
    """The surface over each photo as each candidate sees it."""
    drawn: dict[Path, Content] = {}
    for photo, placement in zip(photos, placed.placements, strict=True):
        for target, camera in zip(
            targets[photo.name], placement.candidates, strict=False
        ):
            picture = pose_picture(mesh, photo, camera, THUMBNAIL_PX)
            drawn[target] = marked_picture(encode_jpeg(picture, 85))
    return drawn
