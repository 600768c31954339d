"""Our own scripts and stylesheet, put into viser's page as it is served.

viser's page takes scripts of an app only as attributes of HTML, which would run anybody's
too. Here they stand in the page's head, as files from this server.
"""

import functools
import gzip
import http
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

SCRIPTS = ("page", "layout", "compare", "picker", "view", "tour")
"""Files of static/, in the order in which they run."""

Hook = Callable[[ServerConnection, Request], Any]


def with_scripts(following: Any) -> Hook:
    """The handshake hook ``following``, viser's own, with our scripts in its page."""

    def process(connection: ServerConnection, request: Request) -> Any:
        response = following(connection, request) if following is not None else None
        if (
            isinstance(response, Response)
            and response.status_code == http.HTTPStatus.OK
            and response.headers.get("Content-Type", "").startswith("text/html")
        ):
            is_packed = response.headers.get("Content-Encoding") == "gzip"
            response.body = _with_tags(bytes(response.body), is_packed)
            del response.headers["Content-Length"]
            response.headers["Content-Length"] = str(len(response.body))
        return response

    return process


@functools.lru_cache(maxsize=4)
def _with_tags(page: bytes, is_packed: bool) -> bytes:
    tags = '<link rel="stylesheet" href="/photoreg/page.css">' + "".join(
        f'<script defer src="/photoreg/{name}.js"></script>' for name in SCRIPTS
    )
    whole = gzip.decompress(page) if is_packed else page
    head, end, rest = whole.rpartition(b"</head>")
    assert end, "viser's page has a head."
    whole = head + tags.encode() + end + rest
    return gzip.compress(whole) if is_packed else whole
