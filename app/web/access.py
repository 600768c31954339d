"""Access control: who is let in, and what every answer tells the browser to refuse.

viser checks neither Origin nor Host and knows no password: any page in the same browser
could drive a server on this machine. The websocket library's handshake hook, through
which every request goes, is the one seam.
"""

import contextlib
import dataclasses
import functools
import hmac
import http
import io
import ipaddress
import logging
import secrets
import string
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

import idna
import viser
import websockets.asyncio.server as websocket_server
from viser import _messages
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.web.incoming import check_incoming
from app.web.photo_server import ROOT, PhotoServer
from app.web.scripts import Hook, with_scripts
from app.web.token_guesses import Guesses
from app.web.viser_patches import use_thread_safe_buffers
from photoreg.errors import InputError
from photoreg.report.static_files import static_text

log = logging.getLogger(__name__)

MIN_TOKEN_CHARACTERS = 16
COOKIE_DAYS = 30
FOREIGN_PARAMETERS = ("websocket", "playbackPath")
"""In the page's address they name a server or a file that viser's page then trusts."""

SAFETY_HEADERS = {
    # Nothing from elsewhere, and nothing to elsewhere. viser's scripts stand in the page
    # itself, unpack themselves, and run in workers.
    "Content-Security-Policy": (
        "default-src 'none'; "
        "script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
        # No onclick= and the like: HTML of ours that let somebody's words through
        # would run nothing.
        "script-src-attr 'none'; worker-src 'self' blob:; "
        "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
        "font-src 'self' data:; connect-src 'self' data: blob:; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    # The address holds the token once.
    "Referrer-Policy": "no-referrer",
    # Pages of other origins neither show the photos nor hold on to this window.
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


@dataclasses.dataclass(frozen=True)
class AccessControl:
    """Who may come in.

    Raises:
        InputError: at construction, if the address or the token is not one.
    """

    host: str = "127.0.0.1"
    """Address that is listened on."""
    token: str | None = None
    """What lets in. None on a loopback address: this machine's programs need none."""
    address: str | None = None
    """Where people reach the server through a proxy, "https://photos.example.org"; kept
    as browsers write it."""
    guesses: Guesses = dataclasses.field(default_factory=Guesses, compare=False)
    """The wrong tokens that came."""

    def __post_init__(self) -> None:
        if self.address is not None:
            object.__setattr__(self, "address", _as_browsers_write(self.address))
        if self.token is None and self.is_public:
            raise InputError(
                f"Listening on {self.host!r} lets other machines in; it needs a token."
            )
        if self.token is not None and (
            len(self.token) < MIN_TOKEN_CHARACTERS
            or any(not (c.isalnum() or c in "-_.~") for c in self.token)
            or not self.token.isascii()
        ):
            raise InputError(
                f"A token should be at least {MIN_TOKEN_CHARACTERS} characters, letters, "
                "digits and -_.~ only. Leave it out, and photoreg makes one."
            )

    @classmethod
    def with_a_token(
        cls, host: str, token: str | None = None, address: str | None = None
    ) -> "AccessControl":
        """The same; where a token is needed and none is given, one is made."""
        if not token and (address is not None or not is_loopback(host)):
            token = secrets.token_urlsafe(24)
        return cls(host, token or None, address)

    @property
    def is_public(self) -> bool:
        """Whether other machines can reach the page."""
        return self.address is not None or not is_loopback(self.host)

    def entrance(self, port: int, with_token: bool = True) -> str:
        """The address to open, with the token that is asked for once."""
        shown = "127.0.0.1" if self.host in ("", "0.0.0.0", "::") else self.host
        if ":" in shown:
            shown = f"[{shown}]"
        address = self.address or f"http://{shown}:{port}"
        if self.token is None or not with_token:
            return address
        return f"{address.rstrip('/')}/?token={self.token}"

    def answer(self, request: Request, port: int, peer: str = "") -> Response | None:
        """A refusal, or the cookie for a token; None: let it in.

        Args:
            request: What is asked for.
            port: That it came to.
            peer: The address that it came from.
        """
        hosts = request.headers.get_all("Host")
        host = hosts[0] if len(hosts) == 1 else ""
        if not self._is_ours(host):
            # A foreign name that was made to resolve to this machine, or no name.
            return refusal(
                f"This server is not for {host or 'requests without a Host'}."
            )
        is_websocket = any(
            "websocket" in value.lower() for value in request.headers.get_all("Upgrade")
        )
        if is_websocket and not self._is_own_page(request, host):
            return refusal("Pages of another origin may not connect.")
        path, _, query = request.path.partition("?")
        pairs = parse_qsl(query, keep_blank_values=True)
        if not is_websocket and any(name in FOREIGN_PARAMETERS for name, _ in pairs):
            kept = [pair for pair in pairs if pair[0] not in FOREIGN_PARAMETERS]
            return _redirection(kept)
        if self.token is None:
            return None
        source = self._source(request, peer)
        if not self.guesses.admits(source):
            return _response(http.HTTPStatus.TOO_MANY_REQUESTS, TOO_OFTEN)
        if "token" in dict(pairs) and not is_websocket and path == "/":
            return self._exchange(pairs, port, source)
        given = cookies(request, cookie_name(port))
        if any(self._matches(value) for value in given):
            return None
        for value in given:
            self.guesses.was_wrong(source, value)
        return refusal(DOORMAT, html=path == "/" and not is_websocket)

    def _source(self, request: Request, peer: str) -> str:
        """Who asks: behind a proxy, whom the proxy names last."""
        forwarded = request.headers.get_all("X-Forwarded-For")
        if self.address is None or not is_loopback(peer) or not forwarded:
            return peer
        return forwarded[-1].rpartition(",")[2].strip()[:64] or peer

    def _is_ours(self, host: str) -> bool:
        if self.address is not None:
            scheme, _, own = self.address.partition("://")
            if _place(host, scheme) == _place(own, scheme):
                return True
        place = _place(host, "http")
        return place is not None and (
            not is_loopback(self.host) or is_loopback(place[0])
        )

    def _is_own_page(self, request: Request, host: str) -> bool:
        origins = request.headers.get_all("Origin")
        if len(origins) != 1:
            return False
        scheme, _, place = origins[0].partition("://")
        own = _place(host, scheme)
        return own is not None and _place(place, scheme) == own

    def _exchange(
        self, pairs: list[tuple[str, str]], port: int, source: str
    ) -> Response:
        """The cookie for the right token, and the address without it."""
        wrong = [v for k, v in pairs if k == "token" and not self._matches(v)]
        for value in wrong:
            self.guesses.was_wrong(source, value)
        if wrong:
            return _response(
                http.HTTPStatus.FORBIDDEN, _token_page().replace(*WRONG), HTML
            )
        secure = "; Secure" if (self.address or "").startswith("https") else ""
        # Lax, not Strict: a link in a mail must lead in at the first click.
        cookie = (
            f"{cookie_name(port)}={self.token}; Path=/; HttpOnly; SameSite=Lax; "
            f"Max-Age={COOKIE_DAYS * 86400}{secure}"
        )
        response = _redirection([pair for pair in pairs if pair[0] != "token"])
        response.headers["Set-Cookie"] = cookie
        return response

    def _matches(self, given: str) -> bool:
        return self.token is not None and hmac.compare_digest(
            given.encode(errors="replace"), self.token.encode()
        )


DOORMAT = (
    "This photoreg asks for its token: open the address that it printed when it was "
    "started."
)

TOO_OFTEN = "Too many wrong tokens came from your address. Wait a minute.\n"

HTML = {"Content-Type": "text/html; charset=utf-8"}
WRONG = ("<!-- wrong -->", '<p class="wrong" role="alert">That is not its token.</p>')
"""In the page with a place to type the token: where a wrong one is told, and how."""


def is_loopback(host: str) -> bool:
    """Whether an address or name means this machine alone."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def cookie_name(port: int) -> str:
    """Ports share a host's cookies; two servers must not overwrite each other's."""
    return f"photoreg-{port}"


def cookies(request: Request, name: str) -> list[str]:
    """The values of all cookies of this name."""
    pairs = (
        pair.strip().partition("=")
        for header in request.headers.get_all("Cookie")
        for pair in header.split(";")
    )
    return [value for key, _, value in pairs if key == name]


def refusal(text: str, html: bool = False) -> Response:
    """403, as a sentence, or as a page with a place to type the token."""
    status = http.HTTPStatus.FORBIDDEN
    if not html:
        return _response(status, text + "\n")
    return _response(status, _token_page(), HTML)


@functools.cache
def _token_page() -> str:
    return static_text("token.html")


def _redirection(pairs: list[tuple[str, str]]) -> Response:
    """To the page, with these parameters."""
    location = "/" + (f"?{urlencode(pairs)}" if pairs else "")
    return _response(http.HTTPStatus.SEE_OTHER, "", {"Location": location})


def _response(
    status: http.HTTPStatus, text: str, headers: dict[str, str] | None = None
) -> Response:
    body = text.encode()
    fields = {
        "Content-Type": "text/plain; charset=utf-8",
        "Content-Length": str(len(body)),
        "Cache-Control": "no-store",
        "Connection": "close",
        **(headers or {}),
    }
    return Response(status, status.phrase, Headers(fields), body)


def start_viser(
    access: AccessControl, port: int, pictures: PhotoServer
) -> viser.ViserServer:
    """A viser server with this access control, which also has our pictures."""
    use_thread_safe_buffers()
    check_incoming()
    serve = websocket_server.serve

    def serve_guarded(*args: Any, process_request: Any = None, **kwargs: Any) -> Any:
        hook = with_access_control(
            access, with_pictures(with_scripts(process_request), pictures)
        )
        return serve(*args, process_request=hook, server_header=None, **kwargs)

    websocket_server.serve = serve_guarded
    try:
        # viser prints a banner of its own; the app says where it is.
        with contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=access.host, port=port, verbose=False)
    finally:
        websocket_server.serve = serve
    # A browser could ask for a tunnel to share.viser.studio even where no button shows.
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)
    return server


def with_access_control(access: AccessControl, following: Hook) -> Hook:
    """The handshake hook: access control first, then ``following``; safe headers on all."""

    async def process(connection: ServerConnection, request: Request) -> Any:
        peer = str((connection.remote_address or ("",))[0])
        response = access.answer(request, connection.local_address[1], peer)
        if response is None:
            try:
                response = following(connection, request)
                if response is not None and not isinstance(response, Response):
                    response = await response
            except (OSError, ValueError):  # A name that no file can have.
                response = _response(http.HTTPStatus.NOT_FOUND, "NOT FOUND\n")
        if response is not None:
            for name, value in SAFETY_HEADERS.items():
                response.headers[name] = value
        return response

    return process


def with_pictures(following: Any, pictures: PhotoServer) -> Hook:
    """The handshake hook ``following``, and before it the paths of ``pictures``."""

    async def picture(path: str) -> Response:
        found = await pictures.answer(path)
        if found is None:
            return Response(http.HTTPStatus.NOT_FOUND, "NOT FOUND", Headers())
        kind, body = found
        caching = "no-cache" if path.endswith(".js") else "private, max-age=3600"
        headers = Headers(
            {
                "Content-Type": kind,
                "Content-Length": str(len(body)),
                "Cache-Control": caching,
                "Connection": "close",
            }
        )
        return Response(http.HTTPStatus.OK, "OK", headers, body)

    def process(connection: ServerConnection, request: Request) -> Any:
        if request.path.startswith(ROOT):
            return picture(request.path)
        return following(connection, request) if following is not None else None

    return process


DEFAULT_PORTS = {"http": 80, "https": 443}
HOST_CHARACTERS = frozenset(string.ascii_lowercase + string.digits + "-._")


def _as_browsers_write(address: str) -> str:
    """An address whose host and port are as browsers send them.

    Raises:
        InputError: if it is none, or holds more than scheme, host and port.
    """
    shape = "The address should be as in https://photos.example.org"
    if any(ord(c) <= 32 or ord(c) == 127 for c in address):
        raise InputError(
            f"{shape}, without spaces and line breaks, but is {address!r:.200}."
        )
    try:
        parts = urlsplit(address)
    except ValueError as error:
        raise InputError(f"{shape}, but is {address!r:.200}.") from error
    if "@" in parts.netloc or "\\" in address:
        raise InputError(f"{shape}, without a user or password before its host.")
    place = _place(parts.netloc, parts.scheme)
    if place is None:
        raise InputError(f"{shape}, but is {address!r:.200}.")
    if parts.path.strip("/") or parts.query or parts.fragment:
        raise InputError(
            f"The address {address!r:.200} should end after its host: photoreg must be "
            "at the top of a host name, not in a folder of it."
        )
    host, port = place
    shown = f"[{host}]" if ":" in host else host
    default = DEFAULT_PORTS[parts.scheme]
    return f"{parts.scheme}://{shown}" + ("" if port == default else f":{port}")


def _place(netloc: str, scheme: str) -> tuple[str, int] | None:
    """Host and port of "host:port", alike however they are written; None: it is none."""
    default = DEFAULT_PORTS.get(scheme)
    try:
        parts = urlsplit(f"//{netloc}")
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    if default is None or not host or parts.netloc != netloc or "@" in netloc:
        return None
    if parts.path or parts.query or parts.fragment:
        return None
    if "]" in netloc and netloc.rpartition("]")[2].partition(":")[0]:
        return None
    host = host.removesuffix(".")
    try:
        host = ipaddress.ip_address(host).compressed
    except ValueError:
        if not host.isascii():
            try:
                host = idna.encode(host, uts46=True).decode()
            except idna.IDNAError:
                return None
        if not host or any(c not in HOST_CHARACTERS for c in host):
            return None
    return host, default if port is None else port
