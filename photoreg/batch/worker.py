"""What a worker's process of our own cluster does at its start."""

import contextlib
import signal
from typing import Any

from photoreg.batch import run  # noqa: F401 - imported once, before the first object.


def dask_setup(_: Any) -> None:
    """Ctrl-C is for the program that asked for the work; it ends its workers itself."""
    with contextlib.suppress(ValueError):  # Not the main thread.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
