"""numba's workqueue layer, macOS's default: it aborts where two threads run kernels."""

import concurrent.futures
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from photoreg.texture import kernels

DEMO = Path(__file__).parents[2] / "static" / "demo"
PHOTOS = ("shell-left.jpg", "shell-right.jpg")


def run(command: str, *words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "photoreg", command, "shell.ply", *PHOTOS, *words],
        cwd=DEMO,
        env=os.environ | {"NUMBA_THREADING_LAYER": "workqueue"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_the_demo_is_refined_and_textured(tmp_path: Path) -> None:
    cameras, model = str(tmp_path / "refined.json"), str(tmp_path / "model.glb")
    run("refine", "--cameras", "rough.json", "--preset", "fast", "--out", cameras)
    run("texture", "--cameras", cameras, "--size", "512", "--out", model)


def test_a_helper_thread_that_calls_a_parallel_function_is_told() -> None:
    """So `conftest` guards every test, whatever layer it runs under."""
    faces = np.full((4, 4), -1, np.int32)
    with concurrent.futures.ThreadPoolExecutor(1) as threads:
        call = threads.submit(kernels.grow_faces, faces)
    with pytest.raises(AssertionError, match="from a helper thread"):
        call.result()
