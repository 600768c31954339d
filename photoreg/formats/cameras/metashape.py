"""Metashape's cameras XML (File, Export, Export Cameras: Agisoft XML); read only.

A camera's ``transform`` leads from it (x right, y down, z into the scene) to the chunk or
to a component of it, which has a rotation, a scale and a shift of its own to the world. A
sensor's ``calibration`` of the class "adjusted" is the one that was solved; with x = X / Z
and y = Y / Z, distorted to x' and y', a point appears at

    u = w / 2 + cx + x' (f + b1) + y' b2,    v = h / 2 + cy + y' f

where (0.5, 0.5) is the centre of the first pixel. P1 is OpenCV's p2, and P2 is
p1. Photos without a transform were not aligned and are left out.

References:
    Agisoft, "Metashape User Manual, Professional Edition", appendix "Camera models".
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import cameras_by_name, intrinsics
from photoreg.formats.cameras.lens_terms import refuse_lens_terms
from photoreg.formats.parsing import (
    camera_of,
    finite,
    lens_of,
    numbers,
    read_xml,
    size_px,
)
from photoreg.formats.photos.files import is_photo, photo_of_stem
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.words import some_of

READ_TERMS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "p1", "p2")

Similarity = tuple[float, np.ndarray, np.ndarray]
"""Scale, rotation and shift to the world."""

STAYS: Similarity = (1.0, np.eye(3), np.zeros(3))


def load_metashape(path: Path, photos: dict[str, Path]) -> dict[str, Camera]:
    """Reads the aligned cameras; photos are found by name, or by name without suffix.

    Raises:
        InputError: if it is not such a file, or a camera is of a kind that photoreg does
            not know; it is named.
    """
    document = _parsed(path)
    chunks = [
        c for c in document.iter("chunk") if c.find(".//camera/transform") is not None
    ]
    if len(chunks) != 1:
        raise InputError(
            f"{path.name} has {len(chunks)} chunks with aligned cameras; export the "
            "cameras of one chunk."
        )
    (chunk,) = chunks
    return cameras_by_name(_cameras(path, chunk, photos), path.name)


def notes_of(path: Path) -> list[str]:
    """Which photos were not aligned, in a sentence."""
    left_out = [
        camera.get("label", "?")
        for camera in _parsed(path).iter("camera")
        if camera.find("transform") is None
    ]
    if not left_out:
        return []
    return [
        f"Metashape did not align {len(left_out)} photos of {path.name} "
        f"({some_of(left_out)}); they have no "
        "camera."
    ]


def _parsed(path: Path) -> ElementTree.Element:
    document = read_xml(path, "Metashape's cameras", "Metashape")
    if document.tag != "document":
        raise InputError(
            f"{path.name} is not Metashape's cameras, the only XML that photoreg reads: "
            f"its first element should be <document>, but is <{document.tag:.40}>. Export "
            "the cameras as COLMAP, Bundler or nerfstudio."
        )
    return document


def _cameras(
    path: Path, chunk: ElementTree.Element, photos: dict[str, Path]
) -> Iterator[tuple[str, Camera]]:
    _refuse_georeference(path.name, chunk)
    places = _places(path.name, chunk)
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    for camera in chunk.iter("camera"):
        text = camera.findtext("transform")
        if text is None:
            continue
        label = camera.get("label", "")
        where = f"{path.name}, camera {label or camera.get('id', '?')}"
        if camera.get("master_id") is not None:
            raise InputError(
                f"{where} is of a rig of several cameras (master_id), which photoreg does "
                "not read; export as COLMAP."
            )
        sensor = sensors.get(camera.get("sensor_id"))
        if sensor is None:
            raise InputError(f"{where}: its sensor is not in the file.")
        if _has_rolling_shutter(sensor):
            raise InputError(
                f"{where}: its sensor has a rolling shutter's motion solved "
                "(rolling_shutter), which photoreg does not know; align in Metashape "
                "without rolling shutter compensation."
            )
        component = camera.get("component_id")
        if component not in places:
            raise InputError(f"{where}: its component {component} is not in the file.")
        K, lens, size = _calibration(sensor, where)
        pose = np.reshape(numbers(text.split(), 16, where, "its transform"), (4, 4))
        scale, Q, d = places[component]
        R_world_cam = Q @ pose[:3, :3]
        center = scale * Q @ pose[:3, 3] + d
        name = _photo(label, path.parent, photos)
        R = R_world_cam.T
        yield name, camera_of(where, K, R, -R @ center, *size, lens)


def _photo(label: str, folder: Path, photos: dict[str, Path]) -> str:
    """The photo's file name; labels lack the suffix by default."""
    if is_photo(Path(label)):
        return label
    found = photo_of_stem(label, folder, photos)
    return label if found is None else found[0]


def _refuse_georeference(file: str, chunk: ElementTree.Element) -> None:
    """Models are exported in a map's coordinates then, cameras in the globe's."""
    reference = (chunk.findtext("reference") or "").strip()
    if reference and not reference.startswith("LOCAL_CS"):
        raise InputError(
            f"{file} is of a georeferenced chunk ({reference.split(',')[0]:.60}), whose "
            "model and cameras stand in different coordinates; export both in local "
            "coordinates, or the cameras as COLMAP."
        )


def _places(file: str, chunk: ElementTree.Element) -> dict[str | None, Similarity]:
    """From each component to the world, by its id; None: from the chunk."""
    own = _similarity(chunk.find("transform"), file)
    places: dict[str | None, Similarity] = {None: own or STAYS}
    components = chunk.findall("components/component")
    for component in components:
        place = _similarity(component.find("transform"), file) or own
        if place is None and len(components) > 1:
            raise InputError(
                f"{file} has {len(components)} components, which Metashape has not put "
                "into one world; align them, or export one."
            )
        places[component.get("id")] = place or STAYS
    return places


def _similarity(transform: ElementTree.Element | None, file: str) -> Similarity | None:
    if transform is None:
        return None
    parts = {
        tag: numbers((transform.findtext(tag) or words).split(), n, file, f"the {tag}")
        for tag, n, words in (
            ("rotation", 9, "1 0 0 0 1 0 0 0 1"),
            ("translation", 3, "0 0 0"),
            ("scale", 1, "1"),
        )
    }
    Q = np.reshape(parts["rotation"], (3, 3))
    (scale,) = parts["scale"]
    is_rotation = np.allclose(Q @ Q.T, np.eye(3), atol=1e-6) and np.linalg.det(Q) > 0.0
    if not (is_rotation and scale > 0.0):
        raise InputError(
            f"{file}: the chunk's transform is not a rotation and a scale."
        )
    return scale, Q, np.array(parts["translation"])


def _calibration(
    sensor: ElementTree.Element, where: str
) -> tuple[np.ndarray, Lens, tuple[int, int]]:
    kind = sensor.get("type", "frame")
    found = {c.get("class", "adjusted"): c for c in sensor.findall("calibration")}
    calibration = found.get("adjusted", found.get("initial"))
    if calibration is None:
        raise InputError(f"{where}: its sensor has no calibration; align the photos.")
    kind = next((k for k in (kind, calibration.get("type", kind)) if k != "frame"), "")
    if kind:
        raise InputError(
            f"{where}: its sensor is of the type {kind:.40}, not frame; undistort the photos "
            "in Metashape and export again."
        )
    resolution = calibration.find("resolution")
    if resolution is None:
        resolution = sensor.find("resolution")
    if resolution is None:
        raise InputError(f"{where}: its sensor has no resolution.")
    size = size_px(resolution.get("width"), resolution.get("height"), where)
    given = {
        part.tag: part.text or "" for part in calibration if part.tag != "resolution"
    }
    refuse_lens_terms({k: v for k, v in given.items() if k not in READ_TERMS}, where)
    strange = [k for k in given if k not in (*READ_TERMS, "k4", "p3", "p4", "date")]
    if strange:
        raise InputError(
            f"{where}: its calibration has {strange[0]:.40}, which photoreg does not know."
        )
    if "f" not in given:
        raise InputError(f"{where}: its calibration lacks f, the focal length.")
    value = {k: finite(given.get(k, 0.0), where, k) for k in READ_TERMS}
    K = intrinsics(
        value["f"] + value["b1"],
        value["f"],
        0.5 * size[0] + value["cx"] - 0.5,
        0.5 * size[1] + value["cy"] - 0.5,
    )
    K[0, 1] = value["b2"]
    lens = lens_of(
        where, value["k1"], value["k2"], value["p2"], value["p1"], value["k3"]
    )
    return K, lens, size


def _has_rolling_shutter(sensor: ElementTree.Element) -> bool:
    return any(
        part.get("name") == "rolling_shutter" and part.get("value") != "false"
        for part in sensor.iter("property")
    )
