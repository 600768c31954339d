"""Pictures, scripts and the stylesheet that the page fetches: photos whole and in tiles, masks.

The picker shows a reduced photo, and full-resolution tiles of what is zoomed into; so
a photo of 50 megapixels costs what is looked at.
"""

import asyncio
import itertools
import re
import secrets
import threading
from collections.abc import Awaitable

import cv2
import numpy as np

from app.model.masks import decode_mask
from app.model.messages import SMALL_PX
from photoreg.imaging.encoding import encode, encode_jpeg
from photoreg.imaging.photo import Photo
from photoreg.report.static_files import static_folder

ROOT = "/photoreg/"
OVERVIEW_PX = 1600
THUMBNAIL_PX = 160
"""Longer side of a photo in the list of them."""
SIDES_PX = {"overview": OVERVIEW_PX, "small": SMALL_PX, "thumbnail": THUMBNAIL_PX}
MAX_PHOTOS = 200
TILE_PX = 512
QUALITY = 88
MASK_COLOUR = (255, 70, 70)

Answer = tuple[str, bytes]
"""Content type and body."""

_STATIC_TYPES = {"js": "text/javascript", "css": "text/css"}
_STATIC = re.compile(rf"/photoreg/([a-z]+)\.({'|'.join(_STATIC_TYPES)})")
_WHOLE = re.compile(r"/photoreg/photo/([0-9]+)/([a-z]+)\.jpg")
_TILE = re.compile(r"/photoreg/photo/([0-9]+)/([0-9]{1,4})/([0-9]{1,4})\.jpg")
_MASK = re.compile(r"/photoreg/mask/([0-9]+)\.png")


class PhotoServer:
    """Knows what is on screen by short keys, and encodes it when asked."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # A browser keeps pictures for an hour, also where another server has the
        # port by then: no two servers may have the same keys.
        self._count = itertools.count(secrets.randbelow(10**12))
        self._photos: dict[str, Photo] = {}
        self._masks: dict[str, bytes] = {}
        self._wholes: dict[tuple[str, str], bytes] = {}

    def photo_key(self, photo: Photo) -> str:
        """The key of a photo's pixels."""
        with self._lock:
            for key, known in self._photos.items():
                if known.pixels is photo.pixels:
                    return key
            key = str(next(self._count))
            self._photos[key] = photo
            while len(self._photos) > MAX_PHOTOS:
                gone = next(iter(self._photos))
                del self._photos[gone]
                for size in SIDES_PX:
                    self._wholes.pop((gone, size), None)
            return key

    def address(self, photo: Photo, size: str) -> str:
        """Where the page finds a photo reduced to one of ``SIDES_PX``."""
        return f"{ROOT}photo/{self.photo_key(photo)}/{size}.jpg"

    def mask_key(self, png: bytes | None) -> str | None:
        """The key of a mask; None for none."""
        if png is None:
            return None
        with self._lock:
            for key, known in self._masks.items():
                if known is png or known == png:
                    return key
            key = str(next(self._count))
            self._masks[key] = png
            while len(self._masks) > 20:
                del self._masks[next(iter(self._masks))]
            return key

    def answer(self, path: str) -> Awaitable[Answer | None]:
        """What is at a path below ``ROOT``; None if nothing is."""
        # Encoding takes some milliseconds, which the event loop must not wait for.
        return asyncio.to_thread(self.find, path.partition("?")[0])

    def find(self, path: str) -> Answer | None:
        """The same at once."""
        if match := _STATIC.fullmatch(path):
            file = static_folder() / f"{match[1]}.{match[2]}"
            kind = _STATIC_TYPES[match[2]]
            return (kind, file.read_bytes()) if file.is_file() else None
        if match := _WHOLE.fullmatch(path):
            return self._whole(match[1], match[2])
        if match := _TILE.fullmatch(path):
            return self._tile(match[1], int(match[2]), int(match[3]))
        if match := _MASK.fullmatch(path):
            return self._mask(match[1])
        return None

    def _whole(self, key: str, size: str) -> Answer | None:
        photo = self._photos.get(key)
        if photo is None or size not in SIDES_PX:
            return None
        data = self._wholes.get((key, size))
        if data is None:
            data = encode_jpeg(photo.resized(SIDES_PX[size]).pixels, QUALITY)
            self._wholes[key, size] = data
        return "image/jpeg", data

    def _tile(self, key: str, column: int, row: int) -> Answer | None:
        photo = self._photos.get(key)
        if photo is None:
            return None
        x, y = column * TILE_PX, row * TILE_PX
        if x >= photo.width or y >= photo.height:
            return None
        tile = photo.pixels[y : y + TILE_PX, x : x + TILE_PX]
        return "image/jpeg", encode_jpeg(tile, QUALITY)

    def _mask(self, key: str) -> Answer | None:
        png = self._masks.get(key)
        if png is None:
            return None
        mask = decode_mask(png)
        shrink = min(1.0, OVERVIEW_PX / max(mask.shape))
        out = np.where(mask, np.uint8(0), np.uint8(255))
        out = cv2.resize(out, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        rgba = np.zeros((*out.shape, 4), np.uint8)
        rgba[..., :3], rgba[..., 3] = MASK_COLOUR, out
        return "image/png", encode(rgba, ".png", (cv2.IMWRITE_PNG_COMPRESSION, 1))
