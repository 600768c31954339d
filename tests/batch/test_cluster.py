"""Batches on Dask when things go wrong around them. `make test-cluster` runs all."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import psutil
import pytest

from photoreg.batch import cluster
from photoreg.batch.cluster import connected
from photoreg.errors import InputError
from tests.batch.collections import QUICK, QUICK_BATCH, make_collection
from tests.batch.killing import command_of, run_killing
from tests.batch.test_batch import batch, summary
from tests.browser.driver import wait_until

pytestmark = pytest.mark.cluster

ROOT = Path(__file__).resolve().parents[2]


def records(out: Path) -> list[Path]:
    return sorted(out.glob("*/object.json"))


def test_our_own_cluster_listens_on_loopback_only():
    with subprocess.Popen(
        [sys.executable, "-m", "tests.batch.cluster_program"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
        root = psutil.Process(program.pid)
        environments = [child.environ() for child in root.children(recursive=True)]
        listening = [
            connection.laddr.ip
            for process in (root, *root.children(recursive=True))
            for connection in process.net_connections(kind="inet")
            if connection.status == psutil.CONN_LISTEN
        ]
        program.communicate("\n")
    assert len(listening) >= 3, "scheduler, nanny and worker"
    assert set(listening) == {"127.0.0.1"}
    # Workers keep their memory from one array to the next, as a program of its own does.
    trim = os.environ.get("MALLOC_TRIM_THRESHOLD_")
    assert {each.get("MALLOC_TRIM_THRESHOLD_") for each in environments} == {trim}


@pytest.mark.slow
def test_ctrl_c_ends_all_processes_and_the_same_command_goes_on(tmp_path):
    collection, out = make_collection(tmp_path / "things", 6), tmp_path / "out"
    command = command_of(collection, out, *QUICK_BATCH)
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as program:
        wait_until(lambda: records(out), "the first object", 300.0)
        children = psutil.Process(program.pid).children(recursive=True)
        os.killpg(program.pid, signal.SIGINT)  # As a terminal does.
        _, said = program.communicate(timeout=60)
    assert program.returncode == 1
    assert "Stopped; " in said
    assert "Traceback" not in said
    _, alive = psutil.wait_procs(children, timeout=10)
    assert not alive
    assert not [path for path in out.iterdir() if path.name.startswith(".photoreg")]
    before = {path: path.stat().st_ino for path in records(out)}
    assert 1 <= len(before) < 6
    assert "not run" in {row["status"] for row in summary(out).values()}
    ended = batch(collection, out)
    assert ended.returncode == 0, ended.stderr
    assert f"{6 - len(before)} done now in" in ended.stderr
    assert {path: path.stat().st_ino for path in before} == before
    assert len(records(out)) == 6


@pytest.mark.slow
def test_an_attempt_that_is_over_the_limit_is_lost_and_not_the_object_s_failure(
    tmp_path,
):
    collection, out = make_collection(tmp_path / "things", 1), tmp_path / "out"
    # No attempt is that quick, so each ends its worker's process.
    ended = batch(collection, out, "--limit-min", "0.0001")
    assert ended.returncode == 1
    (row,) = summary(out).values()
    assert row["status"] == "lost"
    assert "--limit-min" in row["sentence"]
    assert not records(out)
    assert not [path for path in out.iterdir() if path.name.startswith(".photoreg")]
    ended = batch(collection, out)
    assert ended.returncode == 0, ended.stderr
    assert "1 done now in" in ended.stderr


N_KILLED = int(os.environ.get("PHOTOREG_KILL_OBJECTS", "30"))
KILL_PERIOD_S = float(os.environ.get("PHOTOREG_KILL_PERIOD_S", "10"))


@pytest.mark.slow
def test_killed_workers_lose_no_object_and_make_none_twice(tmp_path):
    collection, out = (
        make_collection(tmp_path / "things", N_KILLED, 3),
        tmp_path / "out",
    )
    words = [*QUICK, "--model", "none", "--no-report", "--workers", "2"]
    killed = run_killing(command_of(collection, out, *words), out, KILL_PERIOD_S, 5)
    assert killed.status == 0, killed.said
    assert killed.kills > 0
    # What is lost is an attempt a kill, and none of it is made twice.
    assert killed.lost <= killed.kills, killed.said
    rows = summary(out)
    assert len(rows) == N_KILLED
    assert {row["status"] for row in rows.values()} == {"done"}
    assert f"{N_KILLED} done now in" in killed.said
    # The same bits as alone; every third object is the same.
    for seed in range(3):
        alone = tmp_path / f"alone{seed}.json"
        folder = collection / f"object {seed:04d}"
        photos = sorted(map(str, folder.glob("*.png")))
        words = ["refine", str(folder / "rock.ply"), *photos, "--out", str(alone)]
        words += ["--cameras", str(folder / "rough.json"), *QUICK]
        subprocess.run([sys.executable, "-m", "photoreg", *words], check=True)
        for number in range(seed, N_KILLED, 3):
            made = out / f"object {number:04d}" / "cameras.json"
            assert made.read_bytes() == alone.read_bytes(), number


def started(
    folder: Path,
    program: str,
    *words: str,
    environment: Mapping[str, str] | None = None,
) -> subprocess.Popen[bytes]:
    """Dask's own program, with this photoreg to be found."""
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{program}", *words],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(sys.path),
            **(environment or {}),
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@contextlib.contextmanager
def cluster_of_one(
    tmp_path: Path, *words: str, environment: Mapping[str, str] | None = None
) -> Iterator[str]:
    """A scheduler and a worker that are there already, in folders of their own.

    Args:
        tmp_path: For these.
        words: For the worker.
        environment: Of both, beside what there is.
    """
    address = tmp_path / "scheduler.json"
    common = ["--host", "127.0.0.1", "--scheduler-file", str(address)]
    scheduler = started(
        tmp_path, "scheduler", *common, "--port", "0", "--dashboard-address", ":0",
        environment=environment,
    )  # fmt: skip
    worker = started(
        tmp_path, "worker", *common, "--nthreads", "1",
        "--local-directory", str(tmp_path / "dask"), *words, environment=environment,
    )  # fmt: skip
    wait_until(
        lambda: address.is_file() and address.stat().st_size > 0, "the scheduler", 60.0
    )
    try:
        yield json.loads(address.read_text())["address"]
    finally:
        for program in (worker, scheduler):
            program.terminate()
            program.wait(timeout=60)


@pytest.fixture
def dask_cluster(tmp_path) -> Iterator[str]:
    """A cluster that is there already."""
    with cluster_of_one(tmp_path) as address:
        yield address


@pytest.mark.slow
def test_a_cluster_that_is_there_gives_the_same_by_shared_path_and_by_sending(
    tmp_path, dask_cluster
):
    collection, out = make_collection(tmp_path / "things", 2), tmp_path / "out"
    shipped = tmp_path / "shipped"
    for folder, words in ((out, ()), (shipped, ("--ship",))):
        ended = batch(collection, folder, "--scheduler", dask_cluster, *words)
        assert ended.returncode == 0, ended.stderr
    for number in range(2):
        for file in ("cameras.json", "model.ply", "after.jpg"):
            one, other = (f / f"object {number:04d}" / file for f in (out, shipped))
            assert one.read_bytes() == other.read_bytes()
    # What came back is as known as what was written there.
    assert "0 done now in" in batch(collection, shipped).stderr


@pytest.mark.slow
def test_a_worker_that_its_nanny_kills_for_memory_costs_that_attempt_alone(tmp_path):
    collection, out = make_collection(tmp_path / "things", 2), tmp_path / "out"
    told = tmp_path / "hungry.txt"
    words = ("--memory-limit", "1500MB", "--preload", "tests.batch.hungry_worker")
    environment = {
        "PHOTOREG_HUNGRY": str(told),
        # As a cluster of our own has them: each death is counted by the batch, and no
        # object waits at a worker that may die of another one.
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
        "DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION": "1.0",
    }
    with cluster_of_one(tmp_path, *words, environment=environment) as address:
        ended = batch(collection, out, "--scheduler", address)
    assert ended.returncode == 0, ended.stderr
    assert "1 attempt was lost" in ended.stderr
    assert "2 done now in" in ended.stderr
    # It was at it, and was ended before it had all that it asked for.
    assert told.read_text() == "object 0000 asks\n"


def test_a_scheduler_that_is_not_there_is_a_sentence(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT_S", 1)
    with (
        pytest.raises(InputError, match="There is no Dask scheduler at"),
        connected("tcp://127.0.0.1:1", 1, 1),
    ):
        pass


class Hosts:
    """Two network namespaces as two hosts, with a cable between them: needs root."""

    NAMES = ("photoreg-one", "photoreg-two")
    ADDRESSES = ("10.77.0.1", "10.77.0.2")

    def __init__(self) -> None:
        self.remove()
        one, two = self.NAMES
        for name in self.NAMES:
            self._ip("netns", "add", name)
        self._ip(
            "link", "add", "pr-one", "netns", one, "type", "veth",
            "peer", "name", "pr-two", "netns", two,
        )  # fmt: skip
        for name, device, address in zip(
            self.NAMES, ("pr-one", "pr-two"), self.ADDRESSES, strict=True
        ):
            self._ip("-n", name, "addr", "add", f"{address}/24", "dev", device)
            self._ip("-n", name, "link", "set", device, "up")
            self._ip("-n", name, "link", "set", "lo", "up")

    def _ip(self, *words: str) -> None:
        subprocess.run(["ip", *words], check=True)

    def cut(self) -> None:
        """Pulls the cable."""
        self._ip("-n", self.NAMES[1], "link", "set", "pr-two", "down")

    def inside(self, host: int) -> list[str]:
        """What a command begins with to run on a host."""
        return ["ip", "netns", "exec", self.NAMES[host]]

    def remove(self) -> None:
        for name in self.NAMES:
            subprocess.run(
                ["ip", "netns", "del", name], check=False, stderr=subprocess.DEVNULL
            )


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="two hosts need root"
)
def test_of_two_hosts_one_is_cut_off_and_the_batch_finishes(tmp_path):
    collection, out = make_collection(tmp_path / "things", 12), tmp_path / "out"
    hosts, programs = Hosts(), []
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(sys.path),
        # A host that says nothing is given up after so long; five minutes by itself.
        "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "20s",
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": "15s",
    }

    def start(host: int, program: str, *words: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}", *words]
        programs.append(
            subprocess.Popen(
                [*hosts.inside(host), *command],
                cwd=tmp_path,
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )

    try:
        one, two = Hosts.ADDRESSES
        start(0, "scheduler", "--host", one, "--port", "8786")
        for host, address in enumerate((one, two)):
            start(
                host, "worker", f"tcp://{one}:8786", "--host", address, "--nthreads", "1",
                "--local-directory", str(tmp_path / f"dask{host}"),
            )  # fmt: skip
        words = [
            *QUICK,
            "--model",
            "none",
            "--scheduler",
            f"tcp://{one}:8786",
            "--ship",
        ]
        with subprocess.Popen(
            [*hosts.inside(0), *command_of(collection, out, *words)],
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        ) as program:
            wait_until(lambda: len(records(out)) >= 3, "three objects", 600.0)
            hosts.cut()
            _, said = program.communicate(timeout=900)
    finally:
        for each in programs:
            each.kill()
            each.wait()
        hosts.remove()
    assert program.returncode == 0, said
    assert {row["status"] for row in summary(out).values()} == {"done"}
    assert "12 done now in" in said
