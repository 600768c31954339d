"""Terms by which a lens departs from a pinhole, in files of any program.

photoreg knows k1, k2, p1, p2 and k3 (``geometry.lens``), in the formats that have them;
any other term is refused by its name: taken for zero it would move every photo on the
surface without a word. Other programs have more names for
them than one reader knows, so all keys of a camera are looked at.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from photoreg.errors import InputError

_TERM = re.compile(
    r"[kpsb]\d+|tau[xy]?\d*|xi|d|radial.*|tangential.*|.*dist(ortion|coef).*|dist"
    r"|.*fisheye.*|ftheta.*|rollingshutter.*"
)
"""Keys, in small letters and without joints: OpenCV's and Metashape's k1, p1, s1, b1,
tau; nerfstudio's distortion_params; ROS's D; instant-ngp's is_fisheye and ftheta_p0."""

_MODEL = re.compile(r".*(model|projection)|lens(type)?|cameratype")
_NO_PINHOLE = re.compile(r"fisheye|equi|omni|kannala|spher|panor|ortho|360", re.I)


def refuse_lens_terms(camera: Mapping[str, Any], where: str) -> None:
    """Looks at all keys of a camera, and of what holds for all cameras of its file.

    Args:
        camera: Its keys and values.
        where: The camera, for the sentence.

    Raises:
        InputError: if one is a lens term that is not zero, or a projection other than
            a pinhole's; it is named.
    """
    for key, value in camera.items():
        plain = re.sub(r"[\W_]", "", str(key)).casefold()
        if _MODEL.fullmatch(plain):
            if isinstance(value, str) and _NO_PINHOLE.search(value):
                _refuse(where, f"{key!s:.40}: {value:.40}")
        elif _TERM.fullmatch(plain) and _says_something(value):
            _refuse(where, f"{key!s:.40}")


def refuse_distortion(coefficients: Iterable[float], where: str) -> None:
    """Looks at the lens terms of a format that gives them no names.

    Raises:
        InputError: if one is not zero.
    """
    if any(value != 0.0 for value in coefficients):
        _refuse(where, "")


def _says_something(value: Any) -> bool:
    """Whether a number is not zero, or one among several is not."""
    if isinstance(value, Mapping):
        # OpenCV's matrices have their size beside the numbers.
        return _says_something(value.get("data", list(value.values())))
    if isinstance(value, list | tuple):
        return any(_says_something(part) for part in value)
    if isinstance(value, str):
        try:
            return float(value) != 0.0
        except ValueError:
            return value.casefold() not in ("", "none", "false", "no")
    return value is not None and value != 0


def _refuse(where: str, term: str) -> None:
    of = f" ({term})" if term else ""
    raise InputError(
        f"{where} has lens distortion{of} that photoreg does not know there; undistort "
        "the photos in the program that made this file and export again."
    )
