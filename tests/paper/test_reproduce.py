"""The paper's experiment in small: every table is there, and says what was run."""

import dataclasses
import json
import re
import sys

import numpy as np
import pytest

from photoreg.errors import InputError, OutputError
from photoreg.geometry.projection_error import projection_error
from photoreg.paper.experiment import MethodRun, manual_start, methods
from photoreg.paper.report import TABLES, correlations
from photoreg.paper.reproduce import Reproduced, ReproductionStep, reproduce
from photoreg.parameters.gene_box import GeneBox
from photoreg.parameters.genes import GeneMap
from photoreg.polish.config import PolishConfig
from photoreg.registration.config import RegistrationConfig
from tests.scenes import small_scene


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """One run of everything, with populations far too small to find anything."""
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    n_levels = len(PolishConfig().points)
    short = dataclasses.replace(
        PolishConfig(),
        points=(300,) * n_levels,
        rounds=(1,) * n_levels,
        iterations=1,
        rim_points=100,
    )
    events = list(reproduce(folder, 1, 0, (6, 8), 2, scene=small_scene(), polish=short))
    return folder, events


def test_reproduce_tells_of_every_run_and_ends_with_the_files(reproduced):
    folder, events = reproduced
    *steps, last = events
    assert isinstance(last, Reproduced)
    assert all(isinstance(step, ReproductionStep) for step in steps)
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert len(steps) == 1 + len(last.runs)
    assert all(path.parent == folder and path.stat().st_size > 0 for path in last.paths)


def test_reproduce_runs_every_method_once_and_shares_starts(reproduced):
    _, events = reproduced
    runs = events[-1].runs
    rows = methods((6, 8), 2)
    assert [(run.table, run.method) for run in runs] == [
        (row.table, row.name) for row in rows
    ]
    assert {run.start_px for run in runs} == {runs[0].start_px}
    assert {run.table for run in runs} == set(TABLES)


def test_results_hold_every_run_and_the_rows_are_their_means(reproduced):
    folder, events = reproduced
    results = json.loads((folder / "results.json").read_text())
    assert len(results["runs"]) == len(events[-1].runs)
    for key, rows in results["tables"].items():
        for row in rows:
            errors = [
                run["end_px"]
                for run in results["runs"]
                if (run["table"], run["method"]) == (key, row["method"])
            ]
            assert row["mean_px"] == pytest.approx(np.mean(errors))
            assert row["n_runs"] == len(errors)


def test_the_page_needs_no_other_file(reproduced):
    folder, _ = reproduced
    page = (folder / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]+)"', page)
    outside = [s for s in sources if not s.startswith(("data:", "#"))]
    assert outside == []
    assert page.count("<svg") == 2
    assert page.count("<table") == len(TABLES) + 1


def test_the_markdown_names_only_files_that_exist(reproduced):
    folder, _ = reproduced
    text = (folder / "report.md").read_text()
    names = re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    assert len(names) == 4
    assert all((folder / name).is_file() for name in names)


def test_the_papers_figures_stand_beside_its_populations():
    said = {row.name: row.paper for row in methods((500, 1000), 100)}
    assert "6.54 px" in said["500 individuals"]
    assert "5.63 px" in said["1000 individuals"]


def test_compared_searches_spend_the_same_evaluations():
    genetic = {
        row.name: row.config.genetic
        for row in methods((500, 1000), 100)
        if isinstance(row.config, RegistrationConfig) and row.table == "genetic"
    }
    spent = {
        name: config.restarts * config.generations * config.n_children
        for name, config in genetic.items()
    }
    assert len(set(spent.values())) == 1, spent


@pytest.mark.parametrize("seed", range(4))
def test_manual_starts_are_as_far_off_as_asked_with_the_truth_in_the_papers_box(seed):
    scene = small_scene()
    manual = manual_start(scene.true_mesh, scene.cameras, (5.0, 6.0), seed)
    error_px = projection_error(scene.true_mesh, scene.cameras, manual).mean
    assert 4.9 < error_px < 6.1, f"{error_px:.2f} px"
    box = GeneMap(manual, scene.mesh.centroid, GeneBox(), "pinhole", "camera")
    genes = box.to_genes(scene.cameras)
    assert np.abs(genes).max() <= 1.0, f"{np.abs(genes).max():.3f}"


def test_manual_starts_wider_than_the_papers_box_are_refused():
    scene = small_scene()
    with pytest.raises(InputError, match=r"100\.0 px off"):
        manual_start(scene.true_mesh, scene.cameras, (100.0, 100.0))


def test_correlations_are_of_the_ends_and_of_the_logarithms_of_the_ways():
    def run(cost, end_px, path):
        return MethodRun(
            table="population",
            method="m",
            run=1,
            start_px=20.0,
            end_px=end_px,
            cost=cost,
            seconds=1.0,
            evaluations=10,
            path=path,
        )

    runs = [
        run(1.0, 2.0, ((10.0, 100.0), (1.0, 10.0))),
        run(2.0, 4.0, ((100.0, 1000.0),)),
        run(3.0, 6.0, ((1000.0, 1e4),)),
    ]
    assert correlations(runs) == pytest.approx((1.0, 1.0))


def test_without_matplotlib_reproduce_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"pip install 'photoreg\[report\]'"):
        reproduce(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_found_before_the_first_run(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Cannot write the report"):
        reproduce(tmp_path / "file" / "out")


def test_no_runs_are_refused(tmp_path):
    with pytest.raises(InputError, match="runs is 0"):
        reproduce(tmp_path, n_runs=0)
