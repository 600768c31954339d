"""Ctrl-C: what it ends at once, and what it only asks to stop."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def ctrl_c_ends_at_once() -> Iterator[None]:
    """While there is nothing to clean up: among imports, a KeyboardInterrupt is lost.

    Or worse: passing through the code that makes a data class it has Python kill itself
    at its very end, though it was caught.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # A shell starts background programs so that they ignore Ctrl-C.
        return

    def end(*_: object) -> None:
        with contextlib.suppress(OSError):
            os.write(2, b"Stopped.\n")
        os._exit(1)

    signal.signal(signal.SIGINT, end)
    yield
    signal.signal(signal.SIGINT, signal.default_int_handler)


@contextlib.contextmanager
def asked_to_stop() -> Iterator[threading.Event]:
    """An event that Ctrl-C sets; a second Ctrl-C interrupts at once.

    An exception raised by the signal itself would land in the middle of compiled
    code, which cannot pass it on.
    """
    asked = threading.Event()
    previous = signal.getsignal(signal.SIGINT)

    def ask(*_: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, previous)
