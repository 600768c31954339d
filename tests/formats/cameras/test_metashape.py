"""Metashape's cameras XML: what its numbers mean, and what is refused by name."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from photoreg.errors import InputError
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import read_cameras, write_cameras
from tests.formats.metashape_files import (
    B1,
    B2,
    C_CHUNK,
    CALIBRATION,
    CX,
    CY,
    K1,
    K2,
    K3,
    P1,
    P2,
    PLACE,
    R_CHUNK_CAM,
    SCALE,
    SHIFT,
    F,
    Q,
    document,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    Image.new("RGB", (1200, 900)).save(tmp_path / "a.png")
    return tmp_path


def read(folder: Path, text: str):
    (folder / "cameras.xml").write_text(text, encoding="utf-8")
    return read_cameras(folder / "cameras.xml", photos=[folder / "a.png"])


def as_metashape_projects(points_world: np.ndarray) -> np.ndarray:
    """Word by word as its manual has it, pixel (0, 0) the first one's corner."""
    pixels = []
    for world in points_world:
        chunk = Q.T @ (world - SHIFT) / SCALE
        X, Y, Z = R_CHUNK_CAM.T @ (chunk - C_CHUNK)
        x, y = X / Z, Y / Z
        r2 = x * x + y * y
        radial = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
        u = x * radial + P1 * (r2 + 2 * x * x) + 2 * P2 * x * y
        v = y * radial + P2 * (r2 + 2 * y * y) + 2 * P1 * x * y
        pixels.append([600 + CX + u * F + u * B1 + v * B2, 450 + CY + v * F])
    return np.array(pixels)


def test_a_camera_projects_as_metashape_does(folder):
    file = read(folder, document())
    (camera,) = file.cameras.values()
    in_camera = np.random.default_rng(0).uniform([-3, -2, 4], [3, 2, 9], (50, 3))
    points = ((in_camera @ R_CHUNK_CAM.T + C_CHUNK) * SCALE) @ Q.T + SHIFT
    ours = camera.project(points) + 0.5
    np.testing.assert_allclose(ours, as_metashape_projects(points), atol=1e-9)
    assert (camera.width, camera.height) == (1200, 900)
    # The label lacks the photo's suffix; a photo that was not aligned is told.
    assert list(file.cameras) == ["a.png"]
    assert "did not align 1 photos of cameras.xml (b)" in file.notes[0]


def test_a_component_has_a_place_of_its_own(folder):
    (by_chunk,) = read(folder, document()).cameras.values()
    component = f'<components><component id="0">{PLACE}</component></components>'
    text = document(place="", chunk=component, camera='label="a.png" component_id="0"')
    (by_component,) = read(folder, text).cameras.values()
    np.testing.assert_array_equal(by_chunk.P, by_component.P)
    (bare,) = read(folder, document(place="")).cameras.values()
    np.testing.assert_allclose(bare.center, C_CHUNK, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"calibration": CALIBRATION + "<k4>0.1</k4>"}, "k4"),
        ({"calibration": CALIBRATION + "<p3>0.1</p3>"}, "p3"),
        ({"calibration": CALIBRATION + "<w9>0.1</w9>"}, "w9"),
        ({"calibration": "<cx>1</cx>"}, "lacks f"),
        ({"calibration": "<f>nan</f>"}, "finite"),
        ({"sensor": 'type="fisheye"'}, "fisheye"),
        ({"within": '<property name="rolling_shutter" value="true"/>'}, "rolling_sh"),
        ({"camera": 'label="a" master_id="3"'}, "master_id"),
        ({"camera": 'label="a" component_id="7"'}, "component 7"),
        ({"chunk": '<reference>GEOGCS["WGS 84",DATUM[]]</reference>'}, "WGS 84"),
        ({"place": PLACE.replace(str(SCALE), "-1")}, "a rotation and a scale"),
        ({"place": PLACE.replace("<scale>", "<scale>3 ")}, "the scale"),
    ],
)
def test_what_is_not_known_is_refused_by_name(folder, change, named):
    with pytest.raises(InputError, match=named):
        read(folder, document(**change))


def test_terms_that_are_0_and_local_coordinates_are_fine(folder):
    local = '<reference>LOCAL_CS["Local Coordinates (m)",UNIT["metre",1]]</reference>'
    text = document(CALIBRATION + "<k4>0</k4><p3>0.0</p3>", chunk=local)
    (camera,) = read(folder, text).cameras.values()
    assert camera.lens.terms == (K1, K2, P2, P1, K3)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("<scene/>", "only XML that photoreg reads"),
        ("<document></document>", "0 chunks with aligned cameras"),
        ("<document><chunk></document>", "is not XML"),
        ("<document><chunk/></document>", "0 chunks with aligned cameras"),
        ('<!DOCTYPE d [<!ENTITY a "b">]><document/>', "defines entities"),
    ],
)
def test_other_xml_is_refused(folder, text, named):
    with pytest.raises(InputError, match=named):
        read(folder, text)


def test_it_cannot_be_written(folder):
    cameras = CameraSet(read(folder, document()).cameras)
    with pytest.raises(InputError, match="cannot write"):
        write_cameras(folder / "new.xml", cameras, "metashape")
