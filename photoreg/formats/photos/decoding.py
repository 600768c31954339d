"""Photo files to sRGB bytes as displayed, by Pillow and its plugins, OpenCV and LibRaw.

Decoders are imported when a file needs them. RAW is developed plainly, so that photos
of one exposure stay so: LibRaw's whole visible area without lens correction, the white
balance that the camera chose, no brightening by content, sRGB.
"""

import contextlib
import dataclasses
import importlib
import io
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image, UnidentifiedImageError

from photoreg.errors import InputError
from photoreg.formats.photos.chunks import (
    heif_colours,
    jxl_header,
    png_chunks,
    png_pixels_alone,
)
from photoreg.formats.photos.colour_profiles import (
    ADOBE_RGB,
    CodedColours,
    colours_of_h273,
    colours_of_png,
    converter,
)
from photoreg.formats.photos.exif import PhotoFacts, facts_of, is_turned_by
from photoreg.formats.photos.registry import (
    AVIF,
    HEIF,
    JPEG,
    JXL,
    PNG,
    RAW,
    TIFF,
    WEBP,
    PhotoFormat,
    format_of,
    formats_in_words,
    unread_kind,
)
from photoreg.limits import Limits
from photoreg.sources import open_for_reading, read_regular

STRIP_ROWS = 256
"""Rows that are converted at once: whole, each conversion is one more copy."""

MAX_PAGES = 100

TIFF_SUBFILE, TIFF_WIDTH, TIFF_HEIGHT, TIFF_BITS = 254, 256, 257, 258
TIFF_TOPS = (281, 341)
"""MaxSampleValue and SMaxSampleValue."""
DNG_VERSION = 50706

REDUCED, MASK = 1, 4
"""Bits of TIFF's NewSubfileType."""

BIT_DEPTHS = (9, 10, 12, 14)
"""Of what may stand unscaled in 16 bits."""

SRGB_GAMMA = (2.4, 12.92)
"""Power and slope of sRGB's curve, as LibRaw takes them."""


@dataclasses.dataclass(frozen=True)
class PhotoHeader:
    """What is known of a photo without its pixels."""

    width: int
    """Of the pixels as stored."""
    height: int
    """Of the pixels as stored."""
    orientation: int
    """EXIF's, 1 to 8, where programs differ in heeding it; 1 where all decoders do."""

    @property
    def displayed_size(self) -> tuple[int, int]:
        """Width and height as displayed."""
        if is_turned_by(self.orientation):
            return self.height, self.width
        return self.width, self.height


@dataclasses.dataclass(frozen=True)
class DecodedPhoto:
    """A photo as displayed."""

    pixels: UInt8[np.ndarray, "h w 3"]
    """sRGB."""
    mask: Bool[np.ndarray, "h w"] | None
    """True where it is opaque; None: everywhere."""
    facts: PhotoFacts


def read_header(path: Path) -> PhotoHeader:
    """Size and turn of an existing file, from its header alone.

    Raises:
        InputError: if it is not a photo that can be read.
    """
    with _opened(path) as (kind, image):
        if image is None:
            with _raw(path) as raw:
                width, height = _raw_size(raw)
            return PhotoHeader(width, height, 1)
        width, height = _stored_size(kind, image)
        turn = _turn(path, kind, image, _facts(kind, image))
        if kind.orientation_is_exif:
            return PhotoHeader(width, height, turn)
        return PhotoHeader(*PhotoHeader(width, height, turn).displayed_size, 1)


def decode(path: Path, limits: Limits) -> DecodedPhoto:
    """The photo in an existing file.

    Raises:
        InputError: if it is not a photo that can be read, or is larger than ``limits``
            say; if it is no single picture in perspective, or its colours are for HDR
            displays or not known.
    """
    with _opened(path, limits) as (kind, image):
        if image is None:
            return _developed(path, limits)
        _check_size(path.name, image.size, limits)
        page = _chosen_page(path, kind, image)
        facts = _facts(kind, image)
        _check_projection(path.name, facts)
        turn = 1 if kind is TIFF else _turn(path, kind, image, facts)
        mask = _alpha_mask(image)
        pixels = _srgb_bytes(path, kind, image, page, facts)
        size = (pixels.shape[1], pixels.shape[0])
        image.close()
    if size[0] * size[1] > limits.photo_pixels:
        raise _too_large(path.name, size, limits)
    return DecodedPhoto(
        _upright(pixels, turn), None if mask is None else _upright(mask, turn), facts
    )


def stored_pixels(path: Path, limits: Limits) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of a picture that is no photo, a texture: sRGB, as the file stores them.

    Raises:
        InputError: if it cannot be read, is larger than ``limits`` say, or its colours
            are for HDR displays or not known.
    """
    with _opened(path, limits) as (kind, image):
        if image is None:
            raise InputError(f"{path.name} is RAW. Save it as JPEG or PNG.")
        _check_size(path.name, image.size, limits)
        page = _chosen_page(path, kind, image)
        return _srgb_bytes(path, kind, image, page, _facts(kind, image))


# Files and their formats.


@contextlib.contextmanager
def _opened(
    path: Path, limits: Limits | None = None
) -> Iterator[tuple[PhotoFormat, Image.Image | None]]:
    """The format and Pillow's picture, not decoded yet; None: it is RAW.

    Whatever a decoder raises, here or in the body, becomes one sentence.
    """
    kind = format_of(path)
    if kind is None:
        what = unread_kind(path)
        raise InputError(
            f"{path.name} could not be read as a photo: "
            f"{f'it is {what}' if what else 'it does not begin as one'}. Save it as one "
            f"of {formats_in_words()}."
        )
    try:
        with warnings.catch_warnings():
            # Size is checked with our own limit and sentence.
            warnings.simplefilter("ignore")
            if kind is RAW:
                yield kind, None
                return
            if kind is JXL:
                _check_jxl(path, limits)
            _register(kind, path.name)
            with (
                open_for_reading(path) as opened,
                Image.open(opened, formats=kind.pillow_names) as image,
            ):
                if kind is TIFF and DNG_VERSION in _tags(image):
                    yield RAW, None
                else:
                    yield kind, image
    except (InputError, MemoryError):
        raise
    except Image.DecompressionBombError as error:
        megapixels = (limits or Limits.of_environment()).photo_megapixels
        raise InputError(
            f"{path.name} has too many pixels; the limit is {megapixels:g} megapixels. "
            "Reduce it first."
        ) from error
    except Exception as error:
        raise InputError(
            f"{path.name} could not be read as a {kind.name} photo. "
            "Is it a picture, and complete?"
        ) from error


def _register(kind: PhotoFormat, name: str) -> None:
    """Makes Pillow know a format that a plugin reads."""
    if kind is HEIF:
        importlib.import_module("pillow_heif").register_heif_opener()
    elif kind is JXL:
        try:
            importlib.import_module("pillow_jxl")
        except ImportError as error:
            raise InputError(
                f"{name} is a JPEG XL, for which the package pillow-jxl-plugin is needed "
                "(pip install pillow-jxl-plugin). Or save it as JPEG or PNG."
            ) from error


def _check_jxl(path: Path, limits: Limits | None) -> None:
    """Its plugin decodes at once, so the size is looked at before."""
    header = jxl_header(path)
    if header is None:
        raise UnidentifiedImageError
    _check_size(path.name, header[:2], limits or Limits.of_environment())


def _check_size(name: str, size: tuple[int, int], limits: Limits) -> None:
    if size[0] * size[1] > limits.photo_pixels:
        raise _too_large(name, size, limits)


def _too_large(name: str, size: tuple[int, int], limits: Limits) -> InputError:
    return InputError(
        f"{name} has {size[0]}x{size[1]} pixels; the limit is "
        f"{limits.photo_megapixels:g} megapixels. Reduce it first."
    )


def _tags(image: Image.Image) -> dict[int, object]:
    """The tags of a TIFF's page."""
    return getattr(image, "tag_v2", {})


def _stored_size(kind: PhotoFormat, image: Image.Image) -> tuple[int, int]:
    if kind is not TIFF:
        return image.size
    # Pillow's own size of a TIFF is as displayed.
    tags = _tags(image)
    return int(str(tags[TIFF_WIDTH])), int(str(tags[TIFF_HEIGHT]))


def _facts(kind: PhotoFormat, image: Image.Image) -> PhotoFacts:
    try:
        exif = image.getexif()
        xmp = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
        if kind is TIFF:
            xmp = _tags(image).get(700, b"")
    except Exception:  # noqa: BLE001 - broken EXIF is common, and only a hint.
        exif, xmp = Image.Exif(), b""
    if isinstance(xmp, str):
        xmp = xmp.encode(errors="replace")
    xmp = xmp if isinstance(xmp, bytes) else b""
    try:
        return facts_of(exif, xmp, *_stored_size(kind, image))
    except Exception:  # noqa: BLE001 - the same.
        return PhotoFacts()


def _turn(path: Path, kind: PhotoFormat, image: Image.Image, facts: PhotoFacts) -> int:
    """The EXIF orientation by which decoded pixels still are to be turned."""
    if kind is HEIF:
        return 1
    if kind is JXL and not getattr(image, "jpeg", False):
        header = jxl_header(path)
        if header is not None and header[2] != 1:
            return 1  # Its own orientation, which the decoder has heeded, stands above.
    return facts.orientation


def _check_projection(name: str, facts: PhotoFacts) -> None:
    if facts.projection:
        raise InputError(
            f"{name} is marked as {facts.projection}, which no pinhole camera takes. "
            "Give an ordinary photo, or a perspective view made of it, without the mark."
        )


# Which picture of a file.


def _chosen_page(path: Path, kind: PhotoFormat, image: Image.Image) -> int:
    """Moves to the photo among a file's pictures; its number.

    Raises:
        InputError: if there are several that it could be.
    """
    n_pages = getattr(image, "n_frames", 1)
    if n_pages == 1 or image.format == "MPO" or kind in (HEIF, JXL):
        if kind is TIFF and _is_reduced(image):
            raise _only_reduced(path.name)
        return image.tell()  # The first, which is the main one, or the one marked so.
    if kind in (PNG, WEBP, AVIF):
        raise InputError(
            f"{path.name} is an animation of {n_pages} pictures. Save the one you want "
            "as JPEG or PNG."
        )
    if n_pages > MAX_PAGES:
        raise InputError(f"{path.name} has {n_pages} pages. Save the one you want.")
    pages: dict[int, int] = {}
    for page in range(n_pages):
        image.seek(page)
        if not _is_reduced(image):
            pages[page] = image.width * image.height
    if not pages:
        raise _only_reduced(path.name)
    largest = max(pages.values())
    if sum(4 * area > largest for area in pages.values()) > 1:
        raise InputError(
            f"{path.name} has {len(pages)} pages that may be the photo. Save the one you "
            "want as a file of its own."
        )
    chosen = max(pages, key=lambda page: pages[page])
    image.seek(chosen)
    return chosen


def _is_reduced(image: Image.Image) -> bool:
    """Whether a TIFF's page says that it is a thumbnail or a mask of another."""
    kind = _tags(image).get(TIFF_SUBFILE, 0)
    return isinstance(kind, int) and bool(kind & (REDUCED | MASK))


def _only_reduced(name: str) -> InputError:
    return InputError(
        f"{name} shows only a preview of a photo at its front; it may be a RAW file by "
        "another name. Give it its own suffix (.dng, .nef, .arw), or save it anew."
    )


# Pixels.

Strips = Iterator[tuple[slice, Image.Image]]


def _srgb_bytes(
    path: Path, kind: PhotoFormat, image: Image.Image, page: int, facts: PhotoFacts
) -> UInt8[np.ndarray, "h w 3"]:
    colours, profile = _colours(path, kind, image, facts)
    # Pillow's size of some formats is right only now, and what it refuses OpenCV need not
    # try.
    image.load()
    values = _deep_values(path, kind, image, page)
    if values is None:
        mode = _plain_mode(image)
        height, width = image.height, image.width
        levels = np.rint(255.0 * colours.levels(256)).astype(np.uint8)
        table = levels.tolist() * len(Image.new(mode, (1, 1)).getbands())
        is_coded = colours.gamma is not None and mode in ("L", "RGB")
        strips = (
            (rows, plain.point(table) if is_coded else plain)
            for rows, strip in _strips(image)
            for plain in (strip.convert(mode) if strip.mode != mode else strip,)
        )
    else:
        mode = "L" if values.ndim == 2 else "RGB"
        height, width = values.shape[:2]
        top = _top(path, kind, image, values)
        strips = _scaled(values, top, np.rint(255.0 * colours.levels(65536)))
    convert = converter(path.name, profile or colours.profile(), mode)
    pixels = np.zeros((height, width, 3), dtype=np.uint8)
    for rows, strip in strips:
        pixels[rows] = np.asarray(convert(strip))
    return pixels


def _colours(
    path: Path, kind: PhotoFormat, image: Image.Image, facts: PhotoFacts
) -> tuple[CodedColours, bytes | None]:
    """What the numbers mean: by numbers, or by an ICC profile, which then counts."""
    profile = image.info.get("icc_profile") or None
    if kind is PNG:
        said = colours_of_png(path.name, png_chunks(path))
        if said is not None:
            return (CodedColours() if said.are_srgb else said), None
    elif kind in (HEIF, AVIF):
        said = [colours_of_h273(path.name, *codes) for codes in heif_colours(path)]
        if said and profile is None and not said[0].are_srgb:
            return said[0], None
    elif profile is None and kind in (JPEG, TIFF) and facts.is_adobe_rgb:
        return ADOBE_RGB, None
    return CodedColours(), profile


def _plain_mode(image: Image.Image) -> str:
    """Of L, RGB, CMYK and LAB, the one that holds the picture's colours."""
    if image.mode in ("1", "L", "LA", "La"):
        return "L"
    return image.mode if image.mode in ("CMYK", "LAB") else "RGB"


def _strips(image: Image.Image) -> Strips:
    """The picture in pieces from its top."""
    for top in range(0, image.height, STRIP_ROWS):
        bottom = min(top + STRIP_ROWS, image.height)
        yield slice(top, bottom), image.crop((0, top, image.width, bottom))


def _alpha_mask(image: Image.Image) -> Bool[np.ndarray, "h w"] | None:
    if "A" not in image.getbands() and "transparency" not in image.info:
        return None
    image.load()
    mask = np.zeros((image.height, image.width), dtype=bool)
    for rows, strip in _strips(image):
        mask[rows] = np.asarray(strip.convert("RGBA"))[:, :, 3] >= 128
    return None if mask.all() else mask


def _upright(array: np.ndarray, orientation: int) -> np.ndarray:
    """A picture turned as an EXIF orientation asks."""
    turns: dict[int, Callable[[np.ndarray], np.ndarray]] = {
        2: lambda a: a[:, ::-1],
        3: lambda a: a[::-1, ::-1],
        4: lambda a: a[::-1],
        5: lambda a: a.swapaxes(0, 1),
        6: lambda a: np.rot90(a, -1),
        7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
        8: lambda a: np.rot90(a, 1),
    }
    if orientation not in turns:
        return array
    return np.ascontiguousarray(turns[orientation](array))


# More than 8 bits a channel.


def _deep_values(
    path: Path, kind: PhotoFormat, image: Image.Image, page: int
) -> np.ndarray | None:
    """Grey (h, w) or RGB (h, w, 3) values of more than 8 bits; None if there are 8.

    Of colours, Pillow keeps the upper 8 bits only, so OpenCV reads them.
    """
    if image.mode.startswith("I") or image.mode == "F":
        return np.asarray(image)
    is_deep = False
    if kind is PNG:
        is_deep = _png_bits(path) == 16
    elif kind is TIFF:
        bits = _tags(image).get(TIFF_BITS, (8,))
        is_deep = isinstance(bits, tuple) and bits[0] == 16
    if not is_deep or image.mode not in ("RGB", "RGBA"):
        return None
    content = read_regular(path)
    if kind is PNG:
        # OpenCV makes room for whatever length a damaged chunk announces.
        content = png_pixels_alone(content)
    _, pages = cv2.imdecodemulti(
        np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED, range=(page, page + 1)
    )
    values = pages[0]
    if values.dtype != np.uint16 or values.ndim != 3 or values.shape[2] < 3:
        raise ValueError("OpenCV read something other than Pillow saw")
    return values[:, :, 2::-1]


def _png_bits(path: Path) -> int:
    return png_chunks(path).get(b"IHDR", bytes(9))[8]


def _top(path: Path, kind: PhotoFormat, image: Image.Image, values: np.ndarray) -> int:
    """The value that is white, of deep values; 1 for those from 0 to 1.

    Raises:
        InputError: if neither the file nor the values tell.
    """
    highest, lowest = float(values.max()), float(values.min())
    if not np.isfinite([lowest, highest]).all():
        raise InputError(
            f"{path.name} has pixels that are not finite numbers. Save it with whole "
            "numbers, of 8 or 16 bits."
        )
    for top in _told_tops(path, kind, image):
        if highest <= top:
            return top
    if values.dtype.kind == "f" and highest <= 1.0:
        return 1
    what = f"no value above {highest:g}"
    if values.dtype != np.uint16:
        if highest > 65535.0:
            what = f"values up to {highest:g}"
        elif highest <= 255.0 and values.dtype.kind != "f":
            return 255
    is_full = highest > 2 ** BIT_DEPTHS[-1] - 1 or not (values % 257).any()
    if is_full and highest <= 65535.0 and values.dtype.kind != "f":
        return 65535
    raise InputError(
        f"{path.name} has more than 8 bits a channel, but {what}, and does not tell "
        "which value is white. Save it with 8 bits, or scaled to all 16."
    )


def _told_tops(path: Path, kind: PhotoFormat, image: Image.Image) -> list[int]:
    """Values of white, as far as the file tells: 4095 of 12 bits, and so on."""
    told: list[object] = []
    if kind is PNG:
        # The standard wants them scaled to 16 bits; those who do not heed it say so too.
        told = [2**bits - 1 for bits in png_chunks(path).get(b"sBIT", b"")[:1]]
    elif kind is TIFF:
        for tag in TIFF_TOPS:
            value = _tags(image).get(tag, ())
            told += value[:1] if isinstance(value, tuple) else [value]
    # MaxSampleValue may also be a statistic: only whole numbers of bits are believed.
    tops = {2**bits - 1 for bits in BIT_DEPTHS}
    return [
        int(value) for value in told if isinstance(value, int | float) and value in tops
    ]


def _scaled(values: np.ndarray, top: int, levels: np.ndarray) -> Strips:
    """Deep values in strips of 8 bits, by the levels of 16."""
    table = levels.astype(np.uint8)
    for start in range(0, len(values), STRIP_ROWS):
        rows = slice(start, min(start + STRIP_ROWS, len(values)))
        strip = np.clip(values[rows].astype(np.float32) * (65535.0 / top), 0, 65535)
        yield rows, Image.fromarray(table[np.rint(strip).astype(np.uint16)])


# RAW.


@contextlib.contextmanager
def _raw(path: Path) -> Iterator:
    rawpy = importlib.import_module("rawpy")
    try:
        # By its content: LibRaw opens names of UTF-8 only.
        with rawpy.imread(io.BytesIO(read_regular(path))) as raw:
            yield raw
    except (rawpy.LibRawError, rawpy.NotSupportedError) as error:
        reason = error.args[0] if error.args else ""
        reason = reason.decode() if isinstance(reason, bytes) else str(reason)
        raise InputError(
            f"{path.name} could not be developed as a RAW photo ({reason[:80]}). Export "
            "it as JPEG or TIFF from the camera's program."
        ) from error


def _raw_size(raw: object) -> tuple[int, int]:
    """Width and height as displayed."""
    sizes = raw.sizes  # pyright: ignore[reportAttributeAccessIssue]
    is_aside = sizes.flip in (4, 5, 6, 7)
    return (sizes.iheight, sizes.iwidth) if is_aside else (sizes.iwidth, sizes.iheight)


def _developed(path: Path, limits: Limits) -> DecodedPhoto:
    rawpy = importlib.import_module("rawpy")
    with _raw(path) as raw:
        _check_size(path.name, (raw.sizes.raw_width, raw.sizes.raw_height), limits)
        pixels = raw.postprocess(
            output_color=rawpy.ColorSpace.sRGB,
            gamma=SRGB_GAMMA,
            output_bps=8,
            use_camera_wb=True,
            no_auto_bright=True,
            # LibRaw would take the brightest pixel for white.
            adjust_maximum_thr=0.0,
        )
        facts = _raw_facts(path, raw, pixels.shape[1], pixels.shape[0])
    _check_projection(path.name, facts)
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise InputError(
            f"{path.name} is a RAW photo of {pixels.shape[2:] or 1} channels, not of "
            "three. Export it as JPEG or TIFF from the camera's program."
        )
    return DecodedPhoto(np.ascontiguousarray(pixels), None, facts)


def _raw_facts(path: Path, raw: object, width: int, height: int) -> PhotoFacts:
    exif = Image.Exif()
    try:
        with open_for_reading(path) as file:
            if file.read(4) in (b"II*\0", b"MM\0*"):
                exif.load_from_fp(file, 0)
            else:
                # The preview has the camera's EXIF; its pixels are not looked at.
                preview = raw.extract_thumb()  # pyright: ignore[reportAttributeAccessIssue]
                with Image.open(io.BytesIO(preview.data), formats=("JPEG",)) as image:
                    exif = image.getexif()
    except Exception:  # noqa: BLE001 - metadata are only a hint.
        exif = Image.Exif()
    try:
        return dataclasses.replace(
            facts_of(exif, b"", width, height, is_raw=True), orientation=1
        )
    except Exception:  # noqa: BLE001 - the same.
        return PhotoFacts()
