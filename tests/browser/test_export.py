"""The Export tab in a real browser: the texture and the files to take home."""

import contextlib
import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Browser

from app.control.controller import Controller
from app.control.project_reading import read_all
from app.control.projects import Projects
from app.model.masks import encode_mask
from app.model.session import Session, setting, with_document, with_entry
from app.model.state import ModelChoice, PhotoEntry
from app.page.main import open_project
from app.page.server import Page
from photoreg.formats.cameras.camera_set import largest_shift_px
from photoreg.formats.cameras.registry import read_cameras
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.imaging.photo import Photo
from photoreg.texture.config import TextureConfig
from tests.browser.app import App
from tests.browser.driver import Driver, wait_until


def downloaded(driver, button: str) -> tuple[str, bytes]:
    """What the page gives to the person who clicks ``button``."""
    with driver.page.expect_download() as download:
        driver.click(button)
    return download.value.suggested_filename, download.value.path().read_bytes()


@pytest.fixture(scope="module")
def app(open_app_once, toy_document) -> App:
    """One app for both tests, with the Export tab open."""
    app = open_app_once(toy_document)
    app.driver.dismiss_toasts()
    app.driver.tab("4 Export")
    return app


def test_cancel_ends_the_making_of_a_texture(app):
    driver = app.driver
    driver.choose("Size", "8192")
    driver.click("Make the texture")
    driver.click("Cancel")
    wait_until(lambda: app.state.job is None, "it ends", 120)
    assert app.state.texture is None
    driver.page.get_by_text("Not made yet.").wait_for()


def test_the_texture_is_made_as_chosen_and_downloaded_as_glb(
    app, toy_document, tmp_path
):
    driver = app.driver
    driver.choose("Size", "1024")
    driver.choose("Photos", "Best view")
    driver.choose("Unseen", "One colour")
    driver.choose("File", "GLB")
    driver.choose("Picture", "JPEG")
    wait_until(lambda: app.state.model_choice.picture == "jpeg", "the choice arrives")
    config = app.state.texture_config
    assert (config.size, config.mode, config.unseen) == (1024, "best", "colour")
    driver.click("Make the texture")
    wait_until(lambda: app.state.texture is not None, "the texture is made", 180)
    driver.page.get_by_text("Texture of 1024").wait_for()
    # These photos are of blotches, which no cameras agree about.
    driver.page.get_by_text("⚠ Unconvincing: in toy-0.png").wait_for()
    driver.page.get_by_text("Which photo paints where").click()
    driver.page.get_by_alt_text("Which photo paints where").wait_for()
    name, content = downloaded(driver, "Download the model")
    assert name.endswith(".glb")
    loaded: Any = trimesh.load(
        io.BytesIO(content), file_type="glb", force="mesh", process=False
    )
    assert len(loaded.faces) == len(toy_document.mesh.faces)
    assert max(loaded.visual.material.baseColorTexture.size) == 1024
    driver.choose("Photos", "Blend")
    driver.page.get_by_text("Make it again; the last time took").wait_for()

    # The cameras, in the same app: for another program, as one file.
    driver.page.get_by_role("combobox", name="For", exact=True).click()
    driver.page.get_by_role("option", name="MeshLab (.mlp)").click()
    driver.page.get_by_text("by padded copies of the photos").wait_for()
    name, content = downloaded(driver, "Download the cameras")
    assert name == "cameras-meshlab.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(tmp_path)
    read = read_cameras(tmp_path / "cameras.mlp").cameras
    for entry in toy_document.photos:
        assert largest_shift_px(entry.camera, read[entry.name]) < 0.05
    driver.page.get_by_role("combobox", name="For", exact=True).click()
    driver.page.get_by_role("option", name="photoreg (JSON)").click()
    driver.page.get_by_text("Keeps everything.").wait_for()
    name, content = downloaded(driver, "Download the cameras")
    assert name == "cameras.json"
    entries = json.loads(content)["cameras"]
    assert [e["photo"] for e in entries] == [e.name for e in toy_document.photos]


def seen(camera: Camera) -> np.ndarray:
    """What a camera at its place sees of far waves of colour, pixel by pixel.

    They are a function of the direction alone, so a lens and an ideal one are rendered
    exactly; half a wave is 15 px or more.
    """
    rows, columns = np.mgrid[: camera.height, : camera.width]
    _, rays = camera.rays(np.stack([columns.ravel(), rows.ravel()], axis=1) * 1.0)
    x, y, z = (rays @ camera.R_cam_world.T).T
    waves = np.array([[55.0, 20.0], [-30.0, 50.0], [15.0, -60.0]])
    light = 128 + 90 * np.sin(np.stack([x / z, y / z], axis=1) @ waves.T)
    return np.rint(light).astype(np.uint8).reshape(camera.height, camera.width, 3)


def test_undistorted_photos_are_as_a_pinhole_camera_would_have_taken_them(
    app, toy_document, tmp_path
):
    camera = Camera.look_at([3, 1, 2], [0, 0, 0.1], [0, 0, 1], 300.0, 320, 240)
    camera = camera.with_lens(Lens(k1=-0.1))
    entry = PhotoEntry(Photo("bent.png", seen(camera)), camera)
    app.session.change("Open", with_document(photos=(entry,)))
    driver = app.driver
    driver.page.get_by_role("combobox", name="For", exact=True).click()
    driver.page.get_by_role("option", name="COLMAP (binary)").click()
    driver.page.get_by_role("checkbox", name="Undistorted").check()
    wait_until(lambda: app.state.cameras_choice.undistorted, "the choice arrives")
    name, content = downloaded(driver, "Download the cameras")
    assert name == "cameras-colmap.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(tmp_path)
    (read,) = read_cameras(tmp_path / "sparse" / "0").cameras.values()
    assert read.lens.is_ideal
    assert largest_shift_px(camera.pinhole, read) < 1e-6
    with Image.open(tmp_path / "images" / "bent.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(float)
    expected = seen(camera.pinhole)
    error = np.abs(pixels - expected)
    # Cubic interpolation between rounded levels; the bent photo is 15 levels off.
    assert error.mean() < 0.6, error.mean()
    assert error.max() < 4.0, error.max()
    bent = np.abs(seen(camera).astype(float) - expected).mean()
    assert bent > 10.0, bent
    app.session.change("Open", with_document(photos=toy_document.photos))


@contextlib.contextmanager
def app_on_project(chromium: Browser, folder: Path) -> Iterator[App]:
    """The app on a project, with the Export tab open; it is closed as a person closes it."""
    session = Session()
    projects = Projects(session, read=read_all)
    open_project(projects, (), None, folder)
    controller = Controller(session, warm_up=False, projects=projects)
    page = Page(session, controller, port=0, shadows=False, surroundings=False)
    window = chromium.new_page(viewport={"width": 1100, "height": 700})
    try:
        app = App(
            session, controller, page, Driver(window, f"http://127.0.0.1:{page.port}")
        )
        app.driver.dismiss_toasts()
        app.driver.tab("4 Export")
        yield app
    finally:
        window.close()
        page.close()
        controller.close()
        projects.close()


def test_a_texture_is_there_when_its_project_is_opened_again(
    chromium, toy_document, tmp_path, monkeypatch
):
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    with app_on_project(chromium, tmp_path / "work") as app:
        app.session.change("Open", with_document(**vars(toy_document)))
        choices = {"texture_config": TextureConfig(size=256)}
        app.session.change(None, setting(model_choice=ModelChoice("glb"), **choices))
        app.driver.click("Make the texture")
        wait_until(lambda: app.state.texture is not None, "the texture is made", 180)
        made = downloaded(app.driver, "Download the model")
    with app_on_project(chromium, tmp_path / "work") as app:
        app.driver.page.get_by_text("Texture of 256").wait_for()
        app.driver.frames(3)
        shown = "() => __viserMutable.nodeRefFromName['/solid/textured']?.visible"
        wait_until(lambda: app.driver.page.evaluate(shown), "the model wears it", 30)
        assert downloaded(app.driver, "Download the model") == made
    # With another mask it would be another model.
    with app_on_project(chromium, tmp_path / "work") as app:
        photo = app.state.document.photos[0].photo
        mask = encode_mask(np.arange(photo.width) < np.full((photo.height, 1), 40))
        app.session.change("Paint the mask", with_entry(0, mask_png=mask))
        changed = app.driver.page.get_by_text(
            "⚠ Cameras, masks or settings have changed"
        )
        changed.wait_for()
        app.driver.click("Download the model")
        app.driver.page.get_by_text("Make it anew").wait_for()
        app.session.undo()
        changed.wait_for(state="hidden")
        assert downloaded(app.driver, "Download the model") == made
