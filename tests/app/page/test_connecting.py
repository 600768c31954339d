"""Browsers that come to the page together, without a browser."""

import contextlib
import dataclasses
import json
import threading
import time
from typing import Any

import pytest

from app.control.controller import Controller
from app.engine.scene_opening import demo_folder, open_folder
from app.model.failures import UNFORESEEN
from app.model.messages import Working
from app.model.session import Session, select, setting, with_entry
from app.model.state import State
from app.page import server
from app.page.server import Page
from app.panels.view import ViewPanel
from app.web import controls
from tests.bench.wire import listening
from tests.browser.driver import wait_until

N_BROWSERS = 12


class UnhurriedPanel(ViewPanel):
    """Takes its time, so that others come while it is made."""

    def __init__(self, *arguments: Any) -> None:
        time.sleep(0.02)
        super().__init__(*arguments)


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path))
    monkeypatch.setattr(server, "ViewPanel", UnhurriedPanel)
    session = Session()
    controller = Controller(session, warm_up=False)
    page = Page(session, controller, port=0)
    yield page
    page.close()
    controller.close()


def test_each_of_many_browsers_at_once_gets_its_own_choice_of_views(page, caplog):
    address = f"http://127.0.0.1:{page.port}"
    choices: list[set[str]] = [set() for _ in range(N_BROWSERS)]
    together = threading.Barrier(N_BROWSERS)
    over = threading.Event()

    def browse(mine: set[str]) -> None:
        def hear(message: dict[str, Any]) -> None:
            change = message.get("props", message.get("updates"))
            if 'aria-label="View"' in str(change):
                mine.add(message["uuid"])

        together.wait()
        with listening(address, hear):
            over.wait()

    browsers = [threading.Thread(target=browse, args=(mine,)) for mine in choices]
    for browser in browsers:
        browser.start()
    try:
        with contextlib.suppress(TimeoutError):
            wait_until(lambda: all(choices), "every browser can choose its view", 30)
    finally:
        over.set()
        for browser in browsers:
            browser.join()
    assert not [record.message for record in caplog.records]
    assert [len(mine) for mine in choices] == [1] * N_BROWSERS


def test_a_camera_that_changes_sends_the_list_of_photos_once_and_without_them(page):
    page.session.begin(open_folder(demo_folder()))
    heard: list[str] = []

    def hear(message: dict[str, Any]) -> None:
        content = message.get("updates", message.get("props", {})).get("content")
        if isinstance(content, str) and "data-photo" in content:
            heard.append(content)

    with listening(f"http://127.0.0.1:{page.port}", hear):
        wait_until(lambda: heard, "the list is here")
        camera = page.session.state.document.photos[0].camera
        K = camera.K.copy()
        K[[0, 1], [0, 1]] += 111.0
        page.session.change(
            "Zoom", with_entry(0, camera=dataclasses.replace(camera, K=K))
        )
        focal = f"f {K[0, 0]:.0f} px"
        wait_until(lambda: focal in heard[-1], "it is up to date")
        # What is sent later than another change would have come with it.
        page.session.change(None, select(1))
        second = page.session.state.document.photos[1].name
        chosen = f'aria-label="Photo {second}" aria-pressed="true"'
        wait_until(lambda: chosen in heard[-1], "the other photo is chosen")
    assert len([text for text in heard if focal in text]) == 2
    assert max(map(len, heard)) < 10_000
    assert "/thumbnail.jpg" in heard[-1]
    assert "data:image/jpeg" not in heard[-1]


def test_every_callback_of_the_page_is_guarded(page):
    page.session.begin(open_folder(demo_folder()))
    address = f"http://127.0.0.1:{page.port}"
    with listening(address, lambda _: None):
        wait_until(page.server.get_clients, "a browser is here")
        (client,) = page.server.get_clients().values()
        wait_until(lambda: page.viewport(client.client_id), "it has its view")
        scene = page.server.scene
        wait_until(lambda: scene._handle_from_transform_controls_name, "and a gizmo")
        callbacks = [
            *(
                callback
                for gui in (page.server.gui, client.gui)
                for handle in gui._gui_input_handle_from_uuid.values()
                for callback in handle._impl.update_cb
            ),
            *(
                callback
                for command in page.server.gui._command_handle_from_uuid.values()
                for callback in command._impl.trigger_cb
            ),
            *(
                entry.callback
                for node in scene._handle_from_node_name.values()
                for entry in (*node._impl.click_cb, *node._impl.drag_cb)
            ),
            *(
                callback
                for gizmo in scene._handle_from_transform_controls_name.values()
                for callback in gizmo._impl_aux.update_cb
            ),
            *(entry.callback for entry in scene._scene_pointer_cb),
            *client.camera._state.camera_cb,
            *page.server._client_connect_cb,
            *page.server._client_disconnect_cb,
        ]
    assert len(callbacks) > 60
    bare = [c for c in callbacks if c.__code__.co_filename != controls.__file__]
    assert not [callback.__qualname__ for callback in bare]


def test_what_fails_off_the_event_loop_reaches_the_people_too(page, monkeypatch):
    page.session.begin(open_folder(demo_folder()))
    said: list[str] = []

    def hear(message: dict[str, Any]) -> None:
        if "Notification" in message["type"]:
            said.append(str(message))

    with listening(f"http://127.0.0.1:{page.port}", hear):
        wait_until(page.server.get_clients, "a browser is here")
        (client,) = page.server.get_clients().values()
        # A stroke is painted on a thread; of a project to look at only, it is refused.
        refusal = "It is open to look at only."
        page.session.change(None, setting(read_only=refusal))
        name = page.session.state.document.photos[0].name
        stroke = {"stroke": [[9, 9]], "radius": 5, "counts": False, "photo": name}
        page._bridge._deliver(json.dumps({"act": "paint", **stroke}), client)
        wait_until(lambda: any("look at only" in text for text in said), "it is told")
        # What the worker tells comes on a thread as well, and nobody clicked.
        monkeypatch.setattr("app.model.reducers.worked", lambda *_: 1 / 0)
        for _ in range(5):
            page.controller._hear(Working("Packing", 0.5))
        wait_until(lambda: any(UNFORESEEN in text for text in said), "all are told")
    assert len([text for text in said if UNFORESEEN in text]) == 1


def test_a_browser_that_leaves_while_its_view_is_painted_is_no_failure(
    page, monkeypatch, caplog
):
    page.session.begin(open_folder(demo_folder()))
    address, has_left = f"http://127.0.0.1:{page.port}", threading.Event()
    heard: list[str] = []
    leaving = contextlib.ExitStack()
    leaving.enter_context(listening(address, lambda _: None))
    wait_until(page.server.get_clients, "a browser is here")
    (first,) = page.server.get_clients()
    wait_until(lambda: page.viewport(first), "it has its view")
    with listening(address, lambda message: heard.append(str(message))):
        wait_until(lambda: len(page.server.get_clients()) == 2, "another one, too")
        (second,) = set(page.server.get_clients()) - {first}
        wait_until(lambda: page.viewport(second), "it has its view as well")
        show = ViewPanel.show

        def show_late(panel: ViewPanel, state: State) -> None:
            if state.gizmo == "orbit" and not has_left.is_set():
                leaving.close()
                wait_until(lambda: not page.viewport(first), "it is gone")
                has_left.set()
            show(panel, state)

        monkeypatch.setattr(ViewPanel, "show", show_late)
        page.session.change(None, setting(gizmo="orbit"))
        wait_until(has_left.is_set, "it left in the middle")
        note = "The other one is still painted for."
        page.session.change(None, setting(note=note))
        wait_until(lambda: any(note in text for text in heard), "it is painted")
    assert not [text for text in heard if "Notification" in text]
    assert not caplog.records, caplog.text
