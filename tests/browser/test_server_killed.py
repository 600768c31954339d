"""The whole server is killed in the middle of a run; started again, the run goes on."""

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from app.control.autosave import DOCUMENT_TYPES
from app.engine.scene_opening import open_folder
from app.model.run import Run
from photoreg.project.project import Project
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene, write_scene
from tests.browser.driver import Driver, wait_until
from tests.browser.server_program import server


def stored_run(folder: Path) -> tuple[Run, bool]:
    """The run on screen as the project has it, and whether it can go on."""
    project = Project(folder, DOCUMENT_TYPES)
    try:
        unfinished = project.runs.unfinished_run()
        kept = unfinished and project.runs.checkpoint(unfinished.id)
        return project.read_setting("run", Run()), kept is not None
    finally:
        project.close()


@pytest.mark.slow
def test_a_run_goes_on_after_the_server_was_killed_to_the_same_answer(
    chromium: Browser, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    scene = make_scene(
        SceneOptions(kind="clean", width=160, height=120, error_px=(3.0, 4.0))
    )
    write_scene(scene, tmp_path / "scene")
    folder = tmp_path / "work"
    with server(folder, tmp_path / "scene") as (process, address):
        window = chromium.new_page(viewport={"width": 900, "height": 500})
        driver = Driver(window, address)
        driver.tab("3 Refine")
        window.get_by_label("Thoroughness").click()
        window.get_by_role("option", name="Thorough", exact=True).click()
        driver.click("Refine")
        wait_until(lambda: len(stored_run(folder)[0].curve) > 5, "the run is kept")
        process.kill()
        process.wait()
        window.close()
    run, can_go_on = stored_run(folder)
    assert run.is_active
    assert can_go_on
    with server(folder) as (process, address):
        window = chromium.new_page(viewport={"width": 900, "height": 500})
        driver = Driver(window, address)
        driver.tab("3 Refine")
        window.get_by_text("photoreg was ended meanwhile").wait_for()
        driver.click("Go on where it was")
        window.get_by_text("The polish is done.").first.wait_for(timeout=240_000)
        process.kill()
        process.wait()
        window.close()
    answer, can_go_on = stored_run(folder)
    assert not can_go_on, "it came to its end"
    document = open_folder(tmp_path / "scene")
    assert document.mesh is not None
    photos = [entry.photo for entry in document.photos]
    config = RegistrationConfig.preset("thorough")
    *_, last = refine(document.mesh, photos, document.used_cameras, config)
    assert isinstance(last, Finished)
    for ours, direct in zip(answer.cameras, last.cameras, strict=True):
        np.testing.assert_array_equal(ours.P, direct.P)
