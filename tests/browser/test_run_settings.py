"""What a run is told: what may move, how thoroughly, every setting by hand."""

import numpy as np
import pytest

from app.model.run import PRESET_NAMES
from app.model.session import setting
from app.panels.advanced import all_settings
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.search.box_reach import box_reach
from tests.browser.driver import wait_until
from tests.browser.refine_runs import QUICK, drop, open_to_refine, start, to_its_end


@pytest.fixture(scope="module")
def app(open_app_once):
    return open_to_refine(open_app_once)


def test_what_is_ticked_stays_to_the_last_bit(app):
    first, second = (entry.camera for entry in app.state.document.photos)
    app.driver.page.get_by_text("What may move").click()
    app.driver.frames(2)
    keep_focal = app.driver.page.get_by_label("Lock zoom")
    keep_focal.nth(1).check()
    for label in ("Lock position", "Lock zoom", "Lock image centre"):
        app.driver.page.get_by_label(label).nth(0).check()
    wait_until(lambda: len(app.state.held) == 4, "the ticks arrive")
    start(app, QUICK, hold=False)
    to_its_end(app)
    kept, moved = app.state.run.cameras
    np.testing.assert_array_equal(kept.K, first.K)
    np.testing.assert_array_equal(kept.R_cam_world, first.R_cam_world)
    np.testing.assert_array_equal(kept.t_cam_world, first.t_cam_world)
    assert moved.focal_px == second.focal_px
    assert not np.array_equal(moved.t_cam_world, second.t_cam_world)
    app.session.change(None, setting(held=()))
    drop(app)


def test_photos_that_share_a_focal_length_have_one_all_the_way(app):
    window = app.driver.page
    one_focal = window.get_by_label("Same zoom for all")
    # After the run before, the fold is just coming back.
    window.get_by_text("What may move").wait_for()
    app.driver.frames(3)
    if not one_focal.is_visible():
        window.get_by_text("What may move").click()
    begun = [entry.camera.K[0, 0] for entry in app.state.document.photos]
    assert begun[0] != begun[1], "nothing would be told"
    one_focal.check()
    wait_until(lambda: app.state.one_focal, "the tick arrives")
    told: list[list[float]] = []
    leave = app.session.listen(
        lambda _, new: (
            told.append([camera.K[0, 0] for camera in new.run.cameras])
            if new.run.curve
            else None
        )
    )
    start(app, QUICK, hold=False)
    to_its_end(app)
    leave()
    assert len(told) > 3
    assert all(first == second for first, second in told)
    assert len({first for first, _ in told}) > 1, "it moves"
    app.session.change(None, setting(one_focal=False))
    drop(app)


def test_each_preset_is_chosen_by_its_plain_name_and_the_box_is_told_in_pixels(app):
    window = app.driver.page
    reaches: dict[PresetName, float] = {}
    presets: list[tuple[PresetName, str]] = [*PRESET_NAMES.items()]
    for preset, name in (*presets, presets[1]):
        window.get_by_label("Thoroughness").click()
        window.get_by_role("option", name=name, exact=True).click()
        wait_until(lambda preset=preset: app.state.preset == preset, name)
        assert app.state.settings == RegistrationConfig.preset(preset)
        config = app.state.settings
        expected = box_reach(
            app.state.document.mesh,
            app.state.document.used_cameras,
            config.box,
            config.camera_model,
            config.coordinates,
        )
        wait_until(lambda e=expected: app.state.reach == e, "the reach is measured")
        window.get_by_text(f"Looks about {expected.typical_px:.0f} px").wait_for()
        reaches[preset] = expected.typical_px
    assert reaches["thorough"] > 1.5 * reaches["default"]


def test_every_setting_is_in_the_fold_with_its_help_and_a_wrong_value_is_refused(app):
    window, usual = app.driver.page, RegistrationConfig.preset(app.state.preset)
    window.get_by_text("Advanced", exact=True).click()
    app.driver.frames(2)
    for found in all_settings(RegistrationConfig):
        assert found.help, found.path
        assert window.get_by_text(found.label, exact=True).count() > 0, found.path
    samples = window.get_by_label("Samples", exact=True)
    samples.fill("700")
    samples.press("Tab")
    wait_until(lambda: app.state.settings.samples == 700, "the setting arrives")
    window.get_by_text("Changed against the preset: samples.").wait_for()
    samples.fill("-5")
    samples.press("Tab")
    window.get_by_text("The setting stays as it was.").wait_for()
    assert app.state.settings.samples == 700
    app.driver.click("Back to the preset")
    wait_until(lambda: app.state.settings == usual, "all is as the preset has it")
    app.driver.dismiss_toasts()
    window.get_by_text("Advanced", exact=True).click()
