"""How often a token may be guessed, and by whom it was tried."""

import collections
import hashlib
import logging
import time
from collections.abc import Callable

log = logging.getLogger(__name__)

MOST_WRONG = 10
"""Different wrong tokens from one address within ``WINDOW_S``; then none is looked at."""

WINDOW_S = 60.0

MOST_ADDRESSES = 10_000


class Guesses:
    """Remembers wrong tokens for a minute.

    The same one again is no new guess: a page left open sends its old cookie on and on.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._wrong: collections.OrderedDict[str, dict[bytes, float]] = (
            collections.OrderedDict()
        )

    def admits(self, address: str) -> bool:
        """Whether a token from this address is looked at."""
        since = self._clock() - WINDOW_S
        wrong = {k: t for k, t in self._wrong.get(address, {}).items() if t > since}
        if wrong:
            self._wrong[address] = wrong
        else:
            self._wrong.pop(address, None)
        return len(wrong) < MOST_WRONG

    def was_wrong(self, address: str, token: str) -> None:
        """Counts a wrong token, and logs that it came."""
        key = hashlib.sha256(token.encode(errors="replace")).digest()
        wrong = self._wrong.setdefault(address, {})
        if key in wrong:
            return
        wrong[key] = self._clock()
        self._wrong.move_to_end(address)
        while len(self._wrong) > MOST_ADDRESSES:
            self._wrong.popitem(last=False)
        log.warning("A wrong token from %s (%d within a minute)", address, len(wrong))
