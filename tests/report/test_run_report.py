"""The report of a run as a page."""

import dataclasses

import numpy as np

from photoreg.report.run_report import RunReport, report_html
from tests.scenes import small_scene


def test_places_of_cameras_are_told_whole_and_in_the_scans_unit():
    camera = small_scene().cameras[0]
    center = np.array([431250.123, 5411800.456, -87.25])
    camera = dataclasses.replace(camera, t_cam_world=-camera.R_cam_world @ center)
    run = RunReport(
        title="Run 1",
        subtitle="",
        outcome="",
        warnings=(),
        comparisons=(),
        left="start",
        elapsed_s=1.0,
        generations=1,
        evaluations=1,
        photo_names=["a.jpg"],
        start=[camera],
        cameras=[camera],
    )
    place = "stands at 431250.123, 5411800.456, -87.25"
    assert report_html(run).count(f"{place}</td>") == 2
    assert report_html(dataclasses.replace(run, unit="mm")).count(f"{place} mm<") == 2
