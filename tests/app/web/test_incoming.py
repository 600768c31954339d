"""What a browser sends that the page never would: dropped, and the page lives on."""

import contextlib
import json
import logging
import math
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
import viser
from viser import _messages

from app.control.controller import Controller
from app.control.project_reading import read_all
from app.control.projects import Projects
from app.engine.warm_up import toy_scene
from app.model.session import Session, setting
from app.model.state import Document, PhotoEntry, State
from app.page.server import Page
from app.web.incoming import LARGEST_NUMBER, NotUnderstoodError, understood
from app.web.outgoing import sendable
from photoreg.registration.config import RegistrationConfig
from tests.bench.wire import listening, view_from
from tests.browser.driver import wait_until
from tests.robustness import lying_projects

HOSTILE = (
    1e20,
    1e308,
    -1e308,
    math.nan,
    math.inf,
    -math.inf,
    -0.0,
    2**63 - 1,
    -(2**63),
    2**64 - 1,
    5e-324,
    "",
    "100000000000000000000",
    "9" * 30,
    "x" * 100_000,
    "a\0b",
    "\u202egpj.exe",
    "<img src=x onerror=alert(1)>",
    b"\x00\xff",
    None,
    False,
    [],
    [math.nan, 1e308, -1e308],
    {"value": [[[]]]},
    msgspec.msgpack.Ext(5, b"x"),
)

Send = Callable[[bytes], None]


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path))
    mesh, photos, cameras = toy_scene()
    entries = tuple(map(PhotoEntry, photos, cameras))
    session = Session(State(document=Document(mesh, mesh, entries)))
    controller = Controller(session, warm_up=False)
    page = Page(session, controller, port=0)
    yield page
    page.close()
    controller.close()


@contextlib.contextmanager
def browsing(page: Page) -> Iterator[tuple[Send, dict[str, dict[str, Any]]]]:
    """A browser by hand: what sends its messages, and the widgets it was sent."""
    widgets: dict[str, dict[str, Any]] = {}

    def hear(message: dict[str, Any]) -> None:
        if message["type"].startswith("Gui") and "props" in message:
            widgets[message["uuid"]] = message

    known = set(page.server.get_clients())
    with listening(f"http://127.0.0.1:{page.port}", hear) as send:
        wait_until(lambda: set(page.server.get_clients()) - known, "it is let in")
        (number,) = set(page.server.get_clients()) - known
        wait_until(lambda: page.viewport(number), "it has its view")
        gui = page.server.get_clients()[number].gui
        own = gui._gui_input_handle_from_uuid
        wait_until(
            lambda: own and own.keys() <= widgets.keys(), "its controls are sent"
        )
        yield send, widgets


def packed(kind: str, **fields: Any) -> bytes:
    return msgspec.msgpack.encode({"type": kind, **fields})


def update(uuid: str, /, **updates: Any) -> bytes:
    return packed("GuiUpdateMessage", uuid=uuid, updates=updates)


def inputs(page: Page) -> dict[str, Any]:
    """Every widget that takes values, of the page and of each browser."""
    apis = [page.server.gui, *(c.gui for c in page.server.get_clients().values())]
    return {k: h for gui in apis for k, h in gui._gui_input_handle_from_uuid.items()}


def toggle_dark(page: Page, send: Send) -> None:
    """Ticks a box and waits for it: all that was sent before has been handled."""
    before = page.session.state.dark
    (dark,) = (
        h for h in inputs(page).values() if getattr(h, "label", "") == "Dark page"
    )
    send(update(dark._impl.uuid, value=not before))
    wait_until(lambda: page.session.state.dark != before, "it is done")


def assert_alive(page: Page) -> None:
    """A new browser gets the whole page, and what it presses is done."""
    expected = page.server.gui._gui_input_handle_from_uuid.keys()
    with browsing(page) as (send, widgets):
        wait_until(lambda: expected <= widgets.keys(), "all of the page is here")
        (dark,) = (
            k for k, w in widgets.items() if w["props"].get("label") == "Dark page"
        )
        for _ in range(2):
            before = page.session.state.dark
            send(update(dark, value=not before))
            wait_until(lambda b=before: page.session.state.dark != b, "it is done")
        (photo,) = (
            h
            for h in inputs(page).values()
            if isinstance(h, viser.GuiDropdownHandle) and h.label == "Photo"
        )
        for index, option in [*enumerate(photo.options)][::-1]:
            shown = photo.options[page.session.state.selected]
            wait_until(lambda v=shown: photo.value == v, "it is painted", 20)
            send(update(photo._impl.uuid, value=option))
            wait_until(
                lambda i=index: page.session.state.selected == i, "it is chosen", 20
            )
        presses = []
        button = page._panels[0]._new  # New project …
        button.on_click(lambda _: presses.append(1))
        send(update(button._impl.uuid, value=True))
        wait_until(lambda: presses, "a button that is pressed acts", 20)


def assert_clean(caplog: Any, capfd: Any) -> None:
    assert not [r for r in caplog.records if r.exc_info or r.levelno > logging.WARNING]
    said = capfd.readouterr()
    assert "Traceback" not in said.err + said.out
    assert "never retrieved" not in said.err + caplog.text


def test_every_widget_survives_every_hostile_value(page, caplog, capfd):
    with browsing(page) as (send, _):
        assert len(inputs(page)) > 80
        for uuid in inputs(page):
            for value in HOSTILE:
                send(update(uuid, value=value))
        toggle_dark(page, send)
        assert_alive(page)
    assert len(HOSTILE) == 25
    assert_clean(caplog, capfd)


def test_every_message_of_the_scripts_survives_every_hostile_value(page, caplog, capfd):
    bridge = page._bridge._text._impl.uuid
    plain = [v for v in HOSTILE if not isinstance(v, bytes | msgspec.msgpack.Ext)]
    name = page.session.state.document.photos[0].name
    with browsing(page) as (send, _):
        for act, (_, fields) in page._bridge._handlers.items():
            if act == "stop":
                continue
            for value in [*plain, 10**40, "\ud800", [[1e308, "x"]]]:
                if act == "remove" and isinstance(value, str):
                    continue  # A photo may have that name by now.
                values = dict.fromkeys(fields, value)
                named = {"photo": name} if act != "remove" else {}
                for given in (values, {**values, **named}, {}):
                    send(update(bridge, value=json.dumps({"act": act, **given})))
        for text in ("", "[]", "{}", "1", "[" * 5000, '{"act": []}', '{"act": "none"}'):
            send(update(bridge, value=text))
        toggle_dark(page, send)
        assert_alive(page)
    assert len(page.session.state.document.photos) == 2
    assert_clean(caplog, capfd)


def test_what_the_scripts_do_send_is_done(page):
    session, bridge = page.session, page._bridge._text._impl.uuid
    first, second = (entry.name for entry in session.state.document.photos)
    photo = {"photo": first}

    def entries() -> dict[str, PhotoEntry]:
        return {entry.name: entry for entry in session.state.document.photos}

    with browsing(page) as (send, _):
        for message, done in (
            ({"act": "shift", "by": 1}, lambda: [*entries()] == [second, first]),
            ({"act": "enable", "on": False}, lambda: not entries()[first].enabled),
            ({"act": "crop", "on": True}, lambda: entries()[first].is_cropped),
            ({"act": "pick", "u": 30, "v": 40.5}, lambda: entries()[first].pairs),
            (
                {"act": "move", "number": 1, "u": 31, "v": 41},
                lambda: entries()[first].pairs[0].pixel == (31.0, 41.0),
            ),
            (
                {"act": "choose", "number": 1},
                lambda: session.state.chosen_pair == 1,
            ),
            (
                {"act": "choose", "number": None},
                lambda: session.state.chosen_pair is None,
            ),
            ({"act": "delete", "number": 1}, lambda: not entries()[first].pairs),
            (
                {"act": "paint", "stroke": [[9, 9.5]], "radius": 5, "counts": False},
                lambda: entries()[first].mask_png,
            ),
            ({"act": "unmask"}, lambda: entries()[first].mask_png is None),
            ({"act": "select", "photo": second}, lambda: session.state.selected == 0),
            ({"act": "rename", "name": "x.png"}, lambda: "x.png" in entries()),
            ({"act": "batch", "files": 2}, lambda: session.state.job is not None),
            ({"act": "stop"}, lambda: session.state.job is None),
        ):
            send(update(bridge, value=json.dumps({**photo, **message})))
            wait_until(done, message["act"], 20)


def test_only_the_value_of_a_widget_can_be_set(page, caplog, capfd):
    start = next(
        h for h in inputs(page).values() if getattr(h, "label", "") == "Refine"
    )
    callbacks = list(start._impl.update_cb)
    assert callbacks
    names = set(dir(start._impl)) | {"props", "label", "options", "none"}
    with browsing(page) as (send, _):
        for uuid in inputs(page):
            for prop in names - {"value"}:
                send(update(uuid, **{prop: []}))
            send(update(uuid, value=1, update_cb=[]))
            send(update(uuid))
        toggle_dark(page, send)
        assert_alive(page)
    assert start._impl.update_cb == callbacks
    assert_clean(caplog, capfd)


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"\xc1",
        b"\x91" * 5000 + b"\x01",
        msgspec.msgpack.encode([1, 2]),
        msgspec.msgpack.encode({}),
        packed("NoSuchMessage"),
        msgspec.msgpack.encode({"type": ["GuiUpdateMessage"]}),
        packed("RunJavascriptMessage", source="alert(1)"),
        packed("ShareUrlRequest"),
        packed("GuiUpdateMessage"),
        packed("GuiUpdateMessage", uuid=["a"], updates={}),
        packed("GuiUpdateMessage", uuid="a", updates=[1]),
        packed("GuiUpdateMessage", uuid="a" * 20_000, updates={}),
        packed("CommandTriggerMessage", uuid=7),
        packed("GuiButtonHoldMessage", uuid="a", frequency="x"),
        packed("FileTransferPart", transfer_uuid="a", part_index=0, content="x"),
        packed(
            "TransformControlsUpdateMessage",
            name="/camera",
            wxyz=(0.0, 0.0, 0.0, 0.0),
            position=(0.0, 0.0, 0.0),
        ),
        packed(
            "ScenePointerMessage",
            event_type="click",
            ray_origin=None,
            ray_direction=None,
            screen_pos=[],
            modifier=None,
        ),
        view_from((math.nan, 0.0, 1.0)),
        view_from((1e308, 0.0, 1.0)),
        msgspec.msgpack.encode({"type": "GuiUpdateMessage"}).replace(
            b"GuiUp", b"\xed\xa0\x80Gu"
        ),
    ],
)
def test_what_the_page_never_sends_is_not_understood(raw):
    with pytest.raises(NotUnderstoodError):
        understood(raw)


def test_messages_that_are_damaged_or_unknown_are_dropped(page, caplog, capfd):
    unknown = [
        update("no such widget", value=1),
        packed("CommandTriggerMessage", uuid="none"),
        packed("GuiButtonHoldMessage", uuid="none", frequency=10.0),
        packed("TransformControlsDragEndMessage", name="/none"),
        packed(
            "FileTransferStartUpload",
            source_component_uuid="none",
            transfer_uuid="t",
            filename="\u202ex.png",
            mime_type="",
            part_count=1,
            size_bytes=5,
        ),
        b"\xc1\xff",
        packed("GuiUpdateMessage", uuid=1, updates=2),
    ]
    with browsing(page) as (send, _):
        for raw in unknown:
            send(raw)
        toggle_dark(page, send)
        assert_alive(page)
    assert_clean(caplog, capfd)
    assert "Dropped what a browser sent" in caplog.text


EXTREMES = (
    "1e20",
    "1e308",
    "-1e308",
    "nan",
    "inf",
    "-inf",
    "-0",
    "100000000000000000000",
    "9" * 30,
    "-" + "9" * 30,
    "9" * 400,
    "",
    "seven",
    "1,2",
)


def as_sent(text: str) -> Any:
    """What viser's page makes of what is typed into a box of numbers, and more."""
    with contextlib.suppress(ValueError):
        return float(text)
    return text


def test_extremes_typed_into_every_field_leave_the_page_and_its_project_whole(
    tmp_path, caplog, capfd
):
    mesh, photos, cameras = toy_scene()
    entries = tuple(map(PhotoEntry, photos, cameras))
    session = Session()
    projects = Projects(session, read=read_all)
    projects.new(Document(mesh, mesh, entries), tmp_path / "project")
    controller = Controller(session, projects=projects, warm_up=False)
    page = Page(session, controller, port=0)
    try:
        with browsing(page) as (send, _):
            for uuid, handle in inputs(page).items():
                if isinstance(handle, viser.GuiUploadButtonHandle):
                    continue
                for text in EXTREMES:
                    value = as_sent(text)
                    if isinstance(handle.value, tuple):
                        values = [
                            [value, *handle.value[1:]],
                            [value] * len(handle.value),
                        ]
                    else:
                        values = [text] if isinstance(handle.value, str) else [value]
                    for given in values:
                        if uuid != page._bridge._text._impl.uuid:
                            send(update(uuid, value=given))
            toggle_dark(page, send)
            assert_alive(page)
        assert session.state.settings.seed <= LARGEST_NUMBER
        settings = session.state.settings
        assert projects.wait(20), "all of it is kept"
        assert not session.state.saving
    finally:
        page.close()
        controller.close()
        projects.close()
    again = Session()
    reopened = Projects(again, read=read_all)
    reopened.open(tmp_path / "project")
    try:
        assert again.state.settings == settings
        assert not again.state.note
    finally:
        reopened.close()
    assert_clean(caplog, capfd)


@pytest.mark.parametrize(
    ("seed", "sentence"),
    [
        (10**19, "seed is 1e+19; give 0 to"),
        (10**20, "RegistrationConfig.seed should be an integer of at most 64 bits"),
    ],
)
def test_a_project_that_holds_a_seed_too_large_opens_and_says_so(
    tmp_path, caplog, seed, sentence
):
    session = Session()
    projects = Projects(session, read=read_all)
    projects.new(Document(), tmp_path / "project")
    session.change(None, setting(config=RegistrationConfig(seed=7), preset="fast"))
    assert projects.wait(20)
    projects.close()
    path = tmp_path / "project" / "project.db"
    rows = lying_projects.tables(path.read_bytes())["parts"]
    (row,) = [i for i, (_, part) in enumerate(rows) if b'"seed":7' in part]
    part = rows[row][1].replace(b'"seed":7', b'"seed":%d' % seed)
    path.write_bytes(
        lying_projects.with_value(path.read_bytes(), "parts", row, 1, part)
    )
    again = Session()
    reopened = Projects(again, read=read_all)
    reopened.open(tmp_path / "project")
    try:
        assert again.state.settings.seed == 0
        assert sentence in again.state.note
    finally:
        reopened.close()
    assert not [r for r in caplog.records if r.exc_info]


def test_what_cannot_be_sent_is_mended_and_logged(caplog):
    whole = _messages.GuiUpdateMessage("a", {"value": 7, "name": "x", "v": (1.5, True)})
    assert sendable(whole) is whole
    assert not caplog.records
    broken = _messages.GuiUpdateMessage("a", {"value": 10**20, "name": ["\ud800"]})
    mended = sendable(broken)
    assert mended.as_serializable_dict() == {
        "type": "GuiUpdateMessage",
        "uuid": "a",
        "updates": {"value": 2**63 - 1, "name": ["?"]},
    }
    assert [record.levelname for record in caplog.records] == ["ERROR"]
