"""A scan with a texture of its own: kept, shown, and no photo."""

import io

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from app.model.state import Document
from photoreg.geometry.camera import Camera
from photoreg.synthetic.rock import rock_mesh
from tests.browser.driver import wait_until
from tests.browser.own_files import drop

OFFSET = np.array([431_250.0, 5_411_800.0, 210.0])
"""Of a survey: east, north and height."""


def encoded(pixels: np.ndarray, format: str, orientation: int = 1) -> bytes:
    stream, exif = io.BytesIO(), Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(stream, format, exif=exif)
    return stream.getvalue()


def textured_scan() -> dict[str, bytes]:
    """A rock with z upwards in a national grid, its MTL, and a striped texture."""
    mesh = rock_mesh(3, subdivisions=2)
    lines = ["mtllib scan.mtl", "usemtl stone"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in (mesh.vertices + OFFSET).tolist()]
    lines += ["vt 0 0", "vt 1 0", "vt 0 1"]
    lines += [
        "f " + " ".join(f"{v + 1}/{i}" for i, v in enumerate(f, 1))
        for f in mesh.faces.tolist()
    ]
    stripes = np.zeros((64, 64, 3), np.uint8)
    stripes[:, ::8] = (250, 40, 20)
    stripes[:, 4::8] = (20, 60, 240)
    return {
        "scan.obj": "\n".join(lines).encode(),
        "scan.mtl": b"newmtl stone\nmap_Kd stone.png\n",
        "stone.png": encoded(stripes, "PNG"),
    }


@pytest.fixture(scope="module")
def app(open_app_once):
    return open_app_once(Document())


def test_a_scan_dropped_with_its_texture_and_a_photo_keeps_the_texture_as_its_own(app):
    driver = app.driver
    expect(driver.page.get_by_text("Drop a scan and your photos here")).to_be_visible()
    # Taken with the phone upright: 6 says that it is to be turned.
    photo = np.full((120, 200, 3), 90, np.uint8)
    photo[20:60, 30:90] = (200, 180, 40)
    drop(driver, {**textured_scan(), "IMG_2041.JPG": encoded(photo, "JPEG", 6)})
    wait_until(
        lambda: app.state.document.mesh is not None and app.state.job is None,
        "it is read",
    )
    (entry,) = app.state.document.photos
    assert (entry.name, entry.photo.width, entry.photo.height) == (
        "IMG_2041.JPG",
        120,
        200,
    )
    mesh = app.state.document.mesh
    assert mesh.own_texture is not None
    assert mesh.own_texture.shape == (64, 64, 3)
    expect(driver.page.locator("[data-photo]")).to_have_count(1)
    # It lies in a national grid, so z is upwards, and the first camera stands upright.
    assert app.state.document.up == (0.0, 0.0, 1.0)
    camera: Camera = entry.camera
    assert -camera.R_cam_world[1] @ (0.0, 0.0, 1.0) > 0.5
    assert camera.contains(camera.project(mesh.vertices)).mean() > 0.9


def test_the_model_wears_its_own_colours_until_they_are_taken_off(app):
    driver = app.driver
    if app.state.document.mesh is None:
        pytest.fail("the test before has opened the scan")

    def shown(name: str) -> bool:
        driver.frames(2)
        return driver.page.evaluate(
            "name => Boolean(__viserMutable.nodeRefFromName[name]?.visible)", name
        )

    wait_until(lambda: shown("/solid/own") and not shown("/solid/clay"), "in colour")
    box = driver.page.get_by_label("Own colours")
    expect(box).to_be_checked()
    box.click()
    wait_until(lambda: shown("/solid/clay") and not shown("/solid/own"), "plain")
    box.click()
    wait_until(lambda: shown("/solid/own") and not shown("/solid/clay"), "in colour")
