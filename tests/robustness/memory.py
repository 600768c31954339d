"""How much memory a process has needed."""

import resource
import sys
from pathlib import Path


def peak_memory_gb() -> float:
    """Most memory that this process has held so far, in GB of 10^9 bytes.

    On Linux not by getrusage: there a new program inherits the peak of the one that
    starts it.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        peak_kib = status.read_text().partition("VmHWM:")[2].split()[0]
        return int(peak_kib) * 1024 / 1e9
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts in bytes, others in KiB.
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e9
