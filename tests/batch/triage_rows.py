"""Rows of a summary in all states, with pictures that are drawn here."""

from pathlib import Path

import cv2
import numpy as np

from photoreg.batch.run import AFTER, BEFORE
from photoreg.batch.summary import SummaryRow, write_summary

HOSTILE = '<img src=x onerror="window.hacked=1">\'"&$(x)`'

ROWS = (
    SummaryRow(
        name="amphora 12",
        status="done",
        verdict="convincing",
        sentence="Convincing: the photos agree on the surface, and the outlines fit.",
        expected_error_px=0.06,
        photos=4,
        seen_share=0.71,
        total_s=42.0,
        cameras="amphora 12/cameras.json",
        model="amphora 12/model.glb",
        report="amphora 12/report.html",
        has_thumbnails=True,
        can_be_opened=True,
    ),
    SummaryRow(
        name="bowl 3",
        status="done",
        verdict="plausible",
        sentence="Plausible: the outlines fit, but the colours of left.jpg differ from "
        "the other photos', as they would under different light.",
        expected_error_px=0.8,
        photos=2,
        seen_share=0.34,
        total_s=30.0,
        cameras="bowl 3/cameras.json",
        report="bowl 3/report.html",
        has_thumbnails=True,
        can_be_opened=True,
    ),
    SummaryRow(
        name="cup 100",
        status="done",
        verdict="unconvincing",
        sentence="Unconvincing: in right.jpg neither the colours on the surface nor the "
        "outline fit, so the cameras are probably wrong.",
        expected_error_px=12.5,
        photos=2,
        seen_share=0.3,
        total_s=93.0,
        warnings=("The photos share little of the surface.",),
        cameras="cup 100/cameras.json",
        report="cup 100/report.html",
        has_thumbnails=True,
        can_be_opened=True,
    ),
    SummaryRow(
        name="cup 20",
        status="mended",
        verdict="convincing",
        sentence="Convincing: the photos agree on the surface, and the outlines fit.",
        expected_error_px=0.2,
        photos=2,
        total_s=25.0,
        cameras="cup 20/mended.json",
        has_thumbnails=True,
        can_be_opened=True,
    ),
    SummaryRow(
        name="dish",
        status="failed",
        sentence="left.jpg could not be read as a photo: it does not begin as one.",
        has_log=True,
        can_be_opened=True,
    ),
    SummaryRow(
        name="ewer" + HOSTILE,
        status="refused",
        sentence=f"There are 2 meshes in {HOSTILE}.",
        notes=(HOSTILE,),
        can_be_opened=True,
    ),
)


def make_results(folder: Path, rows: tuple[SummaryRow, ...] = ROWS) -> Path:
    """The page of these rows, with thumbnails; returns its path."""
    generator = np.random.default_rng(3)
    folder.mkdir(parents=True)
    for row in rows:
        if row.has_thumbnails:
            (folder / row.name).mkdir()
            colour = generator.integers(60, 220, 3)
            picture = np.full((360, 480, 3), colour, np.uint8)
            cv2.circle(picture, (240, 180), 120, (200, 200, 210), -1)
            for name, at in ((BEFORE, 262), (AFTER, 242)):
                drawn = picture.copy()
                cv2.circle(drawn, (at, 184), 120, (90, 110, 160), 8)
                cv2.imwrite(str(folder / row.name / name), drawn)
    return write_summary(folder, rows)[1]
