"""A run in the page goes its way: it is watched, paused, stopped, kept, gone on with."""

import dataclasses
import hashlib

import pytest
from playwright.sync_api import expect

from app.model.session import setting
from app.panels.overlay import LEVEL, RESTART
from tests.browser.driver import Driver, wait_until
from tests.browser.refine_runs import QUICK, drop, open_to_refine, start, to_its_end

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
    return open_to_refine(open_app_once)


def test_different_overlays_arrive_while_the_best_cost_only_falls(app):
    wait_until(lambda: app.state.picture is not None, "the start is drawn")
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


WORN = """() => {
  const nodes = __viserMutable.nodeRefFromName;
  const isShown = name => nodes[name] && nodes[name].visible;
  return [Object.keys(nodes).some(n => n.startsWith('/solid/run-') && isShown(n)),
          Boolean(isShown('/solid/clay'))];
}"""
"""Whether the model wears the photos, and whether its bare surface shows."""


def test_stop_and_keep_offers_the_best_so_far_which_the_model_wears_once_accepted(app):
    start(app)
    app.driver.click("Stop and keep the best")
    wait_until(lambda: app.state.run.status == "review", "it stops", 60)
    assert app.state.run.curve[-1].best < 1.0
    app.driver.click("Accept")
    wait_until(lambda: app.state.undo_name == "Refine", "the cameras are taken")
    window = app.driver.page

    def is_worn(on: bool) -> None:
        wait_until(lambda: window.evaluate(WORN) == [on, not on], f"worn: {on}", 30)

    app.driver.frames(3)
    is_worn(True)
    app.driver.click("Next: make the texture")
    tab = window.get_by_role("tab", name="4 Export")
    expect(tab).to_have_attribute("aria-selected", "true")
    app.driver.click("Undo: Refine")
    wait_until(lambda: app.state.undo_name is None, "undo takes it back")
    is_worn(False)
    app.driver.click("Redo: Refine")
    is_worn(True)
    app.driver.click("Undo: Refine")
    app.driver.tab("3 Refine")
    expect(window.get_by_role("button", name="Next: make the texture")).to_be_hidden()


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


def test_a_blink_shows_both_photos_in_turn(app):
    start(app)
    app.driver.choose("Style", "Blink")
    wait_until(
        lambda: app.state.drawn.other_jpeg is not None, "both pictures are drawn"
    )
    app.driver.frames(2)
    app.driver.page.evaluate(WATCH_OVERLAY)
    app.driver.page.wait_for_function("() => overlays.size >= 2", timeout=30_000)
    drawn = app.state.drawn
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
    twice = dataclasses.replace(QUICK.genetic, restarts=2)
    config = dataclasses.replace(QUICK, genetic=twice)
    app.session.change(None, setting(config=config))
    app.driver.click("Refine")
    to_its_end(app)
    marks = [point.mark for point in app.state.run.curve]
    assert marks.count("restart") == 1
    assert marks.count("level") >= len(QUICK.polish.blurs_px)
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
