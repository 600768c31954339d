"""Batches on Dask when things go wrong around them. `make test-cluster` runs all."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from photoreg.batch.cluster import connected
from tests.batch.collections import QUICK, QUICK_BATCH, make_collection
from tests.batch.test_batch import batch, summary
from tests.browser.driver import wait_until

pytestmark = pytest.mark.cluster

ROOT = Path(__file__).resolve().parents[2]


def command_of(collection: Path, out: Path, *words: str) -> list[str]:
    command = [sys.executable, "-m", "photoreg", "batch", str(collection)]
    return [*command, "--out", str(out), *words]


def workers_of(process: psutil.Process) -> list[psutil.Process]:
    """The processes that work on objects: those of Dask's nannies."""
    found = []
    for child in process.children(recursive=True):
        try:
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child)
        except psutil.Error:
            continue
    return found


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
        listening = [
            connection.laddr.ip
            for process in (root, *root.children(recursive=True))
            for connection in process.net_connections(kind="inet")
            if connection.status == psutil.CONN_LISTEN
        ]
        program.communicate("\n")
    assert len(listening) >= 3, "scheduler, nanny and worker"
    assert set(listening) == {"127.0.0.1"}


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
    chance, kills = random.Random(5), 0
    with subprocess.Popen(
        command_of(collection, out, *words), stderr=subprocess.PIPE, text=True
    ) as program:
        began = next_kill = time.monotonic()
        while program.poll() is None:
            time.sleep(0.2)
            if time.monotonic() > next_kill + KILL_PERIOD_S:
                next_kill = time.monotonic()
                if workers := workers_of(psutil.Process(program.pid)):
                    chance.choice(workers).kill()
                    kills += 1
        assert program.stderr is not None
        said = program.stderr.read()
    print(
        f"{N_KILLED} objects, {kills} kills, {time.monotonic() - began:.0f} s: {said}"
    )
    assert program.returncode == 0, said
    assert kills > 0
    rows = summary(out)
    assert len(rows) == N_KILLED
    assert {row["status"] for row in rows.values()} == {"done"}
    assert f"{N_KILLED} done now in" in said
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


def started(folder: Path, program: str, *words: str) -> subprocess.Popen[bytes]:
    """Dask's own program, with this photoreg to be found."""
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{program}", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@pytest.fixture
def dask_cluster(tmp_path) -> Iterator[str]:
    """A scheduler and a worker that are there already, in folders of their own."""
    address = tmp_path / "scheduler.json"
    common = ["--host", "127.0.0.1", "--scheduler-file", str(address)]
    scheduler = started(
        tmp_path, "scheduler", *common, "--port", "0", "--dashboard-address", ":0"
    )
    worker = started(
        tmp_path, "worker", *common, "--nthreads", "1",
        "--local-directory", str(tmp_path / "dask"),
    )  # fmt: skip
    wait_until(
        lambda: address.is_file() and address.stat().st_size > 0, "the scheduler", 60.0
    )
    yield json.loads(address.read_text())["address"]
    for program in (worker, scheduler):
        program.terminate()
        program.wait(timeout=60)


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


def test_a_scheduler_that_is_not_there_is_a_sentence(tmp_path):
    from photoreg.errors import InputError

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
