"""Camera files that lie, in each format."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import write_cameras
from photoreg.geometry.camera import Camera
from tests.formats.metashape_files import document, row
from tests.robustness.lying_input import Case
from tests.robustness.lying_photos import png


def camera() -> Camera:
    return Camera.look_at((1.0, 2.0, 5.0), (0.0, 0.1, 0.0), (0, 1, 0), 50.0, 40, 30)


SAVED = {
    "photoreg": "c.json",
    "nerfstudio": "transforms.json",
    "meshlab": "c.mlp",
    "opencv": "c.yml",
    "bundler": "c.out",
    "colmap": "model",
    "colmap-text": "model",
    "texrecon": "cams",
    "metashape": "c.xml",
    "realityscan": "sidecars",
    "alicevision": "c.sfm",
}


def saved(path: Path, kind: str) -> list[Path]:
    """Cameras of two photos in a format, the photos beside; the files written."""
    photos = {}
    for name in ("a.png", "b.png"):
        photos[name] = path.parent / name
        photos[name].write_bytes(png())
    if kind == "metashape":
        pose = row(np.eye(4))
        path.write_text(document(second=f"<transform>{pose}</transform>"))
        return [path]
    cameras = {name: camera() for name in photos}
    if kind in ("colmap", "colmap-text", "texrecon", "realityscan"):
        path.mkdir(exist_ok=True)
    written = write_cameras(path, CameraSet(cameras, photos), kind).files
    return [file for file in written if file.suffix not in (".png", ".jpg")]


def damaged(kind: str, change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    """Writes cameras, then changes the bytes of each file."""

    def make(path: Path) -> None:
        for file in saved(path, kind):
            file.write_bytes(change(file.read_bytes()))

    return make


def photoreg_file(**values: Any) -> bytes:
    entry = {
        "photo": "a.png",
        "width": 40,
        "height": 30,
        "K": [[50, 0, 19.5], [0, 50, 14.5], [0, 0, 1]],
        "R": np.eye(3).tolist(),
        "t": [0, 0, 5],
        **values,
    }
    return json.dumps(
        {"format": "photoreg-cameras", "version": 1, "cameras": [entry]}
    ).encode()


def camera_cases() -> Iterator[Case]:
    """Every format damaged alike, then what only photoreg's own can say."""
    for kind, name in SAVED.items():
        yield Case(
            f"{kind}: nothing wrong",
            name,
            damaged(kind, lambda b: b),
            "read: 2 cameras",
        )
        yield Case(
            f"{kind}: cut at half", name, damaged(kind, lambda b: b[: len(b) // 2]), ""
        )
        # Only its contents tell RealityScan's XMP from any other.
        empty = "holds no cameras" if kind == "realityscan" else "empty"
        yield Case(f"{kind}: empty", name, damaged(kind, lambda b: b""), empty)
        yield Case(
            f"{kind}: noise", name, damaged(kind, lambda b: bytes(range(256)) * 9), ""
        )
        yield Case(
            f"{kind}: zero bytes", name, damaged(kind, lambda b: bytes(len(b))), ""
        )
        if kind != "colmap":
            yield Case(
                f"{kind}: words for numbers",
                name,
                damaged(kind, lambda b: b.replace(b"0.", b"x.")),
                "",
            )
            yield Case(
                f"{kind}: NaN for numbers",
                name,
                damaged(kind, lambda b: b.replace(b"0.", b"nan")),
                "",
            )
            yield Case(
                f"{kind}: huge numbers",
                name,
                damaged(kind, lambda b: b.replace(b"0.", b"9e307")),
                "",
            )
    good = photoreg_file()
    name = "c.json"
    yield Case("nothing wrong", name, good, "read: 1 cameras")
    for key, values in {
        "K": (
            None,
            "K",
            [],
            [[1]],
            [[0] * 3] * 3,
            [[50, 0, 19], [0, 50, 14], [0, 0, 0]],
            [[-50, 0, 19], [0, 50, 14], [0, 0, 1]],
            [[1e308, 0, 0], [0, 1e308, 0], [0, 0, 1]],
            [[float("nan"), 0, 0], [0, 50, 0], [0, 0, 1]],
            [["50", 0, 19], [0, 50, 14], [0, 0, True]],
        ),
        "R": (
            None,
            7,
            np.zeros((3, 3)).tolist(),
            (2 * np.eye(3)).tolist(),
            (-np.eye(3)).tolist(),
            [[1, 0, 0], [0, 1, 0], [0, 1, 0]],
            [[1, 0, 0], [0, 1, 0]],
        ),
        "t": ([0, 0], [0, 0, float("inf")], "far", [[0, 0, 5]], [1e308, 0, 0], {}),
        "width": (0, -40, 40.5, "40", 10**12, None, True),
        "photo": ("", 7, None, "../../etc/passwd", "a/b.png", "a\0b.png", "x" * 5000),
    }.items():
        for value in values:
            said = json.dumps(value)
            said = said if len(said) < 40 else said[:37] + "..."
            yield Case(f"{key} is {said}", name, photoreg_file(**{key: value}), "")
    yield Case(
        "two cameras for a photo",
        name,
        good.replace(b"}]}", b"}, " + good[good.index(b"[{") + 1 : -2] + b"]}"),
        "two cameras",
    )
    yield Case(
        "a newer version",
        name,
        good.replace(b'"version": 1', b'"version": 99'),
        "Update photoreg",
    )
    yield Case(
        "another program's JSON", name, b'{"a": 1}', "not a photoreg camera file"
    )
    yield Case("nested 100,000 deep", name, b"[" * 100_000, "not a JSON file")
    yield Case(
        "a number of 10,000 digits",
        name,
        good.replace(b"19.5", b"9" * 10_000),
        "c.json",
    )
    yield Case("more than the limit", name, good + b" " * 2_000_000, "MB")
