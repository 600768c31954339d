"""RealityScan's (formerly RealityCapture's) XMP files: one beside each photo, with its stem.

``xcr:Rotation`` is R, row by row, and ``xcr:Position`` the camera's centre: a point X of the
world stands at x = R (X - Position) before the camera, in OpenCV's axes. With s the photo's
larger side and d Brown's distortion of x / z, it appears at

    u = w / 2 + s (FocalLength35mm / 36 d_x + PrincipalPointU)
    v = h / 2 + s (FocalLength35mm / 36 AspectRatio d_y + PrincipalPointV)

where (0.5, 0.5) is the centre of the first pixel. ``xcr:DistortionCoeficients`` (so spelt)
are k1 k2 k3 k4 t1 t2; t1 is OpenCV's p2, and t2 is p1. The file holds neither the photo's
name nor its size: both come from the photo.

Written files are marked "locked": RealityScan keeps their cameras as they are.

Unclear, and refused: skew (its unit), the models "division" and "rational", coordinates
"relative" or "rigid". It is not documented whether (0, 0) is the corner or the centre of
the first pixel; the corner is assumed, as in RealityScan's other exports, which put the
principal point at width * 0.5.

References:
    Capturing Reality, "RealityCapture XMP Camera Math" (pose and row order); the export
    templates that RealityScan comes with (principal point, and k1 k2 t2 t1 as OpenCV's
    order); readers and writers that agree with them: AliceVision's importKnownPoses,
    Fraunhofer's camorph, EasyVolcap.
"""

from collections.abc import Iterator
from pathlib import Path

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import (
    CameraSet,
    Saved,
    cameras_by_name,
    files_by_stem,
    intrinsics,
    without,
)
from photoreg.formats.cameras.lens_terms import refuse_lens_terms
from photoreg.formats.mark import COMMENT
from photoreg.formats.parsing import camera_of, finite, lens_of, numbers, read_xml
from photoreg.formats.photos.files import photo_beside, stored_size
from photoreg.formats.writing import Content, make_folder, write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL, Lens
from photoreg.sources import open_for_reading
from photoreg.words import some_of

NAMESPACE = "http://www.capturingreality.com/ns/xcr/1.1#"
FILM_MM = 36.0
"""Larger side of 35 mm film, to which focal lengths refer."""

MODELS = {
    "perspective": (),
    "brown3": ("k1", "k2", "k3"),
    "brown4": ("k1", "k2", "k3", "k4"),
    "brown3t2": ("k1", "k2", "k3", "t1", "t2"),
    "brown4t2": ("k1", "k2", "k3", "k4", "t1", "t2"),
}
"""The terms of each lens model that is understood."""
TERMS = ("k1", "k2", "k3", "k4", "t1", "t2")

READ = (
    "Rotation", "Position", "Coordinates", "FocalLength35mm", "AspectRatio", "Skew",
    "PrincipalPointU", "PrincipalPointV", "DistortionModel", "DistortionCoeficients",
)  # fmt: skip
GEOGRAPHIC = ("ExportCoordinateSystemType", "latitude", "longitude", "altitude")
"""Of a map, which photoreg has none of."""
IRRELEVANT = (
    "Version", "version", "PosePrior", "CalibrationPrior", "CalibrationGroup",
    "DistortionGroup", "Rig", "RigInstance", "RigPoseIndex", "ComponentId", "Gravity",
    "InTexturing", "InMeshing", "InColoring",
)  # fmt: skip
"""What says nothing about where a point appears."""

_SIDECAR = """\
<x:xmpmeta xmlns:x="adobe:ns:meta/">
<!-- {comment} -->
  <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
    <rdf:Description xmlns:xcr="{namespace}" xcr:Version="3"
       xcr:PosePrior="locked" xcr:Coordinates="absolute" xcr:CalibrationPrior="exact"
       xcr:CalibrationGroup="-1" xcr:DistortionGroup="-1"
       xcr:InTexturing="1" xcr:InMeshing="1"
       xcr:DistortionModel="{model}" xcr:FocalLength35mm="{focal}" xcr:Skew="0"
       xcr:AspectRatio="{aspect}" xcr:PrincipalPointU="{u}" xcr:PrincipalPointV="{v}">
      <xcr:Rotation>{rotation}</xcr:Rotation>
      <xcr:Position>{position}</xcr:Position>
      <xcr:DistortionCoeficients>{coefficients}</xcr:DistortionCoeficients>
    </rdf:Description>
  </rdf:RDF>
</x:xmpmeta>
"""


def save_realityscan(
    folder: Path, cameras: CameraSet, overwrite: bool = False
) -> Saved:
    """Writes an XMP file for each photo, and copies of the photos that are known.

    Raises:
        OutputError: if they cannot be written there, or two photos differ in their
            suffix only.
    """
    contents: dict[Path, Content] = {}
    losses = []
    for path, name in files_by_stem(folder, cameras, ".xmp", "RealityScan").items():
        camera, lost = without(name, cameras.cameras[name], "RealityScan", "skew")
        losses += lost
        contents[path] = _sidecar(camera)
    make_folder(folder)
    contents |= cameras.copies_in(folder)
    return Saved(write_files(contents, cameras.files, overwrite), losses)


def _sidecar(camera: Camera) -> str:
    K, lens = camera.K, camera.lens
    side = max(camera.width, camera.height)
    model = "perspective"
    if not lens.is_ideal:
        model = "brown3" if lens.p1 == lens.p2 == 0.0 else "brown3t2"
    return _SIDECAR.format(
        comment=COMMENT,
        namespace=NAMESPACE,
        model=model,
        focal=_words(K[0, 0] / side * FILM_MM),
        aspect=_words(K[1, 1] / K[0, 0]),
        u=_words((K[0, 2] + 0.5 - 0.5 * camera.width) / side),
        v=_words((K[1, 2] + 0.5 - 0.5 * camera.height) / side),
        rotation=_words(*camera.R_cam_world.ravel()),
        position=_words(*camera.center),
        coefficients=_words(lens.k1, lens.k2, lens.k3, 0.0, lens.p2, lens.p1),
    )


def _words(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


def load_realityscan(folder: Path, photos: dict[str, Path]) -> dict[str, Camera]:
    """Reads every XMP file that holds a pose; its photo is among ``photos`` or beside it.

    Raises:
        InputError: if there is none, one is not valid or has what photoreg does not know,
            or its photo is not found.
    """
    return cameras_by_name(_cameras(_paths(folder), photos), folder.name)


def is_realityscan(path: Path) -> bool:
    """Whether an XMP file holds a pose, as far as its beginning shows."""
    with open_for_reading(path) as file:
        start = file.read(1 << 16)
    return NAMESPACE.encode() in start and b"Rotation" in start


def notes_of(folder: Path) -> list[str]:
    """Which XMP files hold no camera, and what they say of a map, a sentence each."""
    values = {path: _values(path) for path in _paths(folder)}
    notes = []
    without_pose = [path.name for path, v in values.items() if not _has_pose(v)]
    if without_pose:
        notes.append(
            f"{len(without_pose)} XMP files hold no pose of RealityScan "
            f"({some_of(without_pose)}); "
            "their photos have no camera."
        )
    if any(key in v for v in values.values() if _has_pose(v) for key in GEOGRAPHIC):
        notes.append(
            "The XMP files name a coordinate system, which photoreg does not read: the "
            "mesh should be exported from RealityScan in the same one."
        )
    return notes


def _paths(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.xmp")) if folder.is_dir() else [folder]


def _values(path: Path) -> dict[str, str]:
    """RealityScan's values by name: XMP has them as attributes or as elements."""
    values: dict[str, str] = {}
    prefix = f"{{{NAMESPACE}}}"
    for element in read_xml(path, "XMP file", "RealityScan").iter():
        found = {**element.attrib, element.tag: element.text or ""}
        values |= {
            key.removeprefix(prefix): text.strip()
            for key, text in found.items()
            if key.startswith(prefix)
        }
    return values


def _has_pose(values: dict[str, str]) -> bool:
    return "Rotation" in values or "Position" in values


def _cameras(
    paths: list[Path], photos: dict[str, Path]
) -> Iterator[tuple[str, Camera]]:
    for path in paths:
        values = _values(path)
        if not _has_pose(values):
            continue
        where = path.name
        _refuse_unknown(values, where)
        name, photos[name] = photo_beside(path, photos)
        width, height = stored_size(photos[name])
        side = max(width, height)
        number = {
            key: finite(values.get(key, default), where, key)
            for key, default in (
                ("FocalLength35mm", ""),
                ("AspectRatio", "1"),
                ("PrincipalPointU", "0"),
                ("PrincipalPointV", "0"),
            )
        }
        fx = number["FocalLength35mm"] / FILM_MM * side
        K = intrinsics(
            fx,
            fx * number["AspectRatio"],
            0.5 * width + number["PrincipalPointU"] * side - 0.5,
            0.5 * height + number["PrincipalPointV"] * side - 0.5,
        )
        R = numbers(values.get("Rotation", "").split(), 9, where, "Rotation")
        center = numbers(values.get("Position", "").split(), 3, where, "Position")
        R = [R[0:3], R[3:6], R[6:9]]
        t = [-sum(r * c for r, c in zip(row, center, strict=True)) for row in R]
        yield name, camera_of(where, K, R, t, width, height, _lens(values, where))


def _refuse_unknown(values: dict[str, str], where: str) -> None:
    known = (*READ, *GEOGRAPHIC, *IRRELEVANT)
    strange = {key: value for key, value in values.items() if key not in known}
    refuse_lens_terms(strange, where)
    if strange:
        raise InputError(
            f"{where} has xcr:{min(strange):.40}, which photoreg does not know; export the "
            "cameras from RealityScan as COLMAP."
        )
    coordinates = values.get("Coordinates", "absolute")
    if coordinates != "absolute":
        raise InputError(
            f"{where}: xcr:Coordinates is {coordinates!r:.40}, so the pose is not in the "
            "model's coordinates; export the XMP files as draft or as locked."
        )
    if finite(values.get("Skew", "0"), where, "Skew") != 0.0:
        raise InputError(
            f"{where} has xcr:Skew, whose unit is not documented; align in RealityScan "
            "with a lens model without K+."
        )


def _lens(values: dict[str, str], where: str) -> Lens:
    words = values.get("DistortionCoeficients", "0 0 0 0 0 0").split()
    terms = dict(
        zip(TERMS, numbers(words, 6, where, "DistortionCoeficients"), strict=True)
    )
    given = [term for term, value in terms.items() if value != 0.0]
    if not given:
        return IDEAL
    model = values.get("DistortionModel", "")
    if model not in MODELS or terms["k4"] != 0.0:
        what = "k4" if model in MODELS else f"the model {model!r:.40}"
        raise InputError(
            f"{where} has lens distortion ({what}) that photoreg does not know; align in "
            "RealityScan with Brown3 or Brown3 with tangential2, or export undistorted "
            "photos."
        )
    strange = [term for term in given if term not in MODELS[model]]
    if strange:
        raise InputError(
            f"{where}: the lens model {model} has no {strange[0]}, but the file gives one."
        )
    k1, k2, k3, _, t1, t2 = terms.values()
    return lens_of(where, k1, k2, t2, t1, k3)
