"""texrecon's .cam files (MVE, mvs-texturing): one beside each photo, with its stem.

"tx ty tz R00 ... R22", world to camera in OpenCV's axes, then "f d0 d1 aspect ppx
ppy": the focal length by the photo's larger side as seen (pixels fy / fx high), the
principal point as shares of width and height, from the corner of the first pixel.
The file holds neither the photo's suffix nor its size: both come from the photo.

References:
    CameraInfo::fill_calibration in MVE; TextureView::get_pixel_coords in
    mvs-texturing, which takes 0.5 off the pixels.
"""

from collections.abc import Iterator
from pathlib import Path

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import (
    CameraSet,
    Saved,
    cameras_by_name,
    files_by_stem,
    intrinsics,
    without,
)
from photoreg.formats.cameras.lens_terms import refuse_distortion
from photoreg.formats.mark import COMMENT
from photoreg.formats.parsing import (
    camera_of,
    numbers,
    read_text,
)
from photoreg.formats.photos.files import photo_beside, stored_size
from photoreg.formats.writing import Content, make_folder, write_files
from photoreg.geometry.camera import Camera


def save_texrecon(folder: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    """Writes a .cam for each photo, and copies of the photos that are known.

    Raises:
        OutputError: if they cannot be written there, or two photos differ in their
            suffix only.
    """
    contents: dict[Path, Content] = {}
    losses = []
    for path, name in files_by_stem(folder, cameras, ".cam", "texrecon").items():
        camera = cameras.cameras[name]
        camera, lost = without(name, camera, "texrecon", "skew", lens_terms=())
        losses += lost
        K, (width, height) = camera.K, (camera.width, camera.height)
        aspect = K[1, 1] / K[0, 0]
        is_portrait = width / height * aspect < 1.0
        focal = K[1, 1] / height if is_portrait else K[0, 0] / width
        ppx, ppy = (K[0, 2] + 0.5) / width, (K[1, 2] + 0.5) / height
        rows = (
            [*camera.t_cam_world, *camera.R_cam_world.ravel()],
            [focal, 0.0, 0.0, aspect, ppx, ppy],
        )
        lines = [" ".join(repr(float(v)) for v in row) for row in rows]
        # Readers take two lines, and leave a third.
        contents[path] = "\n".join([*lines, f"# {COMMENT}", ""])
    make_folder(folder)
    contents |= cameras.copies_in(folder)
    return Saved(write_files(contents, cameras.files, overwrite), losses)


def load_texrecon(folder: Path, photos: dict[str, Path]) -> dict[str, Camera]:
    """Reads every .cam of a folder whose photo is among ``photos`` or beside it.

    Raises:
        InputError: if there is none, one is not valid or has lens distortion, or its
            photo is not found.
    """
    paths = sorted(folder.glob("*.cam")) if folder.is_dir() else [folder]
    return cameras_by_name(_cameras(paths, photos), folder.name)


def _cameras(
    paths: list[Path], photos: dict[str, Path]
) -> Iterator[tuple[str, Camera]]:
    for path in paths:
        where = path.name
        lines = read_text(path, "camera file", max_mb=0.01).split("\n")
        pose = numbers(lines[0].split(), 12, where, "the first line (t, R)")
        second = lines[1].split() if len(lines) > 1 else []
        lens = numbers(second, (1, 3, 4, 6), where, "the second line (f d0 d1 ...)")
        lens += [0.0, 0.0, 0.0, 1.0, 0.5, 0.5][len(lens) :]
        focal, d0, d1, aspect, ppx, ppy = lens
        refuse_distortion((d0, d1), where)
        if not aspect > 0.0:
            raise InputError(
                f"{where}: the aspect should be positive, but is {aspect:g}."
            )
        name, photos[name] = photo_beside(path, photos)
        width, height = stored_size(photos[name])
        if width / height * aspect < 1.0:
            fx, fy = focal * height / aspect, focal * height
        else:
            fx, fy = focal * width, focal * width * aspect
        K = intrinsics(fx, fy, ppx * width - 0.5, ppy * height - 0.5)
        R = [pose[3:6], pose[6:9], pose[9:12]]
        yield name, camera_of(where, K, R, pose[:3], width, height)
