"""The Export tab in a real browser: the texture and the files to take home."""

import io
import json
import zipfile
from typing import Any

import pytest
import trimesh

from photoreg.formats.cameras.camera_set import largest_shift_px
from photoreg.formats.cameras.registry import read_cameras
from tests.browser.app import App
from tests.browser.driver import wait_until


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
