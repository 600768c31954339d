"""Dask: a cluster of this machine's cores, or one that is there."""

import contextlib
import importlib.util
import logging
import os
import warnings
from collections.abc import Iterator
from typing import Any

from photoreg.errors import InputError

LOOPBACK = "127.0.0.1"

CONNECT_TIMEOUT_S = 30

GIVES_BACK_AT_ONCE = "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_"
"""Dask has its workers give every freed array back to the system, which must clear it anew
for the next one: a refinement then takes twelve times the page faults, and 1.5 times the
processor seconds."""

ONE_THREAD_EACH = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
)


@contextlib.contextmanager
def connected(scheduler: str | None, n_workers: int, threads: int) -> Iterator[Any]:
    """A `distributed.Client` of the scheduler given, or of a cluster of our own.

    Our own is bound to loopback, its dashboard too; it ends with the context.

    Args:
        scheduler: Address of a scheduler; None: a cluster of our own.
        n_workers: Of our own: processes, each of which works on one object at a time.
        threads: Of our own: the engine's threads in each.

    Raises:
        InputError: if Dask is not installed, or there is no scheduler at the address.
    """
    try:
        import dask.config  # noqa: PLC0415 - an extra, and it takes a second.
        import distributed  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise InputError(
            "photoreg batch runs on Dask, which is not installed. Install it: "
            "pip install 'photoreg[cluster]'"
        ) from error
    with warnings.catch_warnings(), contextlib.ExitStack() as end:
        # What becomes of workers is told in the progress and the logs of objects; asyncio
        # would print a traceback of each that died while it was being started.
        for name in ("distributed", "asyncio"):
            logger = logging.getLogger(name)
            end.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        # Contents that are sent along are meant to be.
        warnings.filterwarnings("ignore", message="Sending large graph")
        if scheduler is not None:
            try:
                client = distributed.Client(
                    scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False
                )
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(
                    f"There is no Dask scheduler at {scheduler} ({error}). Its address is "
                    "like tcp://HOST:8786; start one with `dask scheduler`."
                ) from error
            yield end.enter_context(client)
            return
        end.enter_context(
            dask.config.set(
                {
                    # Each death of a worker is counted here, see `Attempts`.
                    "distributed.scheduler.allowed-failures": 0,
                    # No object waits at a worker that may die because of another one.
                    "distributed.scheduler.worker-saturation": 1.0,
                    GIVES_BACK_AT_ONCE: None,
                }
            )
        )
        cluster = distributed.LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            # None, for no dashboard, is right, though its type does not say so.
            dashboard_address=f"{LOOPBACK}:0" if has_dashboard() else None,  # pyright: ignore[reportArgumentType]
            silence_logs=logging.CRITICAL,
            env={name: str(threads) for name in ONE_THREAD_EACH},
            memory_limit=1.0 / n_workers,
            preload=["photoreg.batch.worker"],
        )
        end.enter_context(cluster)
        # Nobody waits for the last of them.
        cluster.scale(n_workers)
        yield end.enter_context(distributed.Client(cluster, set_as_default=False))


def add_workers(client: Any, n: int) -> None:
    """Starts more workers in a cluster of our own, for those that do not come back.

    A worker that dies while it is being started is one that Dask forgets.
    """
    cluster = client.cluster
    if cluster is not None:
        cluster.scale(len(cluster.worker_spec) + n)


def has_dashboard() -> bool:
    """Whether what draws Dask's dashboard is installed."""
    return importlib.util.find_spec("bokeh") is not None


def dashboard_link(client: Any) -> str:
    """Where the dashboard is; empty where there is none."""
    return str(client.dashboard_link) if has_dashboard() else ""


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
