"""A batch's figures: `python -m tests.bench.batch known`, `speed`, `kills`.

known: ten thousand objects of which all but ten are done; the time until the first of
these is worked on, and the memory of the program until its end. speed: the rate on one
core against a shell loop over `photoreg refine`, and on two cores against one. kills: what
workers that are killed cost, beside what their attempts had taken and their restarts.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tests.batch.collections import QUICK, make_collection, make_object
from tests.batch.killing import run_killing
from tests.bench.metrics import Metric

N_LEFT = 10
KILL_PERIOD_S = 20.0
PLAIN = (*QUICK, "--model", "none", "--no-report")


def _command(collection: Path, out: Path, workers: int) -> list[str]:
    command = [sys.executable, "-m", "photoreg", "batch", str(collection)]
    return [*command, "--out", str(out), *PLAIN, "--workers", str(workers)]


def known(n: int) -> Iterator[Metric]:
    """Many objects that are done but for ten, which are the last.

    The done ones are one object many times, by links to its files.
    """
    with tempfile.TemporaryDirectory(prefix="photoreg-bench-") as folder:
        collection, out = Path(folder) / "things", Path(folder) / "out"
        first = make_object(collection / "object 00000")
        subprocess.run(_command(collection, out, 1), check=True)
        record = json.loads((out / first.name / "object.json").read_text())
        for number in range(1, n):
            name = f"object {number:05d}"
            (collection / name).mkdir()
            for file in first.iterdir():
                os.link(file, collection / name / file.name)
            if number < n - N_LEFT:
                (out / name).mkdir()
                record["base"] = str(collection / name)
                text = json.dumps(record, indent=1)
                (out / name / "object.json").write_text(text)
        began = time.perf_counter()
        first_s = None
        with subprocess.Popen(_command(collection, out, 2)) as program:
            most_kb = 0
            while program.poll() is None:
                if first_s is None and next(out.glob(".photoreg-*"), None):
                    first_s = time.perf_counter() - began
                with contextlib.suppress(OSError, StopIteration, ValueError):
                    lines = Path(f"/proc/{program.pid}/status").read_text().split("\n")
                    line = next(line for line in lines if line.startswith("VmHWM"))
                    most_kb = max(most_kb, int(line.split()[1]))
                time.sleep(0.02)
        assert program.returncode == 0
        assert first_s is not None
        yield Metric(
            "batch.known.first_s", first_s, "s", "lower", 10.0, note=f"{n} objects"
        )
        yield Metric("batch.known.memory_mb", most_kb / 1024, "MB", "lower", 500.0)
        page_mb = (out / "index.html").stat().st_size / 1e6
        yield Metric("batch.known.page_mb", page_mb, "MB", "lower")


def speed(n: int) -> Iterator[Metric]:
    """Objects an hour: a shell loop, one core, two cores, each pinned to its cores."""
    with tempfile.TemporaryDirectory(prefix="photoreg-bench-") as folder:
        collection = make_collection(Path(folder) / "things", n)
        began = time.perf_counter()
        for thing in sorted(collection.iterdir()):
            photos = sorted(map(str, thing.glob("*.png")))
            words = [str(thing / "rock.ply"), *photos, *QUICK]
            words += ["--cameras", str(thing / "rough.json")]
            words += ["--out", str(thing.with_suffix(".out.json"))]
            _pinned([sys.executable, "-m", "photoreg", "refine", *words], 1)
        loop_s = time.perf_counter() - began
        for left in collection.glob("*.out.json"):
            left.unlink()
        took = []
        for cores in (1, 2):
            began = time.perf_counter()
            _pinned(_command(collection, Path(folder) / f"out{cores}", cores), cores)
            took.append(time.perf_counter() - began)
        yield Metric("batch.speed.loop", 3600 * n / loop_s, "an hour", "higher")
        yield Metric(
            "batch.speed.ratio_to_loop", loop_s / took[0], "", "higher", 1.0,
            note=f"{n} objects",
        )  # fmt: skip
        yield Metric(
            "batch.speed.ratio_of_two_cores", took[0] / took[1], "", "higher", 1.8
        )


def kills(n: int) -> Iterator[Metric]:
    """The same objects with and without a worker killed every 20 s, by two workers."""
    with tempfile.TemporaryDirectory(prefix="photoreg-bench-") as folder:
        collection = make_collection(Path(folder) / "things", n)
        began = time.perf_counter()
        out = Path(folder) / "out"
        subprocess.run(
            _command(collection, out, 2), check=True, stderr=subprocess.DEVNULL
        )
        quiet_s = time.perf_counter() - began
        out = Path(folder) / "killed"
        killed = run_killing(_command(collection, out, 2), out, KILL_PERIOD_S, seed=5)
        assert killed.status == 0, killed.said
        note = f"{killed.kills} kills, {killed.lost} attempts"
        yield Metric(
            "batch.kills.lost_s", 2.0 * (killed.elapsed_s - quiet_s), "worker s", "lower",
            killed.at_work_s + killed.away_s, note=note,
        )  # fmt: skip
        yield Metric("batch.kills.attempts_s", killed.at_work_s, "worker s", "lower")
        yield Metric("batch.kills.restarts_s", killed.away_s, "worker s", "lower")


def _pinned(command: list[str], n_cores: int) -> None:
    cores = ",".join(map(str, range(n_cores)))
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
    subprocess.run(
        ["taskset", "--cpu-list", cores, *command],
        check=True,
        env=environment,
        stderr=subprocess.DEVNULL,
    )


def main() -> None:
    """Prints the figures asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("known", "speed", "kills"))
    parser.add_argument(
        "--n", type=int, default=0, help="objects; 0: 10,000, 20 or 100"
    )
    given = parser.parse_args()
    measure, usual = {
        "known": (known, 10_000),
        "speed": (speed, 20),
        "kills": (kills, 100),
    }[given.what]
    figures = measure(given.n or usual)
    for figure in figures:
        bar = "" if figure.bar is None else f" (bar {figure.bar:g})"
        print(f"{figure.name} {figure.value:.4g} {figure.unit}{bar} {figure.note}")


if __name__ == "__main__":
    main()
