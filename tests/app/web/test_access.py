"""Addresses as browsers send them, and tokens that are guessed; no sockets."""

import http
import logging

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.web.access import AccessControl, cookie_name
from app.web.token_guesses import MOST_WRONG, WINDOW_S, Guesses
from photoreg.errors import InputError

TOKEN = "a-token-of-the-tests-0123456789"
PORT = 8080


def ask(
    access: AccessControl,
    host: str,
    path: str = "/",
    peer: str = "127.0.0.1",
    **headers: str,
) -> Response | None:
    given = Headers(Host=host)
    for name, value in headers.items():
        given[name.replace("_", "-")] = value
    return access.answer(Request(path, given), PORT, peer)


def enters(access: AccessControl, host: str, origin: str) -> bool:
    """Whether a page of this origin, at this host, may connect."""
    cookie = f"{cookie_name(PORT)}={TOKEN}"
    return ask(access, host, Cookie=cookie, Upgrade="websocket", Origin=origin) is None


@pytest.mark.parametrize(
    ("address", "host", "origin"),
    [
        ("https://photos.example.org", "photos.example.org", None),
        ("https://photos.example.org:443", "photos.example.org", None),
        ("https://photos.example.org", "photos.example.org:443", None),
        ("HTTPS://Photos.Example.ORG", "photos.example.org", None),
        ("https://photos.example.org.", "photos.example.org", None),
        ("https://photos.example.org", "photos.example.org.", None),
        ("https://photos.example.org/", "photos.example.org", None),
        ("http://photos.example.org:80", "photos.example.org", "http"),
        ("https://photos.example.org:8443", "photos.example.org:8443", None),
        ("https://Müller.example", "xn--mller-kva.example", None),
        ("https://[2001:DB8:0:0::1]:443", "[2001:db8::1]", None),
        ("https://[2001:db8::1]:8443", "[2001:db8::1]:8443", None),
    ],
)
def test_an_address_is_compared_as_browsers_send_it(address, host, origin):
    access = AccessControl("127.0.0.1", TOKEN, address)
    assert enters(access, host, f"{origin or 'https'}://{host}")
    assert not enters(access, host, f"{origin or 'https'}://evil.example")
    assert not enters(access, f"{host}.evil.example", f"https://{host}.evil.example")
    assert not enters(access, "evil.example", "https://evil.example")
    assert access.entrance(PORT).endswith(f"/?token={TOKEN}")


def test_the_address_that_is_printed_is_the_browsers():
    access = AccessControl("127.0.0.1", TOKEN, "HTTPS://Photos.Example.org.:443/")
    assert access.entrance(PORT, with_token=False) == "https://photos.example.org"


@pytest.mark.parametrize(
    "address",
    [
        "https://photos.example.org\n",
        "https://photos.exa\r\nmple.org",
        "https://photos.example.org\t",
        "https://anna:secret@photos.example.org",
        "https://@photos.example.org",
        "https://photos.example.org\\@evil.example",
        "https://photos.example.org:port",
        "https://photos.example.org:99999",
        "https://photos.example.org/folder",
        "https://photos.example.org?x=1",
        "https://photos example.org",
        "https://photos_.exam<ple.org",
        "https://[2001:db8::1",
        "https://",
        "https://.",
        "ftp://photos.example.org",
        "photos.example.org",
        "",
    ],
)
def test_what_is_no_address_is_refused_in_one_sentence(address):
    with pytest.raises(InputError, match="address") as refused:
        AccessControl("127.0.0.1", TOKEN, address)
    assert "\n" not in str(refused.value)
    assert "secret" not in str(refused.value)


def test_hosts_and_origins_that_are_no_hosts_are_foreign():
    access = AccessControl()
    assert ask(access, f"127.0.0.1:{PORT}") is None
    assert ask(access, f"LOCALHOST:{PORT}") is None
    for host in (
        "",
        "127.0.0.1:port",
        "evil.example",
        "127.0.0.1@evil.example",
        "[::1",
    ):
        refused = ask(access, host)
        assert refused is not None, host
        assert refused.status_code == http.HTTPStatus.FORBIDDEN


def test_guesses_are_logged_and_after_ten_a_minute_not_looked_at(caplog):
    now = [0.0]
    access = AccessControl("0.0.0.0", TOKEN, guesses=Guesses(lambda: now[0]))
    host, guesser = f"192.0.2.1:{PORT}", "203.0.113.7"

    def status(token: str, peer: str = guesser) -> int:
        answer = ask(access, host, f"/?token={token}", peer)
        assert answer is not None
        return answer.status_code

    with caplog.at_level(logging.WARNING):
        for i in range(MOST_WRONG):
            assert status(f"wrong-{i}") == 403
            assert i > 0 or status("wrong-0") == 403, "the same again is no new guess"
    assert len(caplog.records) == MOST_WRONG
    assert guesser in caplog.text
    assert "wrong-" not in caplog.text, "it may be nearly right"
    assert status("wrong-again") == 429
    assert status(TOKEN) == 429, "not even the right one tells anything now"
    assert status(TOKEN, "198.51.100.9") == 303, "others come in"
    now[0] = WINDOW_S + 1.0
    assert status(TOKEN) == 303


def test_cookies_are_guesses_too_but_an_old_page_locks_nobody_out():
    access = AccessControl("0.0.0.0", TOKEN, guesses=Guesses())
    host, peer = f"192.0.2.1:{PORT}", "203.0.113.7"

    def status(token: str) -> int:
        cookie = f"{cookie_name(PORT)}={token}"
        answer = ask(access, host, peer=peer, Cookie=cookie)
        return 200 if answer is None else answer.status_code

    assert [status("of-yesterday") for _ in range(50)] == [403] * 50
    assert status(TOKEN) == 200
    for i in range(MOST_WRONG):
        status(f"wrong-{i}")
    assert status(TOKEN) == 429


def test_behind_a_proxy_one_who_guesses_keeps_no_other_out():
    access = AccessControl("127.0.0.1", TOKEN, "https://photos.example.org")

    def status(token: str, forwarded: str) -> int:
        path, host = f"/?token={token}", "photos.example.org"
        answer = ask(access, host, path, X_Forwarded_For=forwarded)
        assert answer is not None
        return answer.status_code

    for i in range(MOST_WRONG):
        # What comes before the last was said by the guesser, not by the proxy.
        status(f"wrong-{i}", f"10.0.0.{i}, 203.0.113.7")
    assert status(TOKEN, "10.0.0.99, 203.0.113.7") == 429
    assert status(TOKEN, "198.51.100.9") == 303


@pytest.mark.parametrize("token", ["short", "x" * 15, "x" * 20 + " ", "ü" * 20])
def test_a_token_that_is_short_or_odd_is_refused_in_one_sentence(token):
    with pytest.raises(InputError, match="at least 16 characters"):
        AccessControl.with_a_token("127.0.0.1", token)
