"""The compiled cost of the search beside a plain C++ loop of the same arithmetic."""

import ctypes
import inspect
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numba as nb
import numpy as np

from photoreg.geometry.sampling import sample_surface
from photoreg.parameters.genes import GeneMap
from photoreg.search import photo_consistency
from photoreg.search.config import ConsistencyConfig
from photoreg.search.kernels import population_costs
from photoreg.search.photo_consistency import PhotoConsistency
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.worlds import world

SOURCE = Path(__file__).with_name("kernel.cpp")
FLAGS = ("-O3", "-march=native", "-std=c++17", "-shared", "-fPIC", "-pthread")
N_INDIVIDUALS = 500
N_TURNS = 60

Costs = tuple[np.ndarray, np.ndarray]


@bench
def kernel(setting: Setting) -> Iterator[Metric]:
    """Projection, visibility, colour and trimming of 1,000 points in two photos."""
    if shutil.which("g++") is None:
        print("kernel: left out, because there is no g++ to build the C++ loop with.")
        return
    with tempfile.TemporaryDirectory() as folder:
        plain = _built(Path(folder))
        for name, with_exposure in (("kernel", False), ("kernel.exposure", True)):
            yield from _compared(name, _arguments(with_exposure), plain)


def _compared(
    name: str, arguments: dict[str, Any], plain: Callable[[dict[str, Any], int], Costs]
) -> Iterator[Metric]:
    n_threads = nb.get_num_threads()
    n_pairs = N_INDIVIDUALS * arguments["points"].shape[1]
    own_times: dict[int, float] = {}
    plain_times: dict[int, float] = {}
    for threads in (1, 2) if n_threads >= 2 else (1,):
        nb.set_num_threads(threads)
        own, own_times[threads], other, plain_times[threads] = _raced(
            lambda: population_costs(**arguments)[:2],
            lambda threads=threads: plain(arguments, threads),
        )
        if threads == 1:
            yield from _agreement(name, own, other)
        per_point = 1e9 / n_pairs
        yield Metric(
            f"{name}.ratio_{threads}_threads" if threads > 1 else f"{name}.ratio",
            own_times[threads] / plain_times[threads],
            "x C++",
            "lower",
            1.2 if threads == 1 else None,
            0.3,
            f"{own_times[threads] * per_point:.1f} against "
            f"{plain_times[threads] * per_point:.1f} ns a point and photo pair",
        )
    nb.set_num_threads(n_threads)
    if n_threads >= 2:
        own_gain = own_times[1] / own_times[2]
        plain_gain = plain_times[1] / plain_times[2]
        yield Metric(
            f"{name}.scaling",
            own_gain / plain_gain,
            "of C++",
            "higher",
            0.9,
            0.3,
            f"two threads: {own_gain:.2f} times as fast, C++ {plain_gain:.2f}",
        )


def _raced(
    own: Callable[[], Costs], other: Callable[[], Costs]
) -> tuple[Costs, float, Costs, float]:
    """Results and best times, turn about, so that both meet the same machine."""
    own_best, other_best = np.inf, np.inf
    own_result, other_result = own(), other()
    for _ in range(N_TURNS):
        began = time.perf_counter()
        own_result = own()
        between = time.perf_counter()
        other_result = other()
        ended = time.perf_counter()
        own_best = min(own_best, between - began)
        other_best = min(other_best, ended - between)
    return own_result, own_best, other_result, other_best


def _agreement(name: str, own: Costs, other: Costs) -> Iterator[Metric]:
    """Both order float32 sums their own way: equal to rounding, not to the bit."""
    finite = np.isfinite(own[0]) & np.isfinite(other[0])
    assert finite.any()
    apart = np.abs(own[0] - other[0])[finite] / own[0][finite]
    yield Metric(
        f"{name}.costs_apart",
        float(apart.max()),
        "relative",
        "lower",
        # A point on the border of visibility, one of 1,000, may fall either way.
        2e-3,
        10.0,
        f"points seen differ by {np.abs(own[1] - other[1]).max()} at most",
    )


def _arguments(with_exposure: bool) -> dict[str, Any]:
    """What the search hands to the kernel for a population, by parameter name."""
    scene = world("clean", 0)
    config = ConsistencyConfig(exposure=with_exposure, max_side_px=1 << 30)
    samples = sample_surface(scene.mesh, 1000, 0)
    cost = PhotoConsistency(samples, scene.photos, config)
    gene_map = GeneMap(scene.rough_cameras, scene.mesh.centroid)
    genes = gene_map.first_population(N_INDIVIDUALS, np.random.default_rng(0))
    caught: dict[str, Any] = {}
    signature = inspect.signature(population_costs.py_func)

    def catch(*args: Any) -> tuple[np.ndarray, ...]:
        caught.update(signature.bind(*args).arguments)
        return population_costs(*args)

    with mock.patch.object(photo_consistency, "population_costs", catch):
        cost.costs(genes, gene_map)
    # Only with exposure is the spread of the colours known.
    caught["reference_spread"] = 500.0 if with_exposure else 0.0
    return caught


def _built(folder: Path) -> Callable[[dict[str, Any], int], Costs]:
    """The C++ loop, compiled, as a function of the kernel's arguments and threads."""
    library = folder / "kernel.so"
    subprocess.run(["g++", *FLAGS, str(SOURCE), "-o", str(library)], check=True)
    function = ctypes.CDLL(str(library)).population_costs
    function.restype = None

    def run(arguments: dict[str, Any], n_threads: int) -> Costs:
        n_individuals = len(arguments["projections"])
        costs = np.zeros(n_individuals)
        kept = np.zeros(n_individuals, dtype=np.int64)
        arrays = [
            np.ascontiguousarray(arguments[name])
            for name in (
                *("points", "projections", "centers", "allowed", "pixels", "layouts"),
            )
        ]
        function(
            *(array.ctypes.data_as(ctypes.c_void_p) for array in arrays),
            ctypes.c_int64(arguments["points"].shape[1]),
            ctypes.c_int64(n_individuals),
            ctypes.c_double(arguments["min_cosine"]),
            ctypes.c_double(arguments["low_share"]),
            ctypes.c_double(arguments["high_share"]),
            ctypes.c_int(arguments["with_exposure"]),
            ctypes.c_double(arguments["reference_spread"]),
            ctypes.c_int64(arguments["min_samples"]),
            ctypes.c_int64(n_threads),
            costs.ctypes.data_as(ctypes.c_void_p),
            kept.ctypes.data_as(ctypes.c_void_p),
        )
        return costs, kept

    return run
