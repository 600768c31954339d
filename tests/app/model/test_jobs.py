"""What is told of how long a job will take."""

import dataclasses

import pytest

from app.model.state import Job


def test_time_left_goes_on_as_until_now_and_is_not_told_too_early():
    job = Job("Reading", began_s=100.0)
    assert job.seconds_left(200.0) is None, "nothing is done yet"
    job = dataclasses.replace(job, title="Making", fraction=0.25)
    assert job.seconds_left(101.0) is None, "it has just begun"
    assert job.seconds_left(112.0) == pytest.approx(36.0)
    assert dataclasses.replace(job, fraction=1.0).seconds_left(112.0) is None
