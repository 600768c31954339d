"""Processes beside the app: started with a pipe, and ended by the app alone.

Where Python can, they are forked from a process that has done nothing but import what they
need (`app.engine.fork_server`), which takes two seconds otherwise. The app itself has threads and is never forked.
"""

import contextlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # Windows has but one.
    from multiprocessing.context import ForkServerContext, SpawnContext

PATIENCE_S = 5.0
"""How long to wait for a process or thread to end."""


def spawned(
    target: Callable[..., None], *arguments: Any
) -> tuple[BaseProcess, Connection]:
    """Starts ``target(connection, *arguments)`` in a process of its own.

    Returns:
        The process, and our end of the pipe, which ends when the process dies.
    """
    context = _context()
    ours, theirs = context.Pipe()
    # Else it looks into the working folder for modules before it hears our path. Set for
    # good: several threads may start processes at once.
    os.environ["PYTHONSAFEPATH"] = "1"
    process = context.Process(
        target=_enter, args=(target, theirs, dict(os.environ), *arguments), daemon=True
    )
    with _deaf_to_ctrl_c():
        process.start()
    # Only while the child alone holds its end does its death end the pipe.
    theirs.close()
    return process, ours


def end(process: BaseProcess) -> None:
    """Ends a process, if need be by force."""
    process.terminate()
    process.join(timeout=PATIENCE_S)
    if process.is_alive():
        process.kill()
        process.join()


def _context() -> "SpawnContext | ForkServerContext":
    if sys.platform != "linux":
        # The libraries of macOS do not survive a fork; Windows has none.
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["app.engine.fork_server"])
    return context


@contextlib.contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """A process started within does not hear Ctrl-C, from its first moment on."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows.
        yield
        return
    # Its start would unblock the signal again, before the process that is forked from
    # starts: that one would die of Ctrl-C, and with it whoever waits for it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _enter(
    target: Callable[..., None],
    connection: Connection,
    environment: dict[str, str],
    *arguments: Any,
) -> None:
    # Ctrl-C in the terminal reaches the whole group; only the app decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.excepthook = sys.__excepthook__
    os.environ.clear()  # It has that of the first of these processes.
    os.environ.update(environment)
    if sys.platform == "linux":
        # numba makes a lock for this method of starting processes. One for "forkserver"
        # has a name in the system, which outlives a process that is ended.
        multiprocessing.set_start_method("fork", force=True)
    target(connection, *arguments)
