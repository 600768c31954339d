"""A worker that asks for too much memory at its first object, as one that leaks does."""

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.batch import run

STEP, MOST = 64_000_000, 6_000_000_000
"""Bytes at a time, slower than the nanny looks; and four times its limit."""


def dask_setup(_: Any) -> None:
    told, make_results = Path(os.environ["PHOTOREG_HUNGRY"]), run.make_results

    def hungry(task: run.ObjectTask, base: Path, folder: Path) -> Any:
        if not told.exists():
            told.write_text(f"{task.name} asks\n")
            eaten = []
            for _ in range(MOST // STEP):
                eaten.append(np.ones(STEP, dtype=np.uint8))
                time.sleep(0.1)
            told.write_text(f"{task.name} asks and gets it all\n")
        return make_results(task, base, folder)

    run.make_results = hungry
