"""The page, piece by piece, with real mouse and keyboard."""

import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from app.model.session import with_document, with_entry
from app.model.state import PointPair
from app.page.server import Page
from photoreg.geometry.camera import same_camera
from photoreg.report.comparison_html import swipe_html
from tests.browser.driver import FINE, wait_until

SCRIPTS = Path(__file__).parents[2] / "static"
NO_INPUT = (viser.GuiHtmlHandle, viser.GuiMarkdownHandle)


@pytest.fixture(scope="module")
def running(open_app_once, toy_document):
    """One app for the tests of this file; it takes seconds to start."""
    return open_app_once(toy_document, FINE)


@pytest.fixture
def app(running, toy_document):
    """The app as it was opened: the document, and the free view."""
    running.session.change("Open", with_document(photos=toy_document.photos))
    running.driver.dismiss_toasts()
    running.driver.frames(2)
    return running


def test_the_view_through_a_photo_is_its_camera_and_dragging_it_moves_the_camera(
    app, toy_document
):
    driver, frame = app.driver, app.page.scene.frame
    driver.tab("2 Align")
    driver.choose("View", "Move the camera")
    camera = toy_document.photos[0].camera
    centre = frame.to_page(camera.center)

    def off() -> float:
        driver.frames(1)
        position = driver.viewport_camera()[0]
        return float(np.abs(position - centre).max())

    wait_until(lambda: off() < 1e-5, "the view is the photo's", 30)
    driver.frames(5)
    opened = app.state.undo_name
    assert app.state.document.photos == toy_document.photos, (
        "looking through must not move the camera"
    )
    canvas = driver.canvas()
    middle = (canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2)
    driver.drag(middle, (40.0, 15.0))
    wait_until(lambda: app.state.undo_name == "Move camera 1", "the camera follows", 30)

    def together() -> bool:
        before, _, _ = driver.viewport_camera()
        driver.frames(5)  # It glides on for a while, and an undo meanwhile is followed.
        held = app.state.document.photos[0].camera
        position, rotation, _ = driver.viewport_camera()
        return bool(
            np.array_equal(position, before)
            and np.abs(position - frame.to_page(held.center)).max() < 1e-5
            and np.abs(rotation - held.R_cam_world.T).max() < 1e-6
        )

    wait_until(together, "the camera is where the view came to rest", 30)
    moved = app.state.document.photos[0].camera
    cosine = 0.5 * (np.trace(moved.R_cam_world @ camera.R_cam_world.T) - 1.0)
    turn = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    assert 5.0 < turn < 60.0, f"turned by {turn:.1f} degrees"
    # One drag, one step: undo brings the photo's view back, in the browser too.
    driver.page.keyboard.press("Control+z")
    wait_until(lambda: off() < 1e-5, "undo moves the view back", 30)
    assert app.state.document.photos == toy_document.photos
    assert app.state.undo_name == opened
    driver.choose("View", "3-D scene")


def test_undo_and_redo_by_keyboard_and_by_named_buttons(app, toy_document):
    driver = app.driver
    entry = toy_document.photos[1]
    before = app.state.document
    app.session.change(
        "Move camera 2", with_entry(1, camera=toy_document.photos[0].camera)
    )
    after = app.state.document
    driver.tab("2 Align")
    driver.page.get_by_role("button", name="Undo: Move camera 2").wait_for()
    driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is before, "Ctrl+Z undoes", 20)
    driver.page.keyboard.press("Control+Shift+z")
    wait_until(lambda: app.state.document is after, "Ctrl+Shift+Z redoes", 20)
    driver.click("Undo: Move camera 2")
    wait_until(lambda: app.state.document is before, "the button undoes", 20)
    driver.page.get_by_role("button", name="Redo: Move camera 2").wait_for()
    assert same_camera(app.state.document.photos[1].camera, entry.camera)


def test_keys_nudge_the_camera_and_a_held_key_is_one_undo_step(app, toy_document):
    driver, before = app.driver, app.state.document
    driver.tab("2 Align")
    centre = before.mesh.bounds.mean(axis=0)[None]

    def way() -> np.ndarray:
        now, then = (d.photos[0].camera for d in (app.state.document, before))
        return now.project(centre)[0] - then.project(centre)[0]

    step_px = 160 / 640
    for n in (1, 2, 3):
        driver.page.keyboard.press("l")
        wait_until(lambda n=n: abs(way()[0] - n * step_px) < 1e-9, f"nudge {n}", 20)
    driver.page.keyboard.press("k")
    wait_until(lambda: abs(way()[1] - step_px) < 1e-9, "a nudge downwards", 20)
    assert abs(way()[0] - 3 * step_px) < 1e-9
    assert app.state.undo_name == "Nudge camera 1"
    driver.page.keyboard.press("Control+z")
    wait_until(lambda: app.state.document is before, "one step back undoes all", 20)


def test_a_text_file_named_jpg_becomes_a_message_and_changes_nothing(
    app, toy_document, tmp_path
):
    before = app.state.document
    path = tmp_path / "notes.jpg"
    path.write_text("these are notes, not a picture")
    app.driver.tab("1 Data")
    with app.driver.page.expect_file_chooser() as chooser:
        app.driver.click("Open files …")
    chooser.value.set_files(path)
    message = app.driver.page.get_by_text("notes.jpg could not be read")
    message.wait_for(timeout=60_000)
    assert app.state.document is before
    assert app.state.job is None


def test_a_typed_focal_length_out_of_range_is_refused_with_a_sentence(
    app, toy_document
):
    driver = app.driver
    driver.tab("2 Align")
    driver.page.get_by_text("Numbers", exact=True).click()
    box = driver.page.get_by_label("Focal, px")
    box.fill("250")
    wait_until(
        lambda: app.state.undo_name == "Focal length 1", "a good value is taken", 20
    )
    assert app.state.document.photos[0].camera.focal_px == pytest.approx(250.0)
    box.fill("-4")
    driver.page.get_by_text("A focal length for this photo should be").wait_for()
    assert app.state.document.photos[0].camera.focal_px == pytest.approx(250.0)


def rows(app) -> Iterator[list[Any]]:
    """The contents of each panel, tab and folder, from top to bottom."""
    apis = [
        app.page.server.gui,
        *(c.gui for c in app.page.server.get_clients().values()),
    ]
    for gui in apis:
        for container in gui._container_handle_from_uuid.values():
            children = list(getattr(container, "_children", {}).values())
            yield sorted(children, key=lambda handle: getattr(handle, "order", 0.0))


def htmls(app) -> list[str]:
    return [
        handle.content
        for row in rows(app)
        for handle in row
        if isinstance(handle, viser.GuiHtmlHandle)
    ]


def is_help(handle: Any) -> bool:
    """Whether it is a line in small print, or in italics."""
    if isinstance(handle, viser.GuiHtmlHandle):
        return 'class="pr-help' in handle.content
    return isinstance(handle, viser.GuiMarkdownHandle) and handle.content.startswith(
        "*"
    )


def test_every_control_of_viser_has_a_hint_or_a_line_of_help_below(app):
    labels, without = [], []
    for row in rows(app):
        for handle, below in zip(row, [*row[1:], None], strict=True):
            if isinstance(handle, NO_INPUT) or not hasattr(handle, "hint"):
                continue
            if handle.label in ("page", "Files"):
                continue  # Nobody sees these two: they carry messages and files.
            labels.append(handle.label)
            if not (handle.hint or is_help(below)):
                without.append(handle.label)
    assert {"Solve", "Refine", "Zoom", "Dark page", "Load a mask"} <= set(labels)
    assert len(labels) > 60, f"only {len(labels)} controls were looked at"
    assert not without, f"without a line of help: {without}"
    assert all(label[0].isupper() or label[0].isdigit() for label in labels)


def test_every_control_of_ours_tells_what_it_does(app):
    pair = PointPair(1, pixel=(3.0, 4.0))
    app.session.change("Point", with_entry(app.state.selected, pairs=(pair,)))
    wait_until(
        lambda: any("Delete point 1" in text for text in htmls(app)),
        "the table of pairs is painted",
    )
    scripts = [path.read_text() for path in SCRIPTS.glob("*.js")]
    texts = [*htmls(app), swipe_html(b"", b"", "start"), *scripts]
    tags = [
        tag for text in texts for tag in re.findall(r"<(?:button|input) [^>]*>", text)
    ]
    assert len(tags) > 50, f"only {len(tags)} controls were looked at"
    without = [tag for tag in tags if not re.search(r'\btitle="[^"]', tag)]
    assert not without, "\n".join(without)


def handshake(port: int, origin: str | None, host: str | None = None) -> str:
    """The first line of the answer to a websocket handshake with this Origin."""
    lines = [
        "GET / HTTP/1.1",
        f"Host: {host or f'127.0.0.1:{port}'}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Protocol: viser-v1.1.1",
    ]
    if origin is not None:
        lines.append(f"Origin: {origin}")
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        return connection.recv(4096).decode("latin-1").splitlines()[0]


def test_pages_of_another_origin_are_refused(app):
    port = app.page.port
    assert " 101 " in handshake(port, f"http://127.0.0.1:{port}")
    assert " 101 " in handshake(port, f"http://localhost:{port}", f"localhost:{port}")
    for origin in ("http://evil.example", f"http://127.0.0.1:{port + 1}", "null", None):
        assert " 403 " in handshake(port, origin), f"Origin {origin} was let in"
    # A name of somebody else's that was made to lead here.
    rebound = handshake(port, f"http://evil.example:{port}", f"evil.example:{port}")
    assert " 403 " in rebound


@pytest.mark.errors("failed")
def test_what_nobody_foresaw_reaches_the_person_who_clicked_and_the_log(
    app, monkeypatch, caplog
):
    app.session.change("Turn", with_document(up=(0.0, 0.0, 1.0)))
    monkeypatch.setattr(app.session, "undo", lambda: 1 / 0)
    app.driver.click("Undo: Turn")
    app.driver.page.get_by_text("Something failed that photoreg did not").wait_for()
    wait_until(lambda: "ZeroDivisionError" in caplog.text, "the log has it", 20)


def test_the_page_comes_back_after_the_network_drops_and_after_a_restart(app):
    page, server = app.driver.page, app.page.server
    before = set(server.get_clients())
    server._websock_server.disconnect_all_clients()
    wait_until(lambda: set(server.get_clients()) - before, "it connects again")
    app.session.change("While the net was down", with_document(up=(0.0, 0.6, 0.8)))
    page.get_by_role("button", name="Undo: While the net was down").wait_for()
    port = app.page.port
    app.page.close()
    app.session.change("While the server was down", with_document(up=(1.0, 0.0, 0.0)))
    app.page = Page(
        app.session, app.controller, port=port, shadows=False, surroundings=False
    )
    undo = page.get_by_role("button", name="Undo: While the server was down")
    undo.wait_for(timeout=60_000)
    wait_until(app.page.server.get_clients, "it has connected")
    # What is clicked arrives, too.
    undo.click()
    wait_until(
        lambda: app.state.undo_name == "While the net was down", "the click arrives"
    )
