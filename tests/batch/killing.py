"""A batch whose workers are killed now and then, and what that costs."""

import contextlib
import dataclasses
import random
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import psutil

ATTEMPT = re.compile(r"\.photoreg-\d+-\d+-.+-(\d+)-[0-9a-f]{6}")
"""The folder of an attempt, which tells the process that is at it."""


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


@dataclasses.dataclass
class KilledBatch:
    """How a batch went that workers were killed of."""

    status: int
    said: str
    elapsed_s: float
    kills: int = 0
    at_work_s: float = 0.0
    """What the killed attempts had taken so far."""
    away_s: float = 0.0
    """From each kill until there was another worker at work in its place."""

    @property
    def lost(self) -> int:
        """Attempts that the batch says were lost."""
        told = re.search(r"(\d+) attempts? (?:was|were) lost", self.said)
        return int(told.group(1)) if told else 0


def run_killing(
    command: Sequence[str], out: Path, period_s: float, seed: int
) -> KilledBatch:
    """Runs a batch and kills one of its workers at random every so often."""
    chance = random.Random(seed)
    began = next_kill = time.monotonic()
    batch = KilledBatch(0, "", 0.0)
    begun: dict[int, float] = {}
    left: list[float] = []
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as program:
        while program.poll() is None:
            time.sleep(0.1)
            now, at_work = time.monotonic(), set()
            with contextlib.suppress(OSError):
                found = (ATTEMPT.fullmatch(path.name) for path in out.iterdir())
                at_work = {int(match.group(1)) for match in found if match}
            # A process that was not seen at work before takes the place of one.
            for _ in at_work - begun.keys():
                batch.away_s += now - left.pop(0) if left else 0.0
            begun = {pid: begun.get(pid, now) for pid in at_work | begun.keys()}
            if now > next_kill + period_s:
                next_kill = now
                if workers := workers_of(psutil.Process(program.pid)):
                    killed = chance.choice(workers)
                    killed.kill()
                    batch.kills += 1
                    batch.at_work_s += _age_s(out, killed.pid)
                    left.append(now)
        assert program.stderr is not None
        batch.said = program.stderr.read()
    batch.status, batch.elapsed_s = program.returncode, time.monotonic() - began
    return batch


def _age_s(out: Path, pid: int) -> float:
    """How long a process has been at its attempt; 0 where it was at none."""
    for path in out.iterdir():
        match = ATTEMPT.fullmatch(path.name)
        if match and int(match.group(1)) == pid:
            with contextlib.suppress(OSError):
                return time.time() - path.stat().st_ctime
    return 0.0
