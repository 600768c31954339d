"""Processes beside the app: spawned with a pipe, and ended by the app alone."""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

PATIENCE_S = 5.0
"""How long a process or thread that was told to end is waited for."""


def spawned(
    target: Callable[..., None], *arguments: Any
) -> tuple[BaseProcess, Connection]:
    """Starts ``target(connection, *arguments)`` in a process of its own.

    Returns:
        The process, and our end of the pipe, which ends when the process dies.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(
        target=_enter, args=(target, theirs, *arguments), daemon=True
    )
    # Else it looks into the working folder for modules before it hears our path. Set for
    # good: several threads may start processes at once.
    os.environ["PYTHONSAFEPATH"] = "1"
    with _deaf_to_ctrl_c():
        process.start()
    # Only while the child alone holds its end does its death end the pipe.
    theirs.close()
    return process, ours


@contextlib.contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """A process started within does not hear Ctrl-C, from its first moment on."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows.
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _enter(
    target: Callable[..., None], connection: Connection, *arguments: Any
) -> None:
    # Ctrl-C in the terminal reaches the whole group; only the app decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    target(connection, *arguments)
