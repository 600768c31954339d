"""The bench's own rules: when a figure is reached, when it regressed, what a gate says."""

import json

import numpy as np
import pytest

from tests.bench import __main__ as bench_main
from tests.bench import metrics
from tests.bench.metrics import BENCHES, Metric, spread


@pytest.fixture
def baseline_path(tmp_path, monkeypatch):
    path = tmp_path / "baseline.json"
    monkeypatch.setattr(metrics, "BASELINE", path)
    return path


@pytest.mark.parametrize(
    ("better", "value", "reached"),
    [
        ("lower", 0.99, True),
        ("lower", 1.0, True),
        ("lower", 1.01, False),
        ("higher", 0.99, False),
        ("higher", 1.0, True),
        ("higher", 1.01, True),
        ("lower", float("nan"), False),
        ("higher", float("nan"), False),
    ],
)
def test_a_bar_is_reached_at_the_bar_and_on_the_better_side(better, value, reached):
    assert Metric("a", value, "px", better, bar=1.0).reached is reached


def test_a_figure_without_a_bar_is_neither_reached_nor_missed():
    assert Metric("a", 1.0, "px", "lower").reached is None


@pytest.mark.parametrize(
    ("better", "value", "regressed"),
    [
        ("lower", 2.49, False),
        ("lower", 2.51, True),
        ("lower", 0.1, False),
        ("higher", 1.51, False),
        ("higher", 1.49, True),
        ("higher", 9.0, False),
        ("lower", float("nan"), True),
        ("higher", float("nan"), True),
    ],
)
def test_a_figure_regressed_when_worse_by_more_than_its_tolerance(
    better, value, regressed
):
    metric = Metric("a", value, "px", better, tolerance=0.25)
    assert metric.regressed(2.0) is regressed


def test_a_negative_baseline_keeps_its_slack_on_the_worse_side():
    assert not Metric("a", -1.9, "", "lower", tolerance=0.1).regressed(-2.0)
    assert Metric("a", -1.7, "", "lower", tolerance=0.1).regressed(-2.0)


def test_spread_gives_mean_deviation_and_worst_with_their_bars():
    mean, std, worst = spread("e", [1.0, 2.0, 6.0], "px", 3.0, 5.0)
    assert (mean.name, mean.value, mean.reached) == ("e.mean", 3.0, True)
    assert (std.name, std.reached) == ("e.std", None)
    assert std.value == pytest.approx(np.std([1.0, 2.0, 6.0]))
    assert (worst.name, worst.value, worst.reached) == ("e.worst", 6.0, False)


def test_saving_a_baseline_keeps_the_figures_of_other_benches(baseline_path):
    metrics.save_baseline(
        [Metric("a", 1.0, "", "lower"), Metric("b", 2.0, "", "lower")]
    )
    metrics.save_baseline([Metric("b", 3.0, "", "lower")])
    assert metrics.load_baseline() == {"a": 1.0, "b": 3.0}


@pytest.mark.parametrize(
    ("value", "gate", "status"), [(1.2, True, 0), (1.3, True, 1), (1.3, False, 0)]
)
def test_the_gate_ends_with_status_1_only_on_a_regression(
    baseline_path, monkeypatch, tmp_path, capsys, value, gate, status
):
    baseline_path.write_text(json.dumps({"made_up.error": 1.0}))
    monkeypatch.setitem(
        BENCHES,
        "made_up",
        lambda _: iter([Metric("made_up.error", value, "px", "lower")]),
    )
    out = tmp_path / "figures.json"
    assert bench_main.main(("made_up",), json_path=out, gate=gate) == status
    assert ("Regressed" in capsys.readouterr().out) == (value > 1.25)
    (figure,) = json.loads(out.read_text())["metrics"]
    assert figure["value"] == value


def test_no_bench_begins_after_the_time_is_over(monkeypatch, capsys):
    begun = []

    def slow(name):
        def run(_):
            begun.append(name)
            bench_main.time.sleep(0.05)
            return iter([Metric(f"{name}.error", 1.0, "px", "lower")])

        return run

    for name in ("made_up", "later"):
        monkeypatch.setitem(BENCHES, name, slow(name))
    assert bench_main.main(("made_up", "later"), minutes=1e-4) == 0
    assert begun == ["made_up"]
    assert "later: left out" in capsys.readouterr().out
    bench_main.main(("made_up", "later"), minutes=0.0)
    assert begun == ["made_up", "made_up", "later"]


def test_the_markdown_table_has_a_row_a_figure_and_says_what_was_missed():
    table = bench_main.markdown_table(
        [
            Metric("a.mean", 0.123456, "px", "lower", 0.1, note="n=3"),
            Metric("b", 2.0, "x", "higher"),
        ]
    )
    head, _, first, second = table.splitlines()
    assert head.startswith("| figure | value |")
    assert first == "| a.mean | 0.123 px | ≤ 0.1 | **missed** | n=3 |"
    assert second == "| b | 2 x |  |  |  |"


def test_an_unknown_bench_is_named_with_those_that_exist(capsys):
    assert bench_main.main(("no_such",)) == 2
    said = capsys.readouterr().out
    assert "no_such" in said
    assert all(name in said for name in BENCHES)
