"""Processes beside the app: spawned with a pipe, and ended by the app alone."""

import multiprocessing
import signal
from collections.abc import Callable
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
    process.start()
    # Only while the child alone holds its end does its death end the pipe.
    theirs.close()
    return process, ours


def _enter(
    target: Callable[..., None], connection: Connection, *arguments: Any
) -> None:
    # Ctrl-C in the terminal reaches the whole group; only the app decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    target(connection, *arguments)
