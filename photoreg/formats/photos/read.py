"""Photos from files, as displayed and in sRGB."""

from pathlib import Path

from photoreg.checks import check_input_file
from photoreg.formats.photos.decoding import decode
from photoreg.imaging.photo import Photo
from photoreg.limits import Limits
from photoreg.names import presentable
from photoreg.sources import source_file


def load_photo(path: Path | str, limits: Limits | None = None) -> Photo:
    """Loads a photo of any format of `photoreg.formats.photos.registry`, as displayed and in sRGB.

    EXIF orientation and colour profiles are applied; alpha becomes the mask. Of a file
    with a preview, it is the photo. RAW is developed as `photoreg.formats.photos.decoding` says.

    Args:
        path: The file.
        limits: How large it may be; None: as the environment says.

    Raises:
        InputError: if the file is missing, empty, not a photo, truncated, too small
            (under 16 px a side) or too large (by default over 120 megapixels); if it is
            an animation, of several pages, a panorama or a fisheye, or coded for HDR
            displays or in colours that are not known.
    """
    limits = limits or Limits.of_environment()
    path = check_input_file(Path(path), "photo", limits.file_mb)
    decoded = decode(path, limits)
    focal = decoded.facts.focal
    return Photo(
        presentable(path.name),
        decoded.pixels,
        decoded.mask,
        None if focal is None else focal.px,
        source_file(path),
        "" if focal is None else focal.note,
        decoded.facts.is_cropped,
        decoded.facts.lens,
    )
