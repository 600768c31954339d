"""What makes the page be painted at once, and what waits for a run's next picture."""

import dataclasses

import pytest

from app.model.pictures import Picture
from app.model.run import KeptSearch, Run
from app.model.state import State
from app.page.server import is_passing

RUNNING = State(run=Run(status="running", generation=3))


def test_what_a_run_tells_by_itself_is_passing():
    further = dataclasses.replace(RUNNING.run, generation=4)
    for change in (
        {"run": further},
        {"kept_search": KeptSearch(1, 4, b"")},
        {"run": further, "agreement": None},
        {"run": further, "drawn": Picture(b"", None), "surface_glb": b""},
    ):
        assert is_passing(RUNNING, dataclasses.replace(RUNNING, **change)), change


@pytest.mark.parametrize(
    "change",
    [
        {"run": dataclasses.replace(RUNNING.run, status="paused")},
        {"run": dataclasses.replace(RUNNING.run, status="review")},
        {"overlay_style": "edges"},
        {"run": dataclasses.replace(RUNNING.run, generation=4), "selected": 1},
    ],
)
def test_what_a_person_does_or_waits_for_is_painted_at_once(change):
    assert not is_passing(RUNNING, dataclasses.replace(RUNNING, **change))
