"""Unexpected failures: logged once, not over and over.

No viser here; `app.web.controls.report` shows them on the page.
"""

import logging
import time

log = logging.getLogger(__name__)

MESSAGE_SECONDS = 9.0
"""So long a message stays on a screen."""

UNFORESEEN = (
    "Something failed that photoreg did not foresee. Your work is as it was before; "
    "photoreg.log in the project's folder has the details."
)

_told: dict[tuple[int | None, str], float] = {}


def log_failure(what: str, error: Exception) -> None:
    """Puts a failure into the log, unless it was put there a moment ago."""
    if is_news(None, f"{what}: {error}"):
        log.error("%s failed", what, exc_info=error)


def is_news(browser: int | None, text: str) -> bool:
    """Whether a browser, or the log, has not had this within the last seconds.

    While a camera is dragged, the same thing fails twenty times a second.
    """
    now = time.monotonic()
    for key, when in list(_told.items()):
        if now - when > MESSAGE_SECONDS:
            _told.pop(key, None)
    return _told.setdefault((browser, text), now) == now
