"""Photos that lie: 40 x 30 pixels, the first red."""

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from PIL import Image

from tests.robustness.lying_input import Case


def picture(mode: str = "RGB", size: tuple[int, int] = (40, 30)) -> Image.Image:
    image = Image.new("RGB", size, (60, 120, 180))
    image.putpixel((0, 0), (255, 0, 0))
    return image.convert(mode)


def encoded(image: Image.Image, kind: str, **options: Any) -> bytes:
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


def png(mode: str = "RGB") -> bytes:
    return encoded(picture(mode), "PNG")


def png_bomb() -> bytes:
    """30,000 x 30,000 pixels, in some bytes."""
    header = struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0)
    return png()[:8] + chunk(b"IHDR", header) + png()[33:]


def exif(**tags: Any) -> bytes:
    data = Image.Exif()
    for name, value in tags.items():
        data[{"orientation": 0x0112, "focal": 0x920A}[name]] = value
    return data.tobytes()


def photo_cases() -> Iterator[Case]:
    """Every format and mode, sound and damaged."""
    kinds = {"jpg": "JPEG", "png": "PNG", "tif": "TIFF"}
    for suffix, kind in kinds.items():
        name = f"p.{suffix}"
        whole = encoded(picture(), kind)
        noisy = np.random.default_rng(0).integers(0, 256, (200, 300, 3), dtype=np.uint8)
        large = encoded(Image.fromarray(noisy), kind)
        sound = "read: 40 x 30 px"
        yield Case("nothing wrong", name, whole, sound)
        yield Case("empty", name, b"", "is empty")
        yield Case("noise", name, bytes(range(256)) * 40, "could not be read")
        yield Case("text by another name", name, b"hello\n" * 50, "could not be read")
        yield Case(
            "an SVG by another name",
            name,
            b"<svg xmlns='http://www.w3.org/2000/svg'/>",
            "could not be read",
        )
        yield Case(
            "a GIF by another name",
            name,
            encoded(picture(), "GIF"),
            "could not be read",
        )
        yield Case("cut at half", name, large[: len(large) // 2], "could not be read")
        yield Case("cut in its header", name, whole[:20], "could not be read")
        yield Case("bytes after its end", name, whole + b"more" * 50, sound)
        yield Case("grey", name, encoded(picture("L"), kind), sound)
        packing = {"compression": "tiff_lzw"} if kind == "TIFF" else {}
        wide = encoded(picture(size=(700, 500)), kind, **packing)
        yield Case("more pixels than the limit", name, wide, "limit")
        yield Case("more bytes than the limit", name, whole + bytes(1_100_000), "MB")
        yield Case(
            "15 x 15 px", name, encoded(picture(size=(15, 15)), kind), "at least 16"
        )
        yield Case(
            "1 x 3000 px", name, encoded(picture(size=(1, 3000)), kind), "at least 16"
        )
    for suffix, kind in (("jpg", "JPEG"), ("tif", "TIFF")):
        yield Case(
            "CMYK", f"p.{suffix}", encoded(picture("CMYK"), kind), "read: 40 x 30 px"
        )
    deep = Image.fromarray((np.arange(1200, dtype=np.uint16) * 54).reshape(30, 40))
    for suffix, kind in (("png", "PNG"), ("tif", "TIFF")):
        yield Case(
            "grey of 16 bits", f"p.{suffix}", encoded(deep, kind), "read: 40 x 30 px"
        )
        half = picture("RGBA")
        half.putalpha(0)
        half.putpixel((0, 0), (255, 0, 0, 255))
        yield Case("half transparent", f"p.{suffix}", encoded(half, kind), "mask")
    yield Case(
        "RGB of 16 bits",
        "p.png",
        png_rgb16(),
        "read: 40 x 30 px, first pixel (255, 0, 0)",
    )
    yield Case(
        "RGB of 16 bits, and a chunk said to be 2 GB long",
        "p.png",
        png_rgb16()[:-12] + b"\x7f\xff\xff\xfftEXt" + png_rgb16()[-12:],
        "could not be read",
    )
    real = Image.fromarray(np.full((30, 40), 0.5, np.float32))
    yield Case(
        "grey in floats", "p.tif", encoded(real, "TIFF"), "first pixel (128, 128, 128)"
    )
    holes = Image.fromarray(np.full((30, 40), np.nan, np.float32))
    yield Case(
        "grey in floats that are NaN", "p.tif", encoded(holes, "TIFF"), "not finite"
    )
    yield Case("black and white", "p.png", png("1"), "read: 40 x 30 px")
    yield Case("palette", "p.png", png("P"), "read: 40 x 30 px")
    yield Case("grey and alpha", "p.png", png("LA"), "read: 40 x 30 px")
    yield Case("Lab", "p.tif", encoded(picture("LAB"), "TIFF"), "read: 40 x 30 px")
    for turn in (3, 6, 8):
        size = "40 x 30" if turn == 3 else "30 x 40"
        turned = encoded(picture(), "JPEG", exif=exif(orientation=turn), quality=100)
        yield Case(f"turned by EXIF ({turn})", "p.jpg", turned, f"read: {size} px")
    whole = encoded(picture(), "JPEG", exif=exif(orientation=99))
    yield Case("EXIF turns by 99", "p.jpg", whole, "read: 40 x 30 px")
    whole = encoded(picture(), "JPEG", exif=exif(focal=0))
    yield Case("EXIF's focal length is 0", "p.jpg", whole, "read: 40 x 30 px")
    whole = encoded(picture(), "JPEG", exif=b"Exif\0\0II*\0\xff\xff\xff\xff")
    yield Case("EXIF points past its end", "p.jpg", whole, "read: 40 x 30 px")
    whole = encoded(picture(), "JPEG", exif=b"Exif\0\0" + bytes(range(200)))
    yield Case("EXIF is noise", "p.jpg", whole, "read: 40 x 30 px")
    yield Case("decompression bomb, 900 megapixels", "p.png", png_bomb(), "limit")
    text = png()[:33] + chunk(b"zTXt", b"a\0\0" + compressed_zeros(80)) + png()[33:]
    yield Case("80 MB of compressed text", "p.png", text, "p.png")
    yield Case("a PNG called JPEG", "p.jpg", png(), "read: 40 x 30 px")
    yield from newer_cases()
    for name in ("a b.png", "Fotó 写真.png", 'it\'s "a" <b>.png', "..png", "p..png"):
        expected = "read: 40 x 30 px" if name != "..png" else ""
        yield Case("a name", name, png(), expected)


def newer_cases() -> Iterator[Case]:
    """Kinds that phones and cameras write, and marks of what no pinhole camera takes."""
    import pillow_heif
    import pillow_jxl

    pillow_heif.register_heif_opener()
    assert pillow_jxl
    sound = "read: 40 x 30 px"
    kinds = {"webp": "WEBP", "heic": "HEIF", "avif": "AVIF", "jxl": "JXL"}
    for suffix, kind in kinds.items():
        name = f"p.{suffix}"
        whole = encoded(picture(), kind)
        yield Case("nothing wrong", name, whole, sound)
        yield Case("its beginning only", name, whole[: len(whole) // 2], "could not be")
        yield Case("noise", name, bytes(range(256)) * 40, "does not begin as one")
        wide = encoded(picture(size=(700, 500)), kind)
        yield Case("more pixels than the limit", name, wide, "limit")
        yield Case("by the name of a JPEG", "p.jpg", whole, sound)
    for suffix in ("dng", "cr2", "cr3", "nef", "arw", "raf"):
        name = f"p.{suffix}"
        yield Case("a JPEG by another name", name, encoded(picture(), "JPEG"), sound)
        tiff = encoded(picture(), "TIFF")
        yield Case("a TIFF by another name", name, tiff, "could not be developed")
    raf = b"FUJIFILMCCD-RAW 0201" + bytes(400)
    yield Case("the beginning of a RAF", "p.raf", raf, "could not be developed")
    for start, what in (
        (b"BM", "a BMP"),
        (b"8BPS", "a Photoshop"),
        (b"IIRO", "Olympus"),
    ):
        yield Case(what, "p.png", start + bytes(200), what)
    for code, curve in ((16, "PQ"), (18, "HLG")):
        hdr = png()[:33] + chunk(b"cICP", bytes([9, code, 0, 1])) + png()[33:]
        yield Case(f"for HDR displays, {curve}", "p.png", hdr, curve)
    gamma = png()[:33] + chunk(b"gAMA", bytes(4)) + png()[33:]
    yield Case("a gamma of 0", "p.png", gamma, "gamma of 0")
    broken = encoded(picture(), "JPEG", icc_profile=b"not a profile" * 20)
    yield Case("a profile that is none", "p.jpg", broken, "profile that cannot be read")
    two = [picture("L").convert("RGB")]
    moving = encoded(picture(), "WEBP", save_all=True, append_images=two)
    yield Case("an animation", "p.webp", moving, "an animation of 2")
    paged = encoded(picture(), "TIFF", save_all=True, append_images=two)
    yield Case("two pages", "p.tif", paged, "2 pages")
    pano = b'<a GPano:ProjectionType="equirectangular"/>'
    yield Case(
        "a panorama", "p.jpg", encoded(picture(), "JPEG", xmp=pano), "a panorama"
    )
    dim = Image.fromarray(np.full((30, 40), 4000, np.uint16))
    yield Case("12 bits in 16", "p.png", encoded(dim, "PNG"), "no value above 4000")


def chunk(kind: bytes, data: bytes) -> bytes:

    return (
        struct.pack(">I", len(data))
        + kind
        + data
        + struct.pack(">I", zlib.crc32(kind + data))
    )


def compressed_zeros(n_mb: int) -> bytes:

    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(1_000_000)) for _ in range(n_mb))
    return packed + packer.flush()


def png_rgb16() -> bytes:

    rows = np.full((30, 40, 3), 30_000, ">u2")
    rows[0, 0] = (65535, 0, 0)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    header = struct.pack(">IIBBBBB", 40, 30, 16, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(raw))
        + chunk(b"IEND", b"")
    )
