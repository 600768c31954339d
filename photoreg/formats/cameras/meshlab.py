"""MeshLab projects (.mlp): a mesh, and photos with a VCGCamera each.

RotationMatrix has the camera's axes as rows (x right, y up, z backward),
TranslationVector is minus the camera centre, and pixels count from the lower left
corner of the photo. MeshLab mirrors the principal point where it textures with OpenGL,
so only one in the middle of the photo is read right by all its filters: a copy of the
photo is padded until it is, and the rest of under half a pixel is turned into R.
Padding is transparent, which MeshLab's projections respect, and is undone on reading:
its measures stand in the copy's name, the photo's own name in the label.
"""

import functools
import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from photoreg.checks import check_finite_array
from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import (
    OPENGL_AXES,
    CameraSet,
    Saved,
    cameras_by_name,
    compensating_turn,
    intrinsics,
    largest_shift_px,
    photo_name,
    without,
)
from photoreg.formats.cameras.lens_terms import refuse_distortion
from photoreg.formats.cameras.orientation import cameras_as_stored
from photoreg.formats.mark import COMMENT, marked_picture
from photoreg.formats.parsing import (
    camera_of,
    numbers,
    read_xml,
    size_px,
)
from photoreg.formats.photos.files import displayed_size, is_turned, path_from
from photoreg.formats.photos.read import load_photo
from photoreg.formats.writing import Content, write_files
from photoreg.geometry.camera import Camera
from photoreg.limits import Limits

SMALL_SHIFT_PX = 0.05
"""What turning the camera by the rest of a pixel may cost without being reported."""

PADDED = re.compile(
    r"(?P<stem>.+)\.padded\.(?P<x>\d+)\.(?P<y>\d+)\.(?P<w>\d+)x(?P<h>\d+)\.png"
)


def save_meshlab(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    """Writes the project, and a padded copy of each photo that needs one.

    Raises:
        InputError: if a photo is needed and missing, or its size is not the camera's.
        OutputError: if the files cannot be written there.
    """
    document = ElementTree.Element("MeshLabDocument")
    meshes = ElementTree.SubElement(document, "MeshGroup")
    if cameras.mesh is not None:
        mesh = ElementTree.SubElement(
            meshes,
            "MLMesh",
            label=cameras.mesh.name,
            filename=path_from(path.parent, cameras.mesh),
            visible="1",
        )
        matrix = ElementTree.SubElement(mesh, "MLMatrix44")
        matrix.text = _rows(np.eye(4))
    rasters = ElementTree.SubElement(document, "RasterGroup")
    contents: dict[Path, Content] = {path: ""}
    losses = []
    for name, camera in cameras.cameras.items():
        camera, lost = without(name, camera, "MeshLab", "skew", lens_terms=())
        losses += lost
        padded, corner = centred(camera)
        if padded.width * padded.height > Limits.of_environment().photo_pixels:
            raise InputError(
                f"{name}: its principal point is so far off that a copy padded to "
                f"{padded.width}x{padded.height} px would be needed for MeshLab."
            )
        shift = largest_shift_px(camera, _cropped(padded, corner, camera))
        if shift > SMALL_SHIFT_PX:
            losses.append(
                f"{name} keeps its principal point to the pixel only, the rest is "
                f"turned into its rotation: points move by up to {shift:.2g} px."
            )
        photo = cameras.photos.get(name)
        if _fits(name, camera, photo, padded):
            file = name if photo is None else path_from(path.parent, photo)
        else:
            assert photo is not None  # _fits has refused that.
            x, y = corner
            file = (
                f"{Path(name).stem}.padded.{x}.{y}.{camera.width}x{camera.height}.png"
            )
            # Not all of them in memory at once.
            contents[path.with_name(file)] = functools.partial(
                _padded_png, photo, padded, corner
            )
        raster = ElementTree.SubElement(rasters, "MLRaster", label=name)
        raster.append(_vcg_camera(padded))
        ElementTree.SubElement(raster, "Plane", semantic="1", fileName=file)
    ElementTree.indent(document, " ")
    text = ElementTree.tostring(document, encoding="unicode")
    contents[path] = f"<!DOCTYPE MeshLabDocument>\n<!-- {COMMENT} -->\n{text}\n"
    return Saved(write_files(contents, cameras.files, overwrite), losses)


def centred(camera: Camera) -> tuple[Camera, tuple[int, int]]:
    """The camera of a padded copy whose middle is the principal point.

    Returns:
        The camera, turned by the rest of at most a quarter of a pixel, and where the
        photo's first pixel lies in the copy (x, y).
    """
    sides, corner = [], []
    for size, c in ((camera.width, camera.K[0, 2]), (camera.height, camera.K[1, 2])):
        # On the shorter side of the principal point, so much is missing.
        missing = round(2.0 * c - (size - 1.0))
        corner.append(max(0, -missing))
        sides.append(size + abs(missing))
    K = camera.K.copy()
    K[:2, 2] = 0.5 * (sides[0] - 1) - corner[0], 0.5 * (sides[1] - 1) - corner[1]
    turn = (
        np.eye(3)
        if np.allclose(K, camera.K, rtol=1e-12)
        else compensating_turn(camera, K)
    )
    K[:2, 2] += corner
    R, t = turn @ camera.R_cam_world, turn @ camera.t_cam_world
    return Camera(K, R, t, sides[0], sides[1]), (corner[0], corner[1])


def _cropped(padded: Camera, corner: tuple[int, int], camera: Camera) -> Camera:
    """The camera of the photo itself, out of that of its padded copy."""
    K = padded.K.copy()
    K[:2, 2] -= corner
    return Camera(
        K, padded.R_cam_world, padded.t_cam_world, camera.width, camera.height
    )


def _fits(name: str, camera: Camera, photo: Path | None, padded: Camera) -> bool:
    """Whether the photo can be used as it is, rather than a padded copy."""
    is_centred = (padded.width, padded.height) == (camera.width, camera.height)
    if photo is None:
        if is_centred:
            return True
        raise InputError(
            f"{name}: its principal point is off the middle, for which MeshLab needs a "
            "padded copy of the photo. Give the photos too."
        )
    if displayed_size(photo) != (camera.width, camera.height):
        size = "x".join(map(str, displayed_size(photo)))
        raise InputError(
            f"{photo.name} is {size} px, but its camera is for "
            f"{camera.width}x{camera.height} px."
        )
    # MeshLab shows a photo as it is stored, whatever EXIF says.
    return is_centred and not is_turned(photo)


def _padded_png(path: Path, padded: Camera, corner: tuple[int, int]) -> bytes:
    photo = load_photo(path)
    pixels = np.zeros((padded.height, padded.width, 4), dtype=np.uint8)
    x, y = corner
    inside = pixels[y : y + photo.height, x : x + photo.width]
    inside[:, :, :3] = photo.pixels
    inside[:, :, 3] = 255 if photo.mask is None else np.where(photo.mask, 255, 0)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=3)
    return marked_picture(buffer.getvalue())


def _vcg_camera(camera: Camera) -> ElementTree.Element:
    R = np.eye(4)
    R[:3, :3] = OPENGL_AXES @ camera.R_cam_world
    fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    values = {
        "TranslationVector": _row([*(-camera.center), 1.0]),
        "LensDistortion": "0 0",
        "ViewportPx": f"{camera.width} {camera.height}",
        "PixelSizeMm": _row([1.0, fx / fy]),
        "CenterPx": _row([0.5 * camera.width, 0.5 * camera.height]),
        "FocalMm": repr(fx),
        "RotationMatrix": _row(R.ravel()),
        "CameraType": "0",
        "BinaryData": "0",
    }
    return ElementTree.Element("VCGCamera", values)


def _row(values: object) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(np.asarray(values)))


def _rows(matrix: np.ndarray) -> str:
    return "\n" + "".join(_row(row) + "\n" for row in matrix)


def load_meshlab(path: Path, photos: Mapping[str, Path]) -> dict[str, Camera]:
    """Reads the cameras of a project, MeshLab's own ones included.

    A matrix that MeshLab shows the mesh by is undone: cameras are in the coordinates
    of the mesh's file.

    Raises:
        InputError: if it is not a project, a camera is not valid or has lens
            distortion, or its meshes are placed by different matrices.
    """
    document = read_xml(path, "MeshLab project", "MeshLab")
    # MeshLab reads and writes both.
    if document.tag not in ("MeshLabDocument", "MeshLabProject"):
        raise InputError(f"{path.name} is not a MeshLab project.")
    scale, Q, d = _placement(path.name, document)

    def placed() -> Iterator[tuple[str, Camera]]:
        for name, camera in _cameras(path.name, document, photos):
            R = camera.R_cam_world @ Q
            t = (camera.R_cam_world @ d + camera.t_cam_world) / scale
            yield name, Camera(camera.K, R, t, camera.width, camera.height)

    return cameras_by_name(placed(), path.name)


def _placement(
    file: str, document: ElementTree.Element
) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation and shift by which the project places its meshes."""
    texts = [
        (mesh.findtext("MLMatrix44") or "").split() for mesh in document.iter("MLMesh")
    ]
    matrices = [
        np.reshape(numbers(words, 16, f"{file}, MLMatrix44", "the matrix"), (4, 4))
        for words in texts
        if words
    ]
    if not matrices:
        return 1.0, np.eye(3), np.zeros(3)
    matrix = matrices[0]
    M = matrix[:3, :3]
    scale = float(np.cbrt(max(0.0, np.linalg.det(M))))
    is_similarity = scale > 0.0 and np.allclose(
        M @ M.T, scale**2 * np.eye(3), atol=1e-4 * scale**2
    )
    if not is_similarity or not all(np.allclose(m, matrix) for m in matrices):
        raise InputError(
            f"{file} places its meshes by different or stretching matrices; freeze them "
            "in MeshLab (Matrix: Freeze Current Matrix), save mesh and project, and use "
            "those."
        )
    return scale, M / scale, matrix[:3, 3]


def _cameras(
    file: str, document: ElementTree.Element, photos: Mapping[str, Path]
) -> Iterator[tuple[str, Camera]]:
    for number, raster in enumerate(document.iter("MLRaster"), start=1):
        plane, lens = raster.find("Plane"), raster.find("VCGCamera")
        name = photo_name((plane.get("fileName") if plane is not None else "") or "")
        where = f"{file}, photo {number} ({name})"
        if lens is None:
            raise InputError(f"{where} has no VCGCamera.")
        camera = _camera(lens, where)
        match = PADDED.fullmatch(name)
        label = photo_name(raster.get("label") or "")
        if match and Path(label).stem == match["stem"]:
            size = size_px(match["w"], match["h"], where)
            K = camera.K.copy()
            K[:2, 2] -= float(match["x"]), float(match["y"])
            camera = camera_of(where, K, camera.R_cam_world, camera.t_cam_world, *size)
            name = label
            # Padded copies are upright; what is read here is of the stored pixels.
            camera = cameras_as_stored({name: camera}, photos)[0][name]
        yield name, camera


def _camera(lens: ElementTree.Element, where: str) -> Camera:
    def values(key: str, count: int | tuple[int, ...]) -> list[float]:
        text = lens.get(key)
        if text is None:
            raise InputError(f"{where} lacks {key}.")
        return numbers(text.split(), count, where, key)

    if lens.get("CameraType", "0") != "0" or lens.get("BinaryData", "0") != "0":
        raise InputError(
            f"{where}: only perspective cameras written as text can be read (CameraType "
            "0, BinaryData 0)."
        )
    if lens.get("LensDistortion") is not None:
        refuse_distortion(values("LensDistortion", 2), where)
    viewport = values("ViewportPx", 2)
    width, height = size_px(viewport[0], viewport[1], where)
    (focal,), pixel = values("FocalMm", 1), values("PixelSizeMm", 2)
    if not min(pixel) > 0.0:
        raise InputError(f"{where}: PixelSizeMm should be positive.")
    center = values("CenterPx", 2)
    axes = check_finite_array(
        np.reshape(values("RotationMatrix", 16), (4, 4)), (4, 4), "RotationMatrix"
    )
    R = OPENGL_AXES @ axes[:3, :3]
    C = -np.array(values("TranslationVector", (3, 4))[:3])
    K = intrinsics(
        focal / pixel[0], focal / pixel[1], center[0] - 0.5, height - center[1] - 0.5
    )
    return camera_of(where, K, R, -R @ C, width, height)
