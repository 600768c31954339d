"""Who is let in, by raw sockets and in Chromium; what the page never asks for."""

import dataclasses
import socket

import msgspec.msgpack
import pytest
from websockets.sync.client import connect

from app.control.controller import Controller
from app.model.session import Session
from app.model.state import Document, State
from app.page.server import Page
from app.web.access import AccessControl, cookie_name
from photoreg.limits import Limits
from tests.browser.driver import Driver, wait_until
from tests.robustness.lying_photos import png

TOKEN = "a-token-of-the-tests-0123456789"


@pytest.fixture(scope="module")
def guarded():
    """The app as other machines reach it, behind its token; files up to 1 MB."""
    session = Session(State(document=Document()))
    controller = Controller(session, warm_up=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PHOTOREG_MAX_FILE_MB", "1")
        page = Page(
            session,
            controller,
            AccessControl("0.0.0.0", TOKEN),
            0,
            shadows=False,
            surroundings=False,
        )
    yield page
    page.close()
    controller.close()


@pytest.fixture(scope="module")
def entered(guarded, chromium):
    """A browser that opened the printed address, and every request that it made."""
    context = chromium.new_context(viewport={"width": 1100, "height": 700})
    asked, problems = [], []

    def watch(route):
        asked.append(route.request.url)
        local = f"http://127.0.0.1:{guarded.port}/"
        if route.request.url.startswith((local, "data:", "blob:")):
            route.continue_()
        else:
            route.abort()

    context.route("**/*", watch)
    window = context.new_page()
    window.on("console", lambda said: problems.append(said.text))
    window.on("pageerror", lambda error: problems.append(str(error)))
    window.on("websocket", lambda opened: asked.append(opened.url))
    window.goto(AccessControl("127.0.0.1", TOKEN).entrance(guarded.port))
    yield Driver(window, f"http://127.0.0.1:{guarded.port}"), asked, problems
    context.close()


def ask(port: int, path: str = "/", *headers: str, method: str = "GET") -> str:
    """The whole answer to a request that is sent as it stands."""
    lines = [f"{method} {path} HTTP/1.1"]
    if not any(line.startswith("Host:") for line in headers):
        lines.append(f"Host: 127.0.0.1:{port}")
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        text = "\r\n".join([*lines, *headers]) + "\r\n\r\n"
        connection.sendall(text.encode("latin-1"))
        answer = b""
        while chunk := connection.recv(1 << 16):
            answer += chunk
            if b" 101 " in answer:
                break
    return answer.decode("latin-1")


def status(answer: str) -> int:
    return int(answer.split()[1])


def cookie(port: int, token: str = TOKEN) -> str:
    return f"Cookie: {cookie_name(port)}={token}"


def websocket_headers(port: int, origin: str | None = None) -> list[str]:
    return [
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Protocol: viser-v1.1.1",
        f"Origin: {origin or f'http://127.0.0.1:{port}'}",
    ]


def test_without_the_token_page_pictures_and_websocket_are_refused(guarded):
    port = guarded.port
    upgrade = websocket_headers(port)
    for path in ("/", "/index.html", "/photoreg/page.js", "/nothing", "/?token=", "//"):
        assert status(ask(port, path)) == 403, path
    assert status(ask(port, "/", *upgrade)) == 403
    for wrong in ("", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "é" * 8):
        assert status(ask(port, "/", cookie(port, wrong))) == 403, wrong
        assert status(ask(port, "/", cookie(port, wrong), *upgrade)) == 403, wrong
        assert status(ask(port, f"/?token={wrong}")) == 403, wrong
    # The cookie of a server on another port does not open this one.
    assert status(ask(port, "/", cookie(port + 1))) == 403
    assert TOKEN not in ask(port, "/")


def test_the_token_is_exchanged_for_a_cookie_that_scripts_cannot_read(guarded):
    port = guarded.port
    answer = ask(port, f"/?fixedDpr=1&token={TOKEN}")
    assert status(answer) == 303
    head = dict(
        line.split(": ", 1)
        for line in answer.partition("\r\n\r\n")[0].splitlines()
        if ": " in line
    )
    assert head["Location"] == "/?fixedDpr=1", "the token leaves the address"
    assert head["Set-Cookie"].startswith(f"{cookie_name(port)}={TOKEN};")
    assert {"HttpOnly", "SameSite=Lax", "Path=/"} <= set(head["Set-Cookie"].split("; "))
    assert status(ask(port, "/", cookie(port))) == 200
    assert status(ask(port, "/photoreg/page.js", cookie(port))) == 200
    assert status(ask(port, "/", cookie(port), *websocket_headers(port))) == 101


def test_a_foreign_origin_is_refused_even_with_the_token(guarded):
    port = guarded.port
    for origin in (
        "http://evil.example",
        f"http://127.0.0.1:{port + 1}",
        f"http://127.0.0.1:{port}.evil.example",
        "null",
        "file://",
    ):
        upgrade = websocket_headers(port, origin)
        assert status(ask(port, "/", cookie(port), *upgrade)) == 403, origin
    upgrade = websocket_headers(port)[:-1]
    assert status(ask(port, "/", cookie(port), *upgrade)) == 403, "no Origin"
    upgrade = [*websocket_headers(port), "Origin: http://evil.example"]
    assert status(ask(port, "/", cookie(port), *upgrade)) == 403, "two Origins"
    upgrade = [
        "Upgrade: WebSocket",
        *websocket_headers(port, "http://evil.example")[1:],
    ]
    assert status(ask(port, "/", cookie(port), *upgrade)) == 403, "other letters"


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../../../etc/passwd",
        "/..%2f..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/%252e%252e/%252e%252e/etc/passwd",
        "/..\\..\\..\\..\\etc\\passwd",
        "//etc/passwd",
        "/etc/passwd",
        "/photoreg/../../../../etc/passwd",
        "/photoreg/..%2f..%2fpyproject.toml",
        "/photoreg/../app/page/main.py",
        "/photoreg/demo/cameras.json",
        "/photoreg/photo/1/../../x.jpg",
        "/photoreg/page.js%00.png",
        "/%00",
        "/" + "a" * 5000,
        "http://127.0.0.1/etc/passwd",
        "file:///etc/passwd",
    ],
)
def test_no_path_leads_out_of_the_static_folder(guarded, path):
    answer = ask(guarded.port, path, cookie(guarded.port))
    assert status(answer) == 404, answer[:200]
    assert "root:" not in answer
    assert "Traceback" not in answer


def test_odd_requests_are_refused_and_the_server_goes_on(guarded):
    port = guarded.port
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "CONNECT"):
        answer = ask(port, "/", cookie(port), method=method)
        assert not answer or status(answer) in (400, 405), method
    two_hosts = (f"Host: 127.0.0.1:{port}", "Host: evil.example")
    assert status(ask(port, "/", cookie(port), *two_hosts)) == 403
    long_header = ask(port, "/", "X-Long: " + "a" * 100_000)
    assert not long_header or status(long_header) in (400, 403, 431)
    assert status(ask(port, "/", cookie(port))) == 200


def test_every_answer_forbids_framing_sniffing_and_foreign_scripts(guarded):
    port = guarded.port
    for answer in (
        ask(port),
        ask(port, "/", cookie(port)),
        ask(port, "/photoreg/page.js", cookie(port)),
        ask(port, "/nothing", cookie(port)),
        ask(port, f"/?token={TOKEN}"),
    ):
        head = answer.partition("\r\n\r\n")[0]
        assert "X-Frame-Options: DENY" in head
        assert "frame-ancestors 'none'" in head
        assert "connect-src 'self'" in head
        assert "X-Content-Type-Options: nosniff" in head
        assert "Cross-Origin-Resource-Policy: same-origin" in head
        assert "Referrer-Policy: no-referrer" in head
        assert "Python" not in head, "nobody need know what serves"


def test_the_page_works_in_chromium_and_asks_nobody_else(guarded, entered):
    driver, asked, problems = entered
    assert "token" not in driver.page.url
    assert driver.page.evaluate("() => document.cookie") == ""
    driver.page.wait_for_function("() => window.photoreg?.files")
    for tab in ("2 Align", "3 Refine", "4 Export", "1 Data"):
        driver.tab(tab)
    driver.frames(3)
    ours = tuple(f"{kind}://127.0.0.1:{guarded.port}" for kind in ("http", "ws"))
    foreign = [url for url in asked if not url.startswith((*ours, "data:", "blob:"))]
    assert foreign == []
    assert any(url.startswith("ws:") for url in asked), "the websocket was watched"
    broken = [text for text in problems if "Content Security Policy" in text]
    assert broken == [], "the policy leaves the page what it needs"


def test_a_link_cannot_lead_the_page_to_a_foreign_server(guarded, entered):
    driver, _, _ = entered
    with socket.create_server(("127.0.0.1", 0)) as foreign:
        address = f"ws://127.0.0.1:{foreign.getsockname()[1]}"
        page = driver.page.context.new_page()
        page.goto(f"http://127.0.0.1:{guarded.port}/?websocket={address}")
        page.get_by_role("tab", name="1 Data").wait_for(timeout=60_000)
        assert page.url == f"http://127.0.0.1:{guarded.port}/"
        # And where a script of the page tries all the same, the browser stops it.
        page.evaluate("address => { window.tried = new WebSocket(address) }", address)
        page.wait_for_function("() => window.tried.readyState === WebSocket.CLOSED")
        foreign.settimeout(0)
        with pytest.raises(BlockingIOError):
            foreign.accept()
        page.close()


def test_in_chromium_a_wrong_token_is_asked_for_again_and_the_right_one_opens(
    guarded, chromium
):
    context = chromium.new_context()
    page = context.new_page()
    answer = page.goto(f"http://127.0.0.1:{guarded.port}/?token=wrong")
    assert answer is not None
    assert answer.status == 403
    assert page.get_by_role("alert").inner_text() == "That is not its token."
    page.goto(f"http://127.0.0.1:{guarded.port}/")
    assert page.get_by_role("alert").count() == 0, "nobody has given one yet"
    page.get_by_label("Token").fill(TOKEN)
    page.get_by_role("button", name="Come in").click()
    page.get_by_role("tab", name="1 Data").wait_for(timeout=60_000)
    assert page.url == f"http://127.0.0.1:{guarded.port}/"
    context.close()


def test_a_file_that_is_too_large_is_refused_with_a_sentence(
    guarded, entered, tmp_path
):
    driver, _, _ = entered
    large, small = tmp_path / "large.obj", tmp_path / "small.png"
    large.write_bytes(b"#" * 1_200_000)
    # No mesh: software WebGL takes long over the first one.
    small.write_bytes(png())
    driver.tab("1 Data")
    driver.page.get_by_text("Up to 1 MB each").wait_for()
    with driver.page.expect_file_chooser() as chooser:
        driver.click("Open files …")
    chooser.value.set_files([large, small])
    driver.page.get_by_text("large.obj has 1 MB; files of up to 1 MB").wait_for()
    session = guarded.session
    wait_until(lambda: session.state.document.photos, "the other is opened")
    assert session.state.document.photos[0].name == "small.png"


def test_a_browser_that_heeds_no_limit_is_refused_by_the_server(guarded, entered):
    """By hand over the websocket: what the page would never send."""
    driver, _, _ = entered
    driver.dismiss_toasts()
    upload = guarded.server.gui._current_file_upload_states
    bridge = guarded._bridge.upload._impl.uuid
    port = guarded.port

    def start(key: str, size: int, parts: int) -> bytes:
        return msgspec.msgpack.encode(
            {
                "type": "FileTransferStartUpload",
                "source_component_uuid": bridge,
                "transfer_uuid": key,
                "filename": f"{key}.obj",
                "mime_type": "",
                "part_count": parts,
                "size_bytes": size,
            }
        )

    def part(key: str, index: int, content: bytes) -> bytes:
        return msgspec.msgpack.encode(
            {
                "type": "FileTransferPart",
                "source_component_uuid": bridge,
                "transfer_uuid": key,
                "part_index": index,
                "content": content,
            }
        )

    with (
        connect(
            f"ws://127.0.0.1:{port}/",
            origin=f"http://127.0.0.1:{port}",  # pyright: ignore[reportArgumentType]
            additional_headers={"Cookie": cookie(port)[len("Cookie: ") :]},
            subprotocols=["viser-v1.1.1"],  # pyright: ignore[reportArgumentType]
            max_size=None,
        ) as browser
    ):
        browser.send(start("huge", 10**12, 10**6))
        browser.send(start("negative", -1, 1))
        browser.send(start("crumbs", 1000, 10**9))
        browser.send(start("liar", 3000, 2))
        for index in range(2):
            browser.send(part("liar", index, b"x" * 1800))
        browser.send(start("honest", 3000, 2))
        wait_until(lambda: "honest" in upload, "the last message was handled")
        assert not {"huge", "negative", "crumbs", "liar"} & set(upload)
    wait_until(lambda: "honest" not in upload, "who leaves takes the half files along")
    assert status(ask(port, "/", cookie(port))) == 200


def test_a_page_that_forgot_the_limit_hears_it_from_the_server(entered, tmp_path):
    driver, _, _ = entered
    driver.dismiss_toasts()
    (tmp_path / "huge.obj").write_bytes(b"#" * 1_200_000)
    driver.page.evaluate("() => { window.photoreg.maxBytes = Infinity }")
    with driver.page.expect_file_chooser() as chooser:
        driver.click("Open files …")
    chooser.value.set_files([tmp_path / "huge.obj"])
    driver.page.get_by_text("huge.obj has 1 MB; files of up to 1 MB").wait_for()


def test_no_browser_can_open_a_tunnel(guarded):
    from viser import _messages

    handlers = guarded.server._websock_server._incoming_handlers
    assert _messages.ShareUrlRequest not in handlers


def test_limits_are_stated_and_come_from_the_environment():
    limits = Limits.of_environment({"PHOTOREG_MAX_PHOTO_MEGAPIXELS": "2.5"})
    assert limits == dataclasses.replace(Limits(), photo_megapixels=2.5)
