"""What a mesh file holds, as its reader hands it over: the same for every format."""

import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

from photoreg.errors import InputError
from photoreg.formats.photos.decoding import stored_pixels
from photoreg.formats.photos.registry import format_of
from photoreg.limits import Limits

GAP_PX = 4
"""Pixels around each of several pictures that are joined, in the colours of its border,
so that none bleeds into the next."""

Picture = UInt8[np.ndarray, "h w 3"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MeshContents:
    """Vertices and faces in the order of the file, and what lies on them."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    corner_uv: Float[np.ndarray, "m 3 2"] | None = None
    """Texture coordinates of the faces' corners, v upwards."""
    pictures: Sequence[Picture] = ()
    """The textures, sRGB."""
    face_picture: Int[np.ndarray, "m"] | None = None
    """Which of ``pictures`` each face shows, -1: none. None: all show the first."""
    vertex_colours: UInt8[np.ndarray, "n 3"] | None = None
    vertex_normals: Float[np.ndarray, "n 3"] | None = None
    notes: tuple[str, ...] = ()
    """What of the file was left out, or could only be guessed: a sentence each."""


def colours_of(values: np.ndarray) -> UInt8[np.ndarray, "n 3"] | None:
    """Colours of any type as bytes; None if some are not finite.

    Floats go from 0 to 1, or, if one is above 1, to 255, as some programs write them;
    whole numbers to 255, or, if one is above it, to 65,535.
    """
    if values.dtype == np.uint8:
        return values
    if not np.isfinite(values).all():
        return None
    is_fraction = np.issubdtype(values.dtype, np.floating)
    highest = values.max(initial=0)
    if is_fraction:
        scale = 255.0 if highest <= 1.0 else 1.0
    else:
        scale = 255.0 / 65535.0 if highest > 255 else 1.0
    return np.rint(np.clip(values * scale, 0.0, 255.0)).astype(np.uint8)


def texture_picture(
    content: bytes | Path, name: str, limits: Limits
) -> tuple[Picture | None, str]:
    """Decodes a texture; if that fails, None and the sentence that says why.

    Files of the formats of photos are read as these are: any depth, any colours.
    """
    if isinstance(content, Path) and format_of(content) is not None:
        try:
            return stored_pixels(content, limits), ""
        except InputError as error:
            return None, f"{error} The mesh was read without this texture."
    try:
        file = io.BytesIO(content) if isinstance(content, bytes) else content
        with Image.open(file) as picture:
            if picture.width * picture.height > limits.photo_pixels:
                return None, (
                    f"The texture {name} has {picture.width}x{picture.height} px; up to "
                    f"{limits.photo_megapixels:g} megapixels are read, so the mesh was "
                    "read without it."
                )
            return np.asarray(picture.convert("RGB"), dtype=np.uint8), ""
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None, (
            f"The texture {name} is damaged or no picture, so the mesh was read without "
            "it."
        )


def joined_pictures(contents: MeshContents) -> tuple[MeshContents, Picture | None]:
    """The contents with all pictures in one, and that one; None if there is none.

    Several pictures stand side by side in the one, and texture coordinates are moved
    there. A face whose coordinates go on beyond its picture, which then repeats, cannot be
    moved so; then no picture is kept, which a note says.
    """
    uv, shown = contents.corner_uv, contents.face_picture
    if uv is None or not contents.pictures:
        return contents, None
    if shown is None or (len(contents.pictures) == 1 and (shown == 0).all()):
        return contents, contents.pictures[0]
    used = np.unique(shown[shown >= 0])
    if len(used) == 0:
        return contents, None
    # Faces without a texture are white: a viewer shows the material's colour there.
    pictures = [contents.pictures[i] for i in used]
    number = np.full(len(contents.pictures) + 1, len(pictures))
    number[used] = np.arange(len(used))
    shown = number[shown]
    if (shown == len(pictures)).any():
        pictures.append(np.full((8, 8, 3), 255, dtype=np.uint8))
        uv = uv.copy()
        uv[shown == len(pictures) - 1] = 0.5
    # Whole turns of a repeating picture mean the same place.
    uv = uv - np.floor(uv.min(axis=1, keepdims=True) + 1e-6)
    if uv.max() > 1.0 + 1e-6:
        note = (
            f"Its {len(used)} textures repeat over the surface, so they cannot be joined "
            "into one; the mesh was read without them. Bake them into one texture first "
            "to keep them."
        )
        kept = dataclasses.replace(
            contents,
            corner_uv=None,
            pictures=(),
            face_picture=None,
            notes=(*contents.notes, note),
        )
        return kept, None
    joined, origin, size = _side_by_side(pictures)
    height, width = joined.shape[:2]
    at = np.empty_like(uv)
    at[..., 0] = (origin[shown, 0, None] + uv[..., 0] * size[shown, 0, None]) / width
    top = origin[shown, 1, None] + (1.0 - uv[..., 1]) * size[shown, 1, None]
    at[..., 1] = 1.0 - top / height
    moved = dataclasses.replace(
        contents, corner_uv=at, pictures=(joined,), face_picture=None
    )
    return moved, joined


def _side_by_side(
    pictures: Sequence[Picture],
) -> tuple[Picture, Int[np.ndarray, "k 2"], Int[np.ndarray, "k 2"]]:
    """Pictures on shelves, the tallest first; each one's left, top, width and height."""
    size = np.array([picture.shape[1::-1] for picture in pictures])
    room = size + 2 * GAP_PX
    width = max(int(room[:, 0].max()), int(np.ceil(np.sqrt(room.prod(axis=1).sum()))))
    origin = np.zeros_like(size)
    x = y = shelf = 0
    for i in np.argsort(-room[:, 1], kind="stable"):
        if x + room[i, 0] > width:
            x, y = 0, y + shelf
        if x == 0:
            shelf = int(room[i, 1])
        origin[i] = x + GAP_PX, y + GAP_PX
        x += int(room[i, 0])
    joined = np.zeros((y + shelf, width, 3), dtype=np.uint8)
    for picture, (left, top) in zip(pictures, origin - GAP_PX, strict=True):
        padded = np.pad(picture, ((GAP_PX, GAP_PX), (GAP_PX, GAP_PX), (0, 0)), "edge")
        height, wide = padded.shape[:2]
        joined[top : top + height, left : left + wide] = padded
    return joined, origin, size
