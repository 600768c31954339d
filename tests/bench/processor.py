"""Where processor time goes: of a process and what it started, told by Linux."""

import os
from pathlib import Path

TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def processor_s(root: int, without: tuple[int, ...] = ()) -> float:
    """Seconds of processor that a process and its living descendants have used.

    Args:
        root: The process's id.
        without: Descendants left out, with theirs.
    """
    used: dict[int, float] = {}
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            # The name, in brackets, may hold anything; the rest is numbers.
            fields = (folder / "stat").read_text().rpartition(") ")[2].split()
        except OSError:
            continue  # It has just ended.
        pid = int(folder.name)
        used[pid] = (int(fields[11]) + int(fields[12])) / TICKS_PER_S
        children.setdefault(int(fields[1]), []).append(pid)
    total, waiting = 0.0, [root]
    while waiting:
        pid = waiting.pop()
        if pid in used and pid not in without:
            total += used[pid]
            waiting += children.get(pid, [])
    return total


def busy_s() -> float:
    """Seconds of processor that this machine has used, or lost to others of its host."""
    user, nice, system, _, _, irq, softirq, steal, *_ = map(
        int, Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    )
    return (user + nice + system + irq + softirq + steal) / TICKS_PER_S
