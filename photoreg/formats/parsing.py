"""Numbers and text out of other programs' files, each fault in one sentence."""

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from photoreg.checks import check_input_file
from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import MAX_SIDE_PX
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL, Lens
from photoreg.limits import Limits
from photoreg.sources import read_regular


def read_text(path: Path, what: str, max_mb: float | None = None) -> str:
    """The whole text of a file, by default up to the size that `Limits` says.

    Raises:
        InputError: if it is missing, empty, too long or not UTF-8.
    """
    check_input_file(path, what, max_mb or Limits.of_environment().camera_file_mb)
    content = read_regular(path)
    refuse_utf16(path, content)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path.name} is not a text file ({what}).") from error


def refuse_utf16(path: Path, content: bytes) -> None:
    """Raises InputError if text, by its first two bytes, is in UTF-16."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in content[:2]:
        raise InputError(
            f"{path.name} is text in UTF-16 (Windows calls it Unicode), which is not read. "
            "Save it as UTF-8: in Notepad by Save as, with the encoding UTF-8."
        )


def read_xml(path: Path, what: str, program: str) -> ElementTree.Element:
    """The first element of an XML file, which may not define entities.

    Args:
        path: The file.
        what: What it should be, for messages.
        program: Whose files they are.

    Raises:
        InputError: as ``read_text``; if it is not XML; if it defines entities, which
            could make it a thousand times as large.
    """
    text = read_text(path, what)
    if "<!ENTITY" in text:
        raise InputError(f"{path.name} defines entities, which {program} does not.")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path.name} is not XML: {error}.") from error


def read_json(path: Path, what: str) -> Any:
    """What a JSON file holds.

    Raises:
        InputError: if it is missing, empty, too long or not JSON.
    """
    check_input_file(path, what, Limits.of_environment().camera_file_mb)
    try:
        return json.loads(read_regular(path))
    except json.JSONDecodeError as error:
        reason = str(error)
    except UnicodeDecodeError:
        reason = "it is not text"
    except RecursionError:
        reason = "it is nested too deep"
    except ValueError:
        reason = "a number in it has too many digits"
    raise InputError(f"{path.name} is not a JSON file: {reason}.")


def finite(value: object, where: str, what: str) -> float:
    """A number, or the text of one, that is finite.

    Raises:
        InputError: if it is anything else.
    """
    try:
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError
        number = float(value)
    except (ValueError, OverflowError):
        raise InputError(
            f"{where}: {what} should be a number, but is {value!r:.40}."
        ) from None
    if not math.isfinite(number):
        raise InputError(f"{where}: {what} should be finite, but is {number}.")
    return number


def numbers(
    words: Sequence[object], count: int | Iterable[int], where: str, what: str
) -> list[float]:
    """So many finite numbers.

    Raises:
        InputError: if there are more or fewer, or one is not a finite number.
    """
    allowed = [count] if isinstance(count, int) else list(count)
    if len(words) not in allowed:
        raise InputError(
            f"{where}: {what} should be {' or '.join(map(str, allowed))} numbers, but "
            f"there are {len(words)}."
        )
    part = what if len(words) == 1 else f"a value of {what}"
    return [finite(word, where, part) for word in words]


def whole(value: object, where: str, what: str) -> int:
    """A whole number, or the text of one.

    Raises:
        InputError: if it is anything else.
    """
    number = finite(value, where, what)
    if number != int(number) or abs(number) > 2**53:
        raise InputError(
            f"{where}: {what} should be a whole number, but is {value!r:.40}."
        )
    return int(number)


def size_px(width: object, height: object, where: str) -> tuple[int, int]:
    """Width and height of a photo.

    Raises:
        InputError: if they are not whole numbers between 1 and a million.
    """
    size = whole(width, where, "the width"), whole(height, where, "the height")
    if not all(0 < side < MAX_SIDE_PX for side in size):
        raise InputError(
            f"{where}: a photo of {size[0]} x {size[1]} px cannot be; width and height "
            "should be positive."
        )
    return size


def lens_of(where: str, *terms: float) -> Lens:
    """A lens of k1, k2, p1, p2, k3; errors name ``where``.

    Raises:
        InputError: if the numbers are not those of a lens.
    """
    try:
        return Lens(*terms)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def camera_of(
    where: str,
    K: object,
    R: object,
    t: object,
    width: int,
    height: int,
    lens: Lens = IDEAL,
) -> Camera:
    """A camera; errors name ``where`` it was read.

    Raises:
        InputError: if the numbers are not a camera.
    """
    try:
        return Camera(K, R, t, width, height, lens)  # pyright: ignore[reportArgumentType]
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
