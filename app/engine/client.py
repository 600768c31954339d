"""The app's end of the worker process: start it, send jobs, pump its events, outlive it.

Compute has one owner. Numba's thread pool aborts the program when two threads set off
parallel kernels, and viser calls back from 32 threads; so cameras are refined and textures
baked in one spawned process, and the page stays quick.
"""

import contextlib
import dataclasses
import logging
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from app.engine.spawn import PATIENCE_S, end, spawned
from app.model.messages import Died, Event, Job, Live, Passing, Pause, Resume, Stop

log = logging.getLogger(__name__)

MAX_QUICK_DEATHS = 3
"""Deaths in a row without a single event after which no new process is started."""


class Worker:
    """A warm worker process. Events arrive on a thread of this object, in order.

    When the process dies (killed, out of memory) the pipe ends at once: ``Died`` is
    reported and a new process is started.
    """

    def __init__(self, on_event: Callable[[Event], None], warm_up: bool = True) -> None:
        self._on_event = on_event
        self._warm_up = warm_up
        self._lock = threading.Lock()
        self._closed = False
        self._deaths_in_a_row = 0
        self._start()

    @property
    def pid(self) -> int | None:
        """The process's id; waits until it is started."""
        return self._process.result().pid

    def send(self, *jobs: Job) -> None:
        """Queues jobs; returns at once, however busy the process is."""
        with self._lock:
            for job in jobs:
                self._jobs.put(job)

    def stop_refinement(self) -> None:
        """Asks the running refinement to end and report its best."""
        self.send(Stop())

    def pause_refinement(self) -> None:
        """Halts the running refinement where it is."""
        self.send(Pause())

    def resume_refinement(self) -> None:
        """Goes on with a refinement that was halted."""
        self.send(Resume())

    def close(self) -> None:
        """Ends the process; no event arrives afterwards."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._jobs.put(None)
            process, pump = self._process, self._pump
        with contextlib.suppress(OSError):
            end(process.result())
        if pump is not threading.current_thread():
            pump.join(timeout=PATIENCE_S)

    def _start(self) -> None:
        """Has a process started, on a thread: that may take two seconds."""
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._process: Future[BaseProcess] = Future()
        self._pump = threading.Thread(
            target=self._run,
            args=(self._process, self._jobs),
            daemon=True,
            name="worker events",
        )
        self._pump.start()

    def _run(
        self, started: "Future[BaseProcess]", jobs: queue.SimpleQueue[Job | None]
    ) -> None:
        """One life of the process."""
        try:
            process, connection = spawned(_enter, self._warm_up)
        except OSError as error:
            log.exception("The worker process could not be started")
            started.set_exception(error)
            self._succeed(None)
            return
        started.set_result(process)
        sender = threading.Thread(
            target=self._send_jobs,
            args=(connection, jobs),
            daemon=True,
            name="worker jobs",
        )
        sender.start()
        self._pump_events(connection)
        # Closed when nobody uses it any more: the next pipe may get the same number,
        # and the rest of a job would go to the new process.
        jobs.put(None)
        sender.join(timeout=PATIENCE_S)
        connection.close()
        process.join(timeout=PATIENCE_S)
        self._succeed(process.exitcode)

    def _send_jobs(
        self, connection: Connection, jobs: queue.SimpleQueue[Job | None]
    ) -> None:
        # A pipe holds 64 KB; a mesh waits here, not in the callback that sends it.
        while (job := jobs.get()) is not None:
            try:
                connection.send(job)
            except OSError:
                return  # The process is gone.

    def _pump_events(self, connection: Connection) -> None:
        """Reports what arrives until the pipe ends."""
        while True:
            try:
                events = [connection.recv()]
                while connection.poll(0):
                    events.append(connection.recv())
            except (EOFError, OSError):
                return
            self._deaths_in_a_row = 0
            for event in newest(events):
                self._report(event)

    def _report(self, event: Event) -> None:
        if self._closed:
            return
        try:
            self._on_event(event)
        except Exception:
            log.exception("%s was not handled", type(event).__name__)

    def _succeed(self, exit_code: int | None) -> None:
        """Starts the next process after one that died."""
        with self._lock:
            if self._closed:
                return
            self._deaths_in_a_row += 1
            if self._deaths_in_a_row <= MAX_QUICK_DEATHS:
                self._start()
        self._report(Died(exit_code))


def _enter(connection: Connection, warm_up: bool) -> None:
    # In the child only: engine and compiler take seconds, and the page does without.
    from app.engine.process import run_worker  # noqa: PLC0415

    run_worker(connection, warm_up)


def newest(events: list[Event]) -> list[Event]:
    """Keeps only the last of each kind of transient event (progress, pictures).

    The cost curve is kept whole, because it is sent as changes.
    """
    last = {type(event): i for i, event in enumerate(events)}
    curve = tuple(p for event in events if isinstance(event, Live) for p in event.curve)
    return [
        dataclasses.replace(event, curve=curve) if isinstance(event, Live) else event
        for i, event in enumerate(events)
        if not isinstance(event, Passing) or last[type(event)] == i
    ]
