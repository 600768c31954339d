"""Fisheyes are refused by name in every format that can hold one, with what to do."""

import json
import struct
from pathlib import Path

import pytest
from PIL import Image

from tests.formats.camera_files import camera_set, refused, write
from tests.formats.cameras.test_alicevision import document as sfm_document
from tests.formats.metashape_files import document as metashape_document


def check(message: str, name: str) -> None:
    assert name in message
    assert "undistort the photos" in message


@pytest.mark.parametrize(
    ("number", "model", "n_parameters"),
    [
        (5, "OPENCV_FISHEYE", 8),
        (8, "SIMPLE_RADIAL_FISHEYE", 4),
        (9, "RADIAL_FISHEYE", 5),
        (10, "THIN_PRISM_FISHEYE", 12),
        (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ],
)
@pytest.mark.parametrize("kind", ["text", "binary"])
def test_colmap_s(tmp_path: Path, number, model, n_parameters, kind):
    parameters = [90.0, *[0.0] * (n_parameters - 1)]
    if kind == "text":
        words = " ".join(map(str, parameters))
        (tmp_path / "cameras.txt").write_text(f"1 {model} 64 48 {words}\n")
        (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    else:
        camera = struct.pack("<iiQQ", 1, number, 64, 48)
        camera += struct.pack(f"<{n_parameters}d", *parameters)
        (tmp_path / "cameras.bin").write_bytes(struct.pack("<Q", 1) + camera)
        image = struct.pack("<i7di", 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0"
        image += struct.pack("<Q", 0)
        (tmp_path / "images.bin").write_bytes(struct.pack("<Q", 1) + image)
    check(refused(tmp_path), model)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("camera_model", "OPENCV_FISHEYE"),
        ("camera_model", "FISHEYE624"),
        ("camera_model", "EQUIRECTANGULAR"),
        ("is_fisheye", True),
    ],
)
@pytest.mark.parametrize("of", ["all", "one"])
def test_nerfstudio_s(tmp_path, photo_folder, key, value, of):
    path, _ = write(tmp_path, "nerfstudio", camera_set(photo_folder))
    document = json.loads(path.read_text(encoding="utf-8"))
    document.pop("camera_model")
    (document if of == "all" else document["frames"][1])[key] = value
    path.write_text(json.dumps(document), encoding="utf-8")
    check(refused(path), value if isinstance(value, str) else key)


@pytest.mark.parametrize("key", ["model", "lens_type", "distortion_model"])
@pytest.mark.parametrize("name", ["photoreg", "opencv"])
def test_of_files_with_a_key_that_says_so(tmp_path, photo_folder, name, key):
    path, _ = write(tmp_path, name, camera_set(photo_folder))
    text = path.read_text(encoding="utf-8")
    if name == "photoreg":
        text = json.dumps({**json.loads(text), key: "fisheye"})
    else:
        text += f"{key}: fisheye\n"
    path.write_text(text, encoding="utf-8")
    check(refused(path), "fisheye")


@pytest.mark.parametrize("kind", ["fisheye", "equisolid_fisheye", "spherical"])
def test_metashape_s(tmp_path, kind):
    Image.new("RGB", (1200, 900)).save(tmp_path / "a.png")
    path = tmp_path / "cameras.xml"
    path.write_text(metashape_document(sensor=f'type="{kind}"'))
    check(refused(path), kind)


@pytest.mark.parametrize("kind", ["fisheye", "fisheye1"])
def test_alicevision_s(tmp_path, kind):
    path = tmp_path / "cameras.sfm"
    path.write_text(json.dumps(sfm_document(distortionType=kind)))
    check(refused(path), kind)
    path.write_text(json.dumps(sfm_document(type="equidistant")))
    check(refused(path), "equidistant")
