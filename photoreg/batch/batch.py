"""A whole collection: what is left to do goes to the cluster, and comes back in parts.

The engine's promise holds here, too: a batch is a generator of frozen events, and to stop
is to stop iterating.
"""

import collections
import concurrent.futures
import contextlib
import dataclasses
import os
import queue
import time
import warnings
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from photoreg.batch.cluster import add_workers, connected, cores, dashboard_link
from photoreg.batch.collection import CollectionObject, Inputs, state_of
from photoreg.batch.mended import keep_cameras, mended_result, project_folder
from photoreg.batch.record import (
    ObjectRecord,
    is_known,
    load_record,
    save_record,
    still_holds,
)
from photoreg.batch.run import (
    LOG,
    SCRATCH,
    ObjectTask,
    Outcome,
    place_failure,
    place_shipped,
    run_task,
    sweep,
)
from photoreg.batch.settings import fingerprint
from photoreg.batch.summary import SummaryRow, row_of, write_summary
from photoreg.checks import inputs_read, noting_inputs
from photoreg.errors import InputError, OutputError, PhotoregError
from photoreg.formats.meshes.read import load_mesh
from photoreg.project.lock import FolderLock
from photoreg.sources import read_regular

MAX_FAILURES = 3
"""An object that fails by itself so often is set aside."""

MAX_LOST = 10
"""An object whose attempts are lost so often is left for the next batch: where one in five
attempts is cut short by chance, ten in a row are one object in ten million."""

WAITING = 200
"""At most this many objects wait at the scheduler: it need not hold ten thousand."""

REPLACE_S = 60.0
"""A worker that has been gone for this long is replaced; one starts in 3 to 10 s."""

POLL_S = 0.5
SUMMARY_PERIOD_S = 60.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class BatchProgress:
    """How far a batch is."""

    total: int
    looked_at: int
    """Objects of which it is known whether they are done."""
    done: int
    """Done now."""
    known: int
    """Done before, or mended."""
    failed: int
    """Set aside, refused, or left for the next batch."""
    lost: int
    """Attempts that were lost with their worker."""
    workers: int
    elapsed_s: float
    per_hour: float | None
    """Objects done per hour; None before the first is."""
    time_left_s: float | None
    dashboard: str
    """Where Dask's dashboard is; empty where there is none."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BatchFinished:
    """What came of a batch."""

    rows: tuple[SummaryRow, ...]
    """One an object, in the collection's order."""
    progress: BatchProgress
    summary: Path
    page: Path


@dataclasses.dataclass(frozen=True, kw_only=True)
class BatchConfig:
    """How a batch runs."""

    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://HOST:8786 or tls://HOST:8786; None: a cluster of
    this machine's cores, which nobody else can reach."""
    ship: bool = False
    """Send the files with each task, for workers that do not see the same disk."""
    workers: int | None = None
    """Objects at a time on this machine, each in its own process; None: one per core."""
    limit_min: float | None = None
    """Minutes after which an attempt is taken for hung, and its worker's process ends;
    None: never."""
    retry: bool = False
    """Try again what was set aside."""

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers is {self.workers}; give 1 or more.")
        if self.limit_min is not None and not 0.0 < self.limit_min < 1e6:
            raise InputError(
                f"limit_min is {self.limit_min}; give a number of minutes above 0."
            )


def run_batch(
    collection: Sequence[CollectionObject],
    out: Path,
    config: BatchConfig = BatchConfig(),
) -> Generator[BatchProgress | BatchFinished, None, None]:
    """Makes all results of a collection that are not there yet.

    Whenever it ends, also by being closed, the summary and the triage page are written.

    Args:
        collection: The objects.
        out: The folder of all results; it is made.
        config: How it runs.

    Raises:
        InputError: if Dask is not installed or there is no scheduler.
        OutputError: if the folder cannot be written, or another batch writes it.
    """
    out = out.absolute()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"Cannot make {out}: {error.strerror or error}.") from error
    lock = FolderLock(out)
    try:
        taken = lock.take()
    except OSError as error:
        raise OutputError(f"Cannot write in {out}: {error.strerror}.") from error
    if not taken:
        raise OutputError(
            f"Another batch is at work in {out} ({lock.holder or 'elsewhere'}). Wait for "
            "its end, or name another folder."
        )
    try:
        sweep(out)
        yield from _Batch(collection, out, config).run()
    finally:
        sweep(out)
        lock.release()


@dataclasses.dataclass
class _Attempts:
    """An object that is being worked on."""

    index: int
    inputs: Inputs
    files: dict[str, tuple[int, int]]
    failures: list[Outcome] = dataclasses.field(default_factory=list)
    lost: list[str] = dataclasses.field(default_factory=list)

    @property
    def number(self) -> int:
        return len(self.failures) + len(self.lost) + 1


class _Batch:
    def __init__(
        self, collection: Sequence[CollectionObject], out: Path, config: BatchConfig
    ) -> None:
        self._collection, self._out, self._config = collection, out, config
        self._n_workers = config.workers or cores()
        self._threads = max(1, cores() // self._n_workers)
        self._rows: list[SummaryRow | None] = [None] * len(collection)
        self._again: collections.deque[_Attempts] = collections.deque()
        self._running: dict[Any, _Attempts] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._looked_at = self._done = self._known = self._failed = self._lost = 0
        self._workers = 0
        self._dashboard = ""

    def run(self) -> Iterator[BatchProgress | BatchFinished]:
        self._began = self._written_at = time.monotonic()
        to_do = self._to_do()
        try:
            with contextlib.ExitStack() as end:
                pool = end.enter_context(concurrent.futures.ThreadPoolExecutor(1))
                cluster = connected(
                    self._config.scheduler, self._n_workers, self._threads
                )
                starting = None
                if self._has_new():
                    # Its processes import the engine while it is looked at what is done.
                    starting = pool.submit(end.enter_context, cluster)
                first = next(to_do, None)
                # Where nothing is left to do, no cluster is needed.
                if first is not None:
                    self._again.append(first)
                    starting = starting or pool.submit(end.enter_context, cluster)
                    yield from self._work(starting.result(), to_do)
        finally:
            written = write_summary(self._out, self._shown_rows())
        rows = tuple(self._shown_rows())
        yield BatchFinished(
            rows=rows, progress=self._progress(), summary=written[0], page=written[1]
        )

    def _has_new(self) -> bool:
        """Whether there is an object of which nothing is known at all."""
        return any(not is_known(self._out / thing.name) for thing in self._collection)

    def _to_do(self) -> Iterator[_Attempts]:
        """Objects that are not done; the others' rows are made on the way."""
        for index, thing in enumerate(self._collection):
            row = attempts = None
            try:
                row = self._known_row(thing)
                if row is None:
                    # Looked at before: what is found is not older than what is noted.
                    files = thing.files()
                    attempts = _Attempts(index, thing.inputs(), files)
            except (PhotoregError, OSError) as error:
                row = SummaryRow(name=thing.name, status="refused", sentence=str(error))
                self._failed += 1
            self._rows[index] = row
            self._looked_at += 1
            if attempts is not None:
                yield attempts

    def _known_row(self, thing: CollectionObject) -> SummaryRow | None:
        """The row of an object that is done, mended or set aside; None of any other."""
        folder = self._out / thing.name
        record = load_record(folder)
        if project_folder(folder).is_dir():
            result = mended_result(folder, record)
            if result is not None:
                keep_cameras(folder, result)
                self._known += 1
                return row_of(thing.name, record, result)
        if record is None or (record.ending == "failed" and self._config.retry):
            return None
        held = still_holds(record, thing)
        if held is None:
            return None
        if held is not record:
            save_record(folder, held)
        if record.ending == "failed":
            self._failed += 1
        else:
            self._known += 1
        return row_of(thing.name, held)

    def _work(self, client: Any, to_do: Iterator[_Attempts]) -> Iterator[BatchProgress]:
        self._dashboard = dashboard_link(client)
        self._whole_at = time.monotonic()
        left = True
        try:
            while left or self._running or self._again:
                self._workers = len(client.scheduler_info(n_workers=-1)["workers"])
                self._see_to_workers(client)
                room = self._window() - len(self._running)
                deadline = time.monotonic() + POLL_S
                tasks: dict[str, tuple[_Attempts, ObjectTask]] = {}
                # Some at a time, so that what has ended meanwhile is seen.
                while room > 0 and (left or self._again):
                    attempts = (
                        self._again.popleft() if self._again else next(to_do, None)
                    )
                    if attempts is None:
                        left = False
                        break
                    if (task := self._task(attempts)) is not None:
                        tasks[_key(attempts, task.name)] = attempts, task
                    room -= 1
                    if time.monotonic() > deadline:
                        break
                self._submit(client, tasks)
                yield self._progress()
                self._take(timeout_s=POLL_S if room <= 0 or not left else 0.0)
                if client.status not in ("running", "connecting"):
                    raise OutputError(
                        "The connection to Dask's scheduler was lost. What is done is "
                        "kept; run the same command again to go on."
                    )
                if time.monotonic() > self._written_at + SUMMARY_PERIOD_S:
                    write_summary(self._out, self._shown_rows())
                    self._written_at = time.monotonic()
        finally:
            if self._running:
                with contextlib.suppress(Exception):
                    client.cancel(list(self._running), force=True)

    def _see_to_workers(self, client: Any) -> None:
        """Replaces workers of our own cluster that were lost for good."""
        missing = self._n_workers - self._workers
        if missing <= 0 or self._config.scheduler is not None:
            self._whole_at = time.monotonic()
        elif time.monotonic() > self._whole_at + REPLACE_S:
            add_workers(client, missing)
            self._whole_at = time.monotonic()

    def _window(self) -> int:
        """How many objects are at the scheduler: those whose files are sent are few."""
        at_work = max(
            self._workers, self._n_workers if not self._config.scheduler else 1
        )
        return 2 * at_work if self._config.ship else at_work + WAITING

    def _submit(
        self, client: Any, tasks: dict[str, tuple[_Attempts, ObjectTask]]
    ) -> None:
        """Hands tasks to the cluster together.

        Dask keeps a task back from a busy worker only where it knows of many alike.
        """
        if not tasks:
            return
        at_work, given = zip(*tasks.values(), strict=True)
        futures = client.map(run_task, given, key=list(tasks), pure=False)
        for future, attempts in zip(futures, at_work, strict=True):
            self._running[future] = attempts
            future.add_done_callback(self._ended.put)

    def _task(self, attempts: _Attempts) -> ObjectTask | None:
        """The next attempt at an object; None where its files cannot be read."""
        thing = self._collection[attempts.index]
        contents = None
        try:
            if attempts.number > 1:
                attempts.files = thing.files()  # Somebody may have put it right.
            if self._config.ship:
                contents = _contents(thing, attempts)
        except (PhotoregError, OSError) as error:
            self._fail(attempts, Outcome(status="failed", sentence=str(error)))
            return None
        return ObjectTask(
            name=thing.name,
            base=thing.base,
            inputs=attempts.inputs,
            files=attempts.files,
            settings=thing.settings,
            out=self._out,
            scratch=_scratch(attempts),
            threads=self._threads if self._config.scheduler is None else 1,
            limit_s=self._config.limit_min and 60.0 * self._config.limit_min,
            contents=contents,
        )

    def _take(self, timeout_s: float) -> None:
        """Deals with attempts that have ended; waits this long for the first."""
        try:
            future = self._ended.get(timeout=timeout_s) if timeout_s else None
            while True:
                if future is not None:
                    self._end(future)
                future = self._ended.get_nowait()
        except queue.Empty:
            return

    def _end(self, future: Any) -> None:
        attempts = self._running.pop(future, None)
        if attempts is None:
            return
        try:
            outcome: Outcome = future.result()
        except Exception as error:  # noqa: BLE001 - the cluster's, not the object's.
            self._lose(attempts, f"{type(error).__name__}: {error}")
            return
        finally:
            future.release()
        if outcome.status == "out of memory":
            self._lose(attempts, outcome.sentence)
        elif outcome.status == "failed":
            self._fail(attempts, outcome)
        else:
            self._finish(attempts, outcome)

    def _finish(self, attempts: _Attempts, outcome: Outcome) -> None:
        thing = self._collection[attempts.index]
        folder = self._out / thing.name
        try:
            if outcome.results is not None:
                place_shipped(
                    outcome.results, self._out, thing.name, _scratch(attempts)
                )
            record = load_record(folder)
            if record is None:
                raise OutputError(
                    f"A worker wrote the results of {thing.name}, but they are not in "
                    f"{folder}. Share the folder with the workers, or use --ship."
                )
        except PhotoregError as error:
            self._fail(attempts, Outcome(status="failed", sentence=str(error)))
            return
        self._rows[attempts.index] = row_of(thing.name, record)
        self._done += 1

    def _lose(self, attempts: _Attempts, why: str) -> None:
        """An attempt was lost with its worker, or ran out of memory: try again."""
        attempts.lost.append(self._what_hung(attempts) or why)
        self._lost += 1
        if len(attempts.lost) < MAX_LOST:
            self._again.append(attempts)
            return
        self._set_row(
            attempts,
            "lost",
            f"{MAX_LOST} attempts were lost with their workers, the last like this: "
            f"{attempts.lost[-1].splitlines()[0]} The next batch tries it again.",
        )

    def _what_hung(self, attempts: _Attempts) -> str:
        """What a worker was doing when it ended itself; what it left is removed."""
        told = ""
        beginning = _scratch(attempts) + "-"
        for entry in os.scandir(self._out):
            if entry.name.startswith(beginning):
                with contextlib.suppress(OSError):
                    trace = read_regular(Path(entry.path) / "hang.txt").decode()
                    if trace:
                        told = f"It was ended after --limit-min.\n{trace}"
        sweep(self._out, beginning)
        return told

    def _fail(self, attempts: _Attempts, outcome: Outcome) -> None:
        """An attempt failed because of the object itself."""
        attempts.failures.append(outcome)
        if len(attempts.failures) < MAX_FAILURES:
            self._again.append(attempts)
            return
        thing = self._collection[attempts.index]
        told = [
            f"Attempt {number}: {each.sentence}\n{each.log}"
            for number, each in enumerate(attempts.failures, start=1)
        ]
        record = ObjectRecord(
            ending="failed",
            settings=fingerprint(thing.settings),
            base=str(thing.base),
            mesh=thing.told(attempts.inputs.mesh),
            photos=tuple(map(thing.told, attempts.inputs.photos)),
            cameras=thing.told(attempts.inputs.cameras),
            files={name: (*state, "") for name, state in attempts.files.items()},
            figures={"sentence": outcome.sentence},
        )
        sentence = outcome.sentence
        try:
            place_failure(
                self._out / thing.name, record, "\n".join([*told, *attempts.lost])
            )
        except OutputError as error:
            sentence = f"{sentence} {error}"
        self._set_row(attempts, "failed", sentence)

    def _set_row(
        self, attempts: _Attempts, status: Literal["failed", "lost"], sentence: str
    ) -> None:
        name = self._collection[attempts.index].name
        has_log = (self._out / name / LOG).is_file()
        self._rows[attempts.index] = SummaryRow(
            name=name, status=status, sentence=sentence, has_log=has_log
        )
        self._failed += 1

    def _shown_rows(self) -> list[SummaryRow]:
        return [
            row if row is not None else SummaryRow(name=thing.name, status="not run")
            for thing, row in zip(self._collection, self._rows, strict=True)
        ]

    def _progress(self) -> BatchProgress:
        elapsed_s = time.monotonic() - self._began
        per_s = self._done / elapsed_s if self._done else None
        left = len(self._collection) - self._done - self._known - self._failed
        return BatchProgress(
            total=len(self._collection),
            looked_at=self._looked_at,
            done=self._done,
            known=self._known,
            failed=self._failed,
            lost=self._lost,
            workers=self._workers,
            elapsed_s=elapsed_s,
            per_hour=None if per_s is None else 3600.0 * per_s,
            time_left_s=None if per_s is None else left / per_s,
            dashboard=self._dashboard,
        )


def _scratch(attempts: _Attempts) -> str:
    return f"{SCRATCH}{attempts.index}-{attempts.number}"


def _key(attempts: _Attempts, name: str) -> str:
    """An attempt's key in Dask, which groups tasks whose keys begin alike."""
    return f"object-{attempts.index}-{attempts.number}-{os.getpid()}-{name}"


def _contents(thing: CollectionObject, attempts: _Attempts) -> dict[str, bytes]:
    """The contents of an object's files, by path from its folder."""
    names = set(attempts.files)
    if thing.given is not None:
        # A row does not tell what the mesh names; reading it does.
        with noting_inputs(), warnings.catch_warnings(action="ignore"):
            load_mesh(attempts.inputs.mesh)
            names |= {thing.told(path) for path in inputs_read()}
    outside = [name for name in names if Path(name).is_absolute()]
    if outside:
        raise InputError(
            f"{outside[0]} lies outside {thing.base}. Only what lies with the table is "
            "sent to workers (--ship)."
        )
    for name in names - attempts.files.keys():
        if (state := state_of(thing.base / name)) is not None:
            attempts.files[name] = state
    return {name: read_regular(thing.base / name) for name in sorted(attempts.files)}
