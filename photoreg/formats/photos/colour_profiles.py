"""From the colours that a photo is coded in to sRGB, by LittleCMS.

A photo says what its numbers mean by an ICC profile, or by a few numbers (PNG's gAMA,
cHRM and cICP; HEIF's and AVIF's nclx; EXIF's mark of Adobe RGB), of which a profile is
made here. Colours are taken over relative to white, black to black.

References:
    ICC.1:2022, sections 8 to 10; ITU-T H.273, tables 2 and 3.
"""

import dataclasses
import io
import struct
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageCms

from photoreg.errors import InputError

D65, C = (0.3127, 0.3290), (0.310, 0.316)
SRGB_PRIMARIES = (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, *D65)
ADOBE_PRIMARIES = (0.640, 0.330, 0.210, 0.710, 0.150, 0.060, *D65)
ADOBE_GAMMA = 563 / 256

H273_PRIMARIES = {
    1: SRGB_PRIMARIES,
    2: SRGB_PRIMARIES,  # Not said.
    4: (0.67, 0.33, 0.21, 0.71, 0.14, 0.08, *C),
    5: (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *D65),
    6: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *D65),
    7: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *D65),
    8: (0.681, 0.319, 0.243, 0.692, 0.145, 0.049, *C),
    9: (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65),
    11: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    12: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65),
}
"""By code: x and y of red, green, blue and white."""

H273_GAMMAS = {4: 2.2, 5: 2.8, 8: 1.0, **dict.fromkeys((1, 2, 6, 13, 14, 15), None)}
"""By code; None: sRGB's curve, by which pictures coded for television are shown too."""

HDR_CURVES = {16: "PQ", 18: "HLG"}

SAME_LEVELS = 1
"""Of 255: a profile that changes a chart of colours by no more is sRGB's."""


@dataclasses.dataclass(frozen=True)
class CodedColours:
    """What a photo's values mean, given in numbers."""

    primaries: tuple[float, ...] = SRGB_PRIMARIES
    """x and y of red, green, blue and white."""
    gamma: float | None = None
    """Light is the value to this power; None: sRGB's curve."""

    @property
    def are_srgb(self) -> bool:
        """Whether they are sRGB, as nearly as PNG's gAMA and cHRM can say it."""
        is_curve = self.gamma is None or abs(self.gamma / 2.2 - 1.0) < 0.005
        return is_curve and bool(
            np.allclose(self.primaries, SRGB_PRIMARIES, atol=0.0015)
        )

    def levels(self, n_levels: int) -> Float[np.ndarray, "n_levels"]:
        """Value by value from 0 to 1, the same light on sRGB's curve."""
        values = np.linspace(0.0, 1.0, n_levels)
        if self.gamma is None:
            return values
        light = values**self.gamma
        return np.where(
            light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055
        )

    def profile(self) -> bytes | None:
        """An ICC profile of the primaries, with sRGB's curve; None: sRGB's own."""
        if np.allclose(self.primaries, SRGB_PRIMARIES, atol=0.0015):
            return None
        return _matrix_profile(self.primaries)


ADOBE_RGB = CodedColours(ADOBE_PRIMARIES, ADOBE_GAMMA)


def colours_of_h273(name: str, primaries: int, transfer: int) -> CodedColours:
    """What codes of ITU-T H.273 mean.

    Raises:
        InputError: if that is a picture for HDR displays, or not known.
    """
    if transfer in HDR_CURVES:
        raise is_hdr(name, HDR_CURVES[transfer])
    if primaries not in H273_PRIMARIES or transfer not in H273_GAMMAS:
        raise InputError(
            f"{name} encodes its colours in a way that photoreg does not know (primaries "
            f"{primaries}, transfer {transfer} of ITU-T H.273). Save it in sRGB."
        )
    return CodedColours(H273_PRIMARIES[primaries], H273_GAMMAS[transfer])


def colours_of_png(name: str, chunks: dict[bytes, bytes]) -> CodedColours | None:
    """What a PNG's cICP, sRGB, gAMA and cHRM say; None if an ICC profile counts.

    Raises:
        InputError: if that is a picture for HDR displays, or cannot be.
    """
    if len(cicp := chunks.get(b"cICP", b"")) == 4:
        if cicp[2] != 0 or cicp[3] != 1:
            raise InputError(
                f"{name} encodes its colours for video (cICP {list(cicp)}), which a PNG "
                "should not. Save it in sRGB."
            )
        return colours_of_h273(name, cicp[0], cicp[1])
    if b"iCCP" in chunks:
        return None
    if b"sRGB" in chunks:
        return CodedColours()
    gamma, primaries = None, SRGB_PRIMARIES
    if len(gama := chunks.get(b"gAMA", b"")) == 4:
        value = int.from_bytes(gama, "big") / 100_000
        if not 0.1 <= value <= 10.0:
            raise InputError(
                f"{name} gives a gamma of {value:g} (gAMA), which is impossible. Save it "
                "in sRGB."
            )
        gamma = 1.0 / value
    if len(chrm := chunks.get(b"cHRM", b"")) == 32:
        wx, wy, *rgb = (v / 100_000 for v in struct.unpack(">8I", chrm))
        primaries = (*rgb, wx, wy)
        try:
            _colorants(primaries)
        except (np.linalg.LinAlgError, ZeroDivisionError):
            raise InputError(
                f"{name} says primary colours (cHRM) that cannot be. Save it in sRGB."
            ) from None
    return CodedColours(primaries, gamma)


def is_hdr(name: str, curve: str) -> InputError:
    """The error that a photo is for HDR displays."""
    return InputError(
        f"{name} is coded for HDR displays ({curve}); its brightness has no place in "
        "sRGB. Export it as an ordinary (SDR) photo."
    )


Convert = Callable[[Image.Image], Image.Image]
"""From a picture, or a strip of it, to RGB in sRGB."""


def converter(name: str, profile: bytes | None, mode: str) -> Convert:
    """What takes pictures of ``mode`` (L, RGB, CMYK or LAB) to sRGB.

    Args:
        name: Of the photo, for the sentence.
        profile: Its ICC profile; None: the values are sRGB's.
        mode: Pillow's mode of the pictures.

    Raises:
        InputError: if the profile cannot be read, is for HDR displays or for pixels of
            another kind.
    """
    if profile is None:
        return lambda picture: picture.convert("RGB")
    _refuse_hdr(name, profile)
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        assert isinstance(source.profile, ImageCms.core.CmsProfile)  # It was opened.
        space = source.profile.xcolor_space.strip()
        as_rgb = space == "RGB" and mode == "L"
        wanted = {"L": "GRAY", "RGB": "RGB", "CMYK": "CMYK", "LAB": "Lab"}[mode]
        if space != wanted and not as_rgb:
            raise InputError(
                f"{name} has a colour profile for {space} pixels, but its pixels are "
                f"{wanted}. Save it in sRGB."
            )
        transform = ImageCms.buildTransform(
            source,
            ImageCms.createProfile("sRGB"),
            "RGB" if as_rgb else mode,
            "RGB",
            ImageCms.Intent.RELATIVE_COLORIMETRIC,
            ImageCms.Flags.BLACKPOINTCOMPENSATION,
        )
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{name} has a colour profile that cannot be read. Save it in sRGB."
        ) from error

    def convert(picture: Image.Image) -> Image.Image:
        converted = ImageCms.applyTransform(
            picture.convert("RGB") if as_rgb else picture, transform
        )
        assert converted is not None  # Only where it works in place.
        return converted

    if mode != "CMYK" and mode != "LAB" and _changes_nothing(convert, mode):
        # Exactly as it is, and three times as fast: most profiles are sRGB's.
        return lambda picture: picture.convert("RGB")
    return convert


def _changes_nothing(convert: Convert, mode: str) -> bool:
    steps = np.arange(0, 256, 15, dtype=np.uint8)
    chart = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(1, -1, 3)
    picture = Image.fromarray(chart if mode == "RGB" else chart[:, :18, 2])
    before = np.asarray(picture.convert("RGB"), dtype=int)
    return int(np.abs(np.asarray(convert(picture)) - before).max()) <= SAME_LEVELS


def _refuse_hdr(name: str, profile: bytes) -> None:
    """Raises InputError if a profile is of an HDR curve."""
    n_tags = int.from_bytes(profile[128:132], "big")
    for i in range(min(n_tags, 100)):
        entry = profile[132 + 12 * i : 144 + 12 * i]
        at = int.from_bytes(entry[4:8], "big")
        if entry[:4] == b"cicp" and len(profile) >= at + 12:
            transfer = profile[at + 9]
            if transfer in HDR_CURVES:
                raise is_hdr(name, HDR_CURVES[transfer])
        if entry[:4] == b"desc":
            size = int.from_bytes(entry[8:12], "big")
            words = profile[at : at + min(size, 500)].replace(b"\0", b"")
            for curve in (b"PQ", b"HLG"):
                if curve in words:
                    raise is_hdr(name, curve.decode())


def _colorants(primaries: tuple[float, ...]) -> Float[np.ndarray, "3 3"]:
    """XYZ of red, green and blue, as columns, white brought to D50 by Bradford."""
    xyz = [
        [x / y, 1.0, (1.0 - x - y) / y]
        for x, y in zip(primaries[::2], primaries[1::2], strict=True)
    ]
    white = np.array(xyz[3])
    columns = np.array(xyz[:3]).T
    columns = columns * np.linalg.solve(columns, white)
    bradford = np.array(
        [
            [0.8951, 0.2664, -0.1614],
            [-0.7502, 1.7135, 0.0367],
            [0.0389, -0.0685, 1.0296],
        ]
    )
    d50 = np.array([0.9642, 1.0, 0.8249])
    cones = np.diag(bradford @ d50 / (bradford @ white))
    adapted = np.linalg.inv(bradford) @ cones @ bradford @ columns
    if not np.isfinite(adapted).all() or np.abs(adapted).max() > 3.0:
        raise np.linalg.LinAlgError
    return adapted


def _matrix_profile(primaries: tuple[float, ...]) -> bytes:
    """An ICC profile (version 4) of RGB with sRGB's curve."""

    def fixed(*values: float) -> bytes:
        return struct.pack(f">{len(values)}i", *(round(v * 65536) for v in values))

    def text(words: str) -> bytes:
        coded = words.encode("utf-16-be")
        return (
            struct.pack(">4sIII2s2sII", b"mluc", 0, 1, 12, b"en", b"US", len(coded), 28)
            + coded
        )

    red, green, blue = _colorants(primaries).T
    curve = b"para" + struct.pack(">IHH", 0, 3, 0)
    curve += fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    contents = {
        b"desc": text("Primaries of a photo"),
        b"cprt": text("No copyright"),
        b"wtpt": b"XYZ \0\0\0\0" + fixed(0.9642, 1.0, 0.8249),
        b"rXYZ": b"XYZ \0\0\0\0" + fixed(*red),
        b"gXYZ": b"XYZ \0\0\0\0" + fixed(*green),
        b"bXYZ": b"XYZ \0\0\0\0" + fixed(*blue),
        b"rTRC": curve,
        b"gTRC": curve,
        b"bTRC": curve,
    }
    at = 128 + 4 + 12 * len(contents)
    table, body = struct.pack(">I", len(contents)), b""
    for tag, content in contents.items():
        table += struct.pack(">4sII", tag, at + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    head = struct.pack(
        ">I4sI4s4s4s12s4s4sI4sIQI12s",
        *(at + len(body), b"", 0x04300000, b"mntr", b"RGB ", b"XYZ "),
        *(struct.pack(">6H", 2000, 1, 1, 0, 0, 0), b"acsp", b"", 0, b"", 0, 0, 0),
        fixed(0.9642, 1.0, 0.8249),
    )
    return head.ljust(128, b"\0") + table + body
