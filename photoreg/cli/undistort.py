"""`photoreg undistort`: photos and cameras for programs that know no lenses."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from photoreg.cli.console import log
from photoreg.errors import InputError
from photoreg.formats.cameras.cameras_json import CameraFile, dump_cameras
from photoreg.formats.cameras.registry import photos_by_name, read_cameras
from photoreg.formats.mark import marked_picture
from photoreg.formats.photos.read import load_photo
from photoreg.formats.writing import Content, check_outputs, make_folder, write_files
from photoreg.imaging.encoding import encode
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo


def undistort_command(
    photos: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PHOTO")
    ],
    /,
    *,
    cameras: Path,
    out: Path,
    overwrite: bool = False,
) -> int:
    """Write photos as ideal lenses would have taken them, and their cameras.

    The photos keep their size, so focal length, principal point and pose stay as they
    are; what no pixel of the photo shows is transparent.

    Args:
        photos: The photos.
        cameras: Their cameras with lenses, in any format that `photoreg convert` reads.
        out: A folder: for the photos as PNG, and cameras.json.
        overwrite: Also replace files that photoreg did not make.
    """
    if not photos:
        raise InputError("Give at least 1 photo.")
    targets = [out / f"{path.stem}.png" for path in photos]
    twice = [path.name for path in targets if targets.count(path) > 1]
    if twice:
        raise InputError(
            f"Two photos would become {twice[0]}; they should differ in more than their "
            "suffix."
        )
    make_folder(out)
    check_outputs([*targets, out / "cameras.json"], (*photos, cameras), overwrite)
    file = read_cameras(cameras, photos=photos_by_name(photos))
    pictures = [load_photo(path) for path in photos]
    contents: dict[Path, Content] = {}
    ideal = {}
    for photo, camera, target in zip(
        pictures, file.of_photos(pictures), targets, strict=True
    ):
        contents[target] = _png(undistorted_photo(photo, camera))
        ideal[target.name] = camera.pinhole
        log.print(f"{photo.name}: lens {camera.lens.in_words()}.", markup=False)
    contents[out / "cameras.json"] = dump_cameras(CameraFile(ideal))
    written = write_files(contents, (*photos, cameras), overwrite)
    log.print(f"Written: {', '.join(map(str, written))}.", markup=False)
    return 0


def _png(photo: Photo) -> bytes:
    pixels = photo.pixels
    if photo.mask is not None:
        alpha = np.where(photo.mask, np.uint8(255), np.uint8(0))
        pixels = np.dstack([pixels, alpha])
    return marked_picture(encode(pixels, ".png"))
