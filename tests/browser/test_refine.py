"""A run in the page: started, paused, stopped, reverted, held, seen twice, survived; what
it shows and tells meanwhile."""

import contextlib
import dataclasses
import hashlib
import logging
import multiprocessing
import os
import re
import resource
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.control.user_data import log_into
from app.model.camera_moves import orbited
from app.model.formatting import in_words, number
from app.model.reducers import has_moved
from app.model.run import PRESET_NAMES
from app.model.session import looking_at, setting, with_entry
from app.model.state import Document, PhotoEntry
from app.panels.advanced import all_settings
from app.panels.overlay import LEVEL, RESTART
from photoreg.geometry.camera import Camera
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.search.box_reach import box_reach
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from tests.browser.driver import Driver, wait_until

# What the overlay shows, by content: a picture sent anew is no other picture.
WATCH_OVERLAY = """() => {
  window.overlays = new Set();
  const image = [...document.querySelectorAll('img[src^="blob:"]')]
    .find(image => image.checkVisibility());
  const keep = async () => {
    const content = await (await fetch(image.src)).arrayBuffer();
    const digest = await crypto.subtle.digest('SHA-256', content);
    overlays.add(new Uint8Array(digest).join());
  };
  new MutationObserver(() => keep().catch(() => {}))  // It may be replaced by now.
    .observe(image, {attributes: true, attributeFilter: ['src']});
}"""

# Whether the object in the 3-D view wears so many photos.
WEARS_PHOTOS = """n =>
  Object.entries(__viserMutable.nodeRefFromName).some(([name, node]) => {
    let worn = 0;
    if (name.startsWith('/solid/run-'))
      node?.traverse(part => { worn += part.material?.map?.image?.width > 0; });
    return worn === n;
  })"""

# Whether the cost curve has dots of a colour, given as #rrggbb.
PLOT_HAS = """colour => {
  const wanted = [1, 3, 5].map(i => parseInt(colour.slice(i, i + 2), 16));
  const plot = document.querySelector('.uplot canvas');
  const {data} = plot.getContext('2d').getImageData(0, 0, plot.width, plot.height);
  let found = 0;
  for (let i = 0; i < data.length; i += 4)
    found += data[i + 3] > 200 && wanted.every((v, k) => Math.abs(data[i + k] - v) < 8);
  return found >= 9;
}"""


@pytest.fixture(scope="module")
def app(open_app_once):
    """One app for all tests here: a worker compiles for long."""
    scene = make_scene(
        SceneOptions(kind="clean", width=160, height=120, error_px=(3.0, 4.0))
    )
    entries = tuple(map(PhotoEntry, scene.photos, scene.rough_cameras))
    names = [photo.name for photo in scene.photos]
    truth = tuple(zip(names, scene.cameras, strict=True))
    app = open_app_once(
        Document(scene.mesh, scene.mesh.decimated(5_000), entries, truth)
    )
    app.driver.dismiss_toasts()
    app.driver.tab("3 Refine")
    return app


def start(app, preset: PresetName = "thorough", hold: bool = True) -> None:
    """Starts a run and waits until it has something to offer; then holds it there.

    Held, it does not end by itself while a slow browser makes ready to click.
    """
    app.session.change(None, setting(preset=preset))
    wait_until(lambda: app.state.worker == "", "the worker is ready", 120)
    app.driver.click("Refine")
    wait_until(
        # The first generation's best may beat the start already: the curve begins there.
        lambda: (
            any(point.best < 1.0 for point in app.state.run.curve)
            and has_moved(app.state.run)
        ),
        "the run finds something better",
        240,
    )
    if hold:
        app.controller.refinement.pause()
        wait_until(lambda: app.state.run.status == "paused", "it pauses")


def drop(app) -> None:
    """Leaves the run, which goes on, is paused, or has ended."""
    if app.state.run.is_active:
        app.driver.click("Stop and revert")
        # It may have ended by itself at that very moment.
        wait_until(lambda: not app.state.run.is_active, "it stops", 60)
    if app.state.run.status == "review":
        app.driver.click("Revert")
    wait_until(lambda: app.state.run.status == "idle", "it is dropped")
    app.driver.frames(2)


def choose(app, dropdown: str, option: str) -> None:
    """Chooses of a dropdown what begins like this."""
    window = app.driver.page
    window.get_by_label(dropdown, exact=True).locator("visible=true").click()
    # The options of other dropdowns are in the page too, unseen.
    options = window.get_by_role("option", name=re.compile(f"^{option}"))
    options.locator("visible=true").click()


def to_its_end(app) -> None:
    wait_until(lambda: app.state.run.status == "review", "the run ends", 240)


def test_different_overlays_arrive_while_the_best_cost_only_falls(app):
    wait_until(lambda: app.controller.picture is not None, "the start is drawn")
    app.driver.frames(3)
    app.driver.page.evaluate(WATCH_OVERLAY)
    start(app, hold=False)
    app.driver.page.wait_for_function("() => overlays.size >= 5", timeout=120_000)
    app.driver.page.wait_for_function(WEARS_PHOTOS, arg=2, timeout=120_000)
    app.controller.refinement.pause()
    costs = [point.best for point in app.state.run.curve]
    assert costs[-1] < costs[0]
    assert costs == sorted(costs, reverse=True)
    drop(app)


def test_a_paused_run_stands_still_and_goes_on_when_resumed(app):
    start(app, hold=False)
    app.driver.click("Pause")
    wait_until(lambda: app.state.run.status == "paused", "it pauses")
    app.driver.page.get_by_role("status").get_by_text("Paused: ").wait_for()
    # What was on its way arrives; then nothing more comes.
    app.driver.page.wait_for_timeout(500)
    before = app.state.run.evaluations, len(app.state.run.curve)
    app.driver.page.wait_for_timeout(700)
    assert (app.state.run.evaluations, len(app.state.run.curve)) == before
    assert app.state.run.status == "paused"
    app.driver.click("Resume")
    wait_until(lambda: len(app.state.run.curve) > before[1], "it goes on")
    costs = [point.best for point in app.state.run.curve]
    assert costs == sorted(costs, reverse=True)
    drop(app)


def test_stop_and_revert_leaves_the_cameras_as_they_were(app):
    document = app.state.document
    start(app)
    app.driver.click("Stop and revert")
    wait_until(lambda: app.state.run.status == "idle", "it stops", 60)
    assert app.state.document is document
    assert app.state.undo_name is None, "a run that was dropped is no step of undo"


def test_stop_and_keep_offers_the_best_so_far(app):
    start(app)
    app.driver.click("Stop and keep the best")
    wait_until(lambda: app.state.run.status == "review", "it stops", 60)
    assert app.state.run.curve[-1].best < 1.0
    app.driver.click("Accept")
    wait_until(lambda: app.state.undo_name == "Refine", "the cameras are taken")
    app.driver.click("Undo: Refine")
    wait_until(lambda: app.state.undo_name is None, "undo takes it back")


def test_a_stopped_run_goes_on_and_may_be_stopped_again(app):
    start(app)
    app.driver.click("Stop and keep the best")
    wait_until(lambda: app.state.run.status == "review", "it stops", 60)
    number, course = app.state.run.number, app.state.run.curve
    app.driver.click("Go on where it was")
    wait_until(
        lambda: app.state.run.is_active and len(app.state.run.curve) > len(course),
        "it goes on",
    )
    assert app.state.run.number == number
    costs = [point.best for point in app.state.run.curve]
    assert costs == sorted(costs, reverse=True)
    drop(app)


def test_what_is_ticked_stays_to_the_last_bit(app):
    first, second = (entry.camera for entry in app.state.document.photos)
    app.driver.page.get_by_text("What may move").click()
    app.driver.frames(2)
    keep_focal = app.driver.page.get_by_label("Keep focal")
    keep_focal.nth(1).check()
    for label in ("Keep place", "Keep focal", "Keep centre"):
        app.driver.page.get_by_label(label).nth(0).check()
    wait_until(lambda: len(app.state.held) == 4, "the ticks arrive")
    start(app, "fast", hold=False)
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
    one_focal = window.get_by_label("One focal")
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
    start(app, "fast", hold=False)
    to_its_end(app)
    leave()
    assert len(told) > 3
    assert all(first == second for first, second in told)
    assert len({first for first, _ in told}) > 1, "it moves"
    app.session.change(None, setting(one_focal=False))
    drop(app)


def test_another_browser_sees_the_run_and_may_stop_it(app, chromium):
    start(app)
    window = chromium.new_page(viewport={"width": 1100, "height": 700})
    try:
        other = Driver(window, f"http://127.0.0.1:{app.page.port}")
        other.tab("3 Refine")
        other.page.get_by_role("status").get_by_text("Paused: generation").wait_for()
        other.click("Stop and keep the best")
        wait_until(lambda: app.state.run.status == "review", "it ends", 60)
        other.page.get_by_role("button", name="Accept", exact=True).wait_for()
    finally:
        window.close()
    drop(app)


def test_a_killed_worker_costs_no_work_and_the_next_run_ends(app):
    start(app)
    os.kill(app.controller.worker.pid, signal.SIGKILL)
    wait_until(lambda: app.state.run.status == "review", "the page knows", 5)
    assert "died" in app.state.run.outcome
    assert app.state.run.cameras
    app.driver.page.get_by_text("Tab 3 has it as it was").wait_for()
    app.driver.page.get_by_role("button", name="Go on where it was").wait_for()
    drop(app)
    start(app, "fast", hold=False)
    to_its_end(app)
    drop(app)
    assert "died" not in app.state.runs[-1].outcome


class BreaksInPolish(RegistrationConfig):
    """Settings at which the engine breaks when the search has ended."""

    def __repr__(self) -> str:
        return repr(
            RegistrationConfig(**vars(self))
        )  # What a checkpoint knows them by.

    def __getattribute__(self, name: str) -> Any:
        if name == "polish" and multiprocessing.parent_process() is not None:
            raise ZeroDivisionError("of the test")
        return super().__getattribute__(name)


def test_a_run_that_breaks_midway_is_told_kept_and_logged_and_goes_on(app, tmp_path):
    handler = log_into(tmp_path)
    assert handler is not None
    sound = RegistrationConfig.preset("fast")
    broken = BreaksInPolish(**vars(sound))
    try:
        app.session.change(None, setting(preset="fast", config=broken))
        app.driver.click("Refine")
        to_its_end(app)
    finally:
        logging.getLogger().removeHandler(handler)
        handler.close()
    window = app.driver.page
    window.get_by_text(
        "The refinement was cut short: photoreg did not foresee this; photoreg.log in "
        "the project's folder has the details. Tab 3 has it as it was, to go on with.",
        exact=True,
    ).wait_for()
    run = app.state.run
    assert run.outcome == "The refinement failed; this is the best until then."
    assert has_moved(run)
    assert run.curve[-1].best < 1.0
    text = (tmp_path / "photoreg.log").read_text()
    assert text.count("Traceback") == 1
    assert "Refine failed" in text
    assert text.rstrip().endswith("ZeroDivisionError: of the test")
    assert len(text) < 5000, "the lines of code, and nothing of the photos"
    # What broke it is gone: it goes on, and the next run works from its start.
    run = dataclasses.replace(run, config=sound)
    app.session.change(None, setting(run=run, config=None))
    app.driver.click("Go on where it was")
    wait_until(lambda: app.state.run.start_cost is not None, "it ends", 240)
    assert not app.state.can_go_on
    drop(app)
    start(app, "fast", hold=False)
    to_its_end(app)
    assert app.state.run.start_cost is not None
    drop(app)


class StarvesInPolish(RegistrationConfig):
    """Settings at which the engine gets no more memory when the search has ended."""

    __repr__ = BreaksInPolish.__repr__

    def __getattribute__(self, name: str) -> Any:
        if name == "polish" and multiprocessing.parent_process() is not None:
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            used = pages * resource.getpagesize()
            _, most = resource.getrlimit(resource.RLIMIT_AS)
            resource.setrlimit(resource.RLIMIT_AS, (used + 1_000_000, most))
        return super().__getattribute__(name)


@pytest.mark.skipif(sys.platform != "linux", reason="limits memory as Linux does")
def test_a_run_without_memory_for_its_polish_ends_and_the_next_one_works(app):
    worker = app.controller.worker
    sound = RegistrationConfig.preset("fast")
    app.session.change(
        None, setting(preset="fast", config=StarvesInPolish(**vars(sound)))
    )
    app.driver.click("Refine")
    to_its_end(app)
    # The engine goes on where it can tell what failed, and is started anew where not.
    app.driver.page.get_by_text("The refinement was cut short: ").first.wait_for()
    assert "this is the best until then" in app.state.run.outcome
    assert has_moved(app.state.run)
    with contextlib.suppress(ProcessLookupError):
        limits = resource.prlimit(worker.pid, resource.RLIMIT_AS)
        resource.prlimit(worker.pid, resource.RLIMIT_AS, (limits[1], limits[1]))
    drop(app)
    app.session.change(None, setting(config=None))
    start(app, "fast", hold=False)
    to_its_end(app)
    assert app.state.run.start_cost is not None
    drop(app)


def test_a_page_that_is_closed_stops_nothing_and_shows_the_run_when_it_comes_back(app):
    start(app)
    window = app.driver.page
    window.goto("about:blank")
    n_points = len(app.state.run.curve)
    app.controller.refinement.resume()
    wait_until(lambda: len(app.state.run.curve) > n_points + 2, "it goes on unseen")
    app.controller.refinement.pause()
    app.driver = Driver(window, f"http://127.0.0.1:{app.page.port}")
    app.driver.dismiss_toasts()
    app.driver.tab("3 Refine")
    window.get_by_role("status").get_by_text("Paused: generation").wait_for()
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


def test_a_blink_shows_both_photos_in_turn(app):
    start(app)
    app.driver.choose("Style", "Blink")
    wait_until(
        lambda: app.controller.drawn.other_jpeg is not None, "both pictures are drawn"
    )
    app.driver.frames(2)
    app.driver.page.evaluate(WATCH_OVERLAY)
    app.driver.page.wait_for_function("() => overlays.size >= 2", timeout=30_000)
    drawn = app.controller.drawn
    expected = {
        ",".join(map(str, hashlib.sha256(jpeg).digest()))
        for jpeg in (drawn.jpeg, drawn.other_jpeg)
    }
    # What was shown when the style was chosen may be among them.
    assert expected <= set(app.driver.page.evaluate("() => [...overlays]"))
    app.driver.choose("Style", "Blend")
    drop(app)


def test_restarts_and_levels_are_marked_on_the_curve(app):
    window = app.driver.page
    fast = RegistrationConfig.preset("fast")
    twice = dataclasses.replace(fast.genetic, restarts=2)
    config = dataclasses.replace(fast, genetic=twice)
    app.session.change(None, setting(preset="fast", config=config))
    app.driver.click("Refine")
    to_its_end(app)
    marks = [point.mark for point in app.state.run.curve]
    assert marks.count("restart") == 1
    assert marks.count("level") >= len(fast.polish.blurs_px)
    for colour in (RESTART, LEVEL):
        window.wait_for_function(PLOT_HAS, arg=colour, timeout=30_000)
    app.session.change(None, setting(config=None))
    drop(app)


def test_refining_again_takes_the_cameras_and_starts_from_them(app):
    start(app)
    app.driver.click("Stop and keep the best")
    wait_until(lambda: app.state.run.status == "review", "it stops", 60)
    first, before = app.state.run, app.state.document
    app.driver.click("Refine again from here")
    wait_until(lambda: app.state.run.number == first.number + 1, "another run starts")
    assert app.state.run.start == first.cameras
    assert tuple(entry.camera for entry in app.state.document.photos) == first.cameras
    app.controller.refinement.pause()
    drop(app)
    app.driver.click("Undo: Refine")
    wait_until(lambda: app.state.document is before, "undo takes it back")


def test_an_answer_on_the_border_of_its_box_says_so_and_what_to_do(app):
    fast = RegistrationConfig.preset("fast")
    narrow = dataclasses.replace(fast, box=fast.box.widened(0.1))
    app.session.change(None, setting(preset="fast", config=narrow))
    app.driver.click("Refine")
    to_its_end(app)
    told = app.driver.page.get_by_text(
        "The answer lies on the border of the search box"
    )
    told.wait_for()
    assert "Refine again from here, or choose a wider box." in told.inner_text()
    app.session.change(None, setting(config=None))
    drop(app)


def with_second_camera(app, camera: Camera) -> None:
    """Puts the second photo's camera elsewhere, as a step of undo."""
    app.session.change("Align badly", with_entry(1, camera=camera))


def test_photos_that_hardly_overlap_are_told_before_and_after(app):
    window, camera = app.driver.page, app.state.document.photos[1].camera
    turn = Rotation.from_rotvec(np.radians(120.0) * camera.R_cam_world[1]).as_matrix()
    anchor = app.state.document.mesh.centroid
    with_second_camera(app, orbited(camera, anchor, turn))
    window.get_by_text("Align better, or take photos from nearer viewpoints").wait_for()
    app.session.change(None, setting(preset="fast"))
    app.driver.click("Refine")
    to_its_end(app)
    wait_until(lambda: app.state.run.grade == "unconvincing", "it is not believed")
    window.get_by_text("align them more closely").first.wait_for()
    drop(app)
    app.driver.click("Undo: Align badly")
    wait_until(lambda: app.state.document.photos[1].camera is camera, "it is undone")


def test_a_camera_that_sees_nothing_is_named_and_moves_nothing(app):
    window, entry = app.driver.page, app.state.document.photos[1]
    turned = np.diag([-1.0, 1.0, -1.0]) @ entry.camera.R_cam_world
    away = dataclasses.replace(
        entry.camera, R_cam_world=turned, t_cam_world=-turned @ entry.camera.center
    )
    with_second_camera(app, away)
    window.get_by_text(
        f"The camera of {entry.name} sees nothing of the surface: align it in tab 2."
    ).wait_for()
    wait_until(lambda: app.state.run.error_px is None, "it is no number")
    document = app.state.document
    wait_until(lambda: app.state.worker == "", "the worker is ready", 120)
    app.driver.click("Refine")
    window.get_by_text("hardly any common part of the surface").first.wait_for()
    wait_until(lambda: app.state.run.status == "idle", "there is no run")
    assert app.state.document is document
    app.driver.dismiss_toasts()
    app.driver.click("Undo: Align badly")
    wait_until(lambda: app.state.document.photos[1] is entry, "it is undone")


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


def test_a_run_of_the_list_is_looked_at_compared_and_restored(app):
    document, runs = app.state.document, app.state.runs
    first = next(run for run in runs if has_moved(run) and run.cost is not None)
    other = next(run for run in reversed(runs) if run is not first and has_moved(run))
    window = app.driver.page
    window.get_by_text("Runs", exact=True).click()
    app.driver.frames(2)
    row = window.get_by_role("row").filter(
        has=window.get_by_role("cell", name=str(first.number), exact=True).first
    )
    shown = row.first.inner_text().split("\t")
    assert first.config is not None
    assert shown[:3] == [str(first.number), first.settings_name, str(first.config.seed)]
    assert shown[3] == number(first.cost)
    assert shown[5] == in_words(first.elapsed_s)
    choose(app, "Run", f"{first.number}: ")
    app.driver.click("Look at it")
    wait_until(lambda: app.state.run.number == first.number, "it is on screen")
    choose(app, "Compare with", f"{other.number}: ")
    wait_until(lambda: app.state.compared_with == other.number, "it is compared")
    window.get_by_text(f"run {other.number}", exact=True).first.wait_for()
    app.driver.click("Accept")
    wait_until(lambda: app.state.undo_name == "Refine", "its cameras are taken")
    for entry, camera in zip(app.state.document.photos, first.cameras, strict=True):
        assert entry.camera is camera
    app.driver.click("Undo: Refine")
    wait_until(lambda: app.state.document is document, "undo takes it back")


def test_the_report_swipes_without_a_server_and_loads_nothing(app, chromium, tmp_path):
    last = next(run for run in reversed(app.state.runs) if has_moved(run))
    app.session.change(None, looking_at(last.number))
    wait_until(lambda: app.controller.refinement.comparison is not None, "it is drawn")
    with app.driver.page.expect_download() as download:
        app.driver.click("Download report")
    path = tmp_path / "report.html"
    download.value.save_as(path)
    drop(app)
    context = chromium.new_context(offline=True)
    try:
        page, asked = context.new_page(), []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_load_state("load")
        line = page.locator(".pr-swipe input").first
        line.scroll_into_view_if_needed()
        box = line.bounding_box()
        assert box is not None
        shown = page.screenshot()
        page.mouse.click(box["x"] + 0.2 * box["width"], box["y"] + 0.5 * box["height"])
        place = line.evaluate("e => e.parentNode.style.getPropertyValue('--x')")
        assert 15.0 < float(place.removesuffix("%")) < 25.0, place
        assert page.screenshot() != shown, "the line moves"
        n_pictures = page.evaluate(
            "() => [...document.images].filter(i => i.naturalWidth > 50).length"
        )
        assert n_pictures == 8, "before and after, and two heat maps, of each photo"
        foreign = [url for url in asked if not url.startswith("data:")]
        assert foreign == [path.as_uri()]
    finally:
        context.close()
