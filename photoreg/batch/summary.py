"""What came of a collection: a table, and the triage page, the worst first."""

import csv
import dataclasses
import importlib.metadata
import io
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from photoreg.batch.mended import MENDED
from photoreg.batch.record import ObjectRecord
from photoreg.batch.run import AFTER, BEFORE, CAMERAS, LOG, MODEL, REPORT
from photoreg.formats.mark import COMMENT
from photoreg.formats.models.registry import TEXTURED_FORMATS
from photoreg.formats.writing import check_outputs, write_files
from photoreg.project.result import ProjectResult
from photoreg.registration.verdict import Grade
from photoreg.report.templates import rendered
from photoreg.words import in_words, percent

SUMMARY, PAGE = "summary.csv", "index.html"

Status = Literal["done", "mended", "failed", "lost", "refused", "not run"]

STATUS_WORDS = {
    "failed": "failed",
    "refused": "refused",
    "lost": "attempts lost",
    "not run": "not run yet",
    "mended": "mended by hand",
    "done": "no verdict",
}
"""What stands in the place of a verdict where there is none."""

ORDER = (
    "failed",
    "refused",
    "lost",
    "unconvincing",
    "done",
    "plausible",
    "mended",
    "convincing",
    "not run",
)
"""Verdicts, and states without one, the worst first."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SummaryRow:
    """What is said about an object."""

    name: str
    status: Status
    verdict: Grade | None = None
    sentence: str = ""
    """The verdict in words, or what went wrong."""
    expected_error_px: float | None = None
    start_cost: float | None = None
    cost: float | None = None
    photos: int | None = None
    seen_share: float | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    total_s: float | None = None
    cameras: str = ""
    """Path of the cameras from the folder of all results; so on."""
    model: str = ""
    report: str = ""
    has_log: bool = False
    has_thumbnails: bool = False
    can_be_opened: bool = False
    """Whether the app knows the object's files."""

    @property
    def rank(self) -> tuple[int, float, str]:
        """Where it stands, the worst first."""
        order = ORDER.index(self.key)
        return order, -(self.expected_error_px or 0.0), self.name

    @property
    def key(self) -> Status | Grade:
        """Its verdict, or its state without one: one of `ORDER`."""
        return self.verdict or self.status

    @property
    def facts(self) -> list[str]:
        """Figures in words, as far as they are known."""
        facts = []
        if self.photos is not None:
            facts.append(f"{self.photos} photo{'s' * (self.photos != 1)}")
        if self.seen_share is not None:
            facts.append(f"{percent(self.seen_share)} of the surface seen")
        if self.total_s is not None:
            facts.append(in_words(self.total_s))
        return facts

    @property
    def remarks(self) -> list[str]:
        """Warnings that its sentence does not say already, and notes."""
        warnings = [text for text in self.warnings if text != self.sentence]
        return [*warnings, *self.notes]

    @property
    def links(self) -> dict[str, str]:
        """Word to path, which is empty where there is no such file."""
        return {
            "report": self.report,
            "model": self.model,
            "cameras": self.cameras,
            "log": f"{self.name}/{LOG}" if self.has_log else "",
        }


def row_of(
    name: str, record: ObjectRecord | None, mended: ProjectResult | None = None
) -> SummaryRow:
    """The row of an object that has a record, or that a person has mended.

    Args:
        name: Of the object.
        record: Of the object, as far as there is one.
        mended: What a person made of it; None: nothing.
    """
    figures: dict[str, Any] = {} if record is None else dict(record.figures)
    outputs = () if record is None else record.outputs
    models = [file for file in outputs if Path(file).stem == MODEL]
    has_failed = record is None or record.ending == "failed"
    row = SummaryRow(
        name=name,
        status="failed" if has_failed else "done",
        verdict=figures.get("verdict"),
        sentence=figures.get("sentence", ""),
        expected_error_px=figures.get("expected_error_px"),
        start_cost=figures.get("start_cost"),
        cost=figures.get("cost"),
        photos=figures.get("photos"),
        seen_share=figures.get("seen_share"),
        warnings=tuple(figures.get("warnings", ())),
        notes=tuple(figures.get("notes", ())),
        total_s=figures.get("total_s"),
        cameras=f"{name}/{CAMERAS}" if CAMERAS in outputs else "",
        model=f"{name}/{sorted(models, key=_is_picture)[0]}" if models else "",
        report=f"{name}/{REPORT}" if REPORT in outputs else "",
        has_log=has_failed,
        has_thumbnails=AFTER in outputs,
        can_be_opened=record is not None,
    )
    if mended is None:
        return row
    return dataclasses.replace(
        row,
        status="mended",
        verdict=mended.grade,
        sentence=mended.sentence or "Its cameras were placed by hand.",
        expected_error_px=mended.expected_error_px,
        start_cost=None,
        cost=None,
        warnings=(),
        photos=len(mended.cameras),
        cameras=f"{name}/{MENDED}",
        has_log=False,
    )


def _is_picture(name: str) -> bool:
    return Path(name).suffix not in TEXTURED_FORMATS


COLUMNS = (
    "object",
    "status",
    "verdict",
    "sentence",
    "expected_error_px",
    "start_cost",
    "cost",
    "photos",
    "seen_share",
    "seconds",
    "warnings",
    "notes",
    "cameras",
    "model",
    "report",
    COMMENT,
)


def write_summary(out: Path, rows: Sequence[SummaryRow]) -> tuple[Path, Path]:
    """Writes table and triage page; returns their paths.

    Raises:
        OutputError: if they cannot be written, or other files have their names.
    """
    table, page = out / SUMMARY, out / PAGE
    write_files({table: csv_of(rows), page: page_of(out, rows)})
    return table, page


def check_summary(out: Path) -> None:
    """Checks that it can be written, before the long work that it sums up.

    Raises:
        OutputError: if it cannot, or other files have its names.
    """
    check_outputs([out / SUMMARY, out / PAGE])


def csv_of(rows: Sequence[SummaryRow]) -> str:
    """The table, a row an object in the collection's order."""
    text, version = io.StringIO(), importlib.metadata.version("photoreg")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        cells = (
            row.name,
            row.status,
            row.verdict,
            row.sentence,
            row.expected_error_px,
            row.start_cost,
            row.cost,
            row.photos,
            row.seen_share,
            row.total_s,
            " ".join(row.warnings),
            " ".join(row.notes),
            row.cameras,
            row.model,
            row.report,
            version,
        )
        writer.writerow(["" if cell is None else cell for cell in cells])
    return text.getvalue()


def page_of(out: Path, rows: Sequence[SummaryRow]) -> str:
    """The triage page, which opens from the disk and loads nothing from elsewhere."""
    counts: dict[str, int] = dict.fromkeys(ORDER, 0)
    for row in rows:
        counts[row.key] += 1
    return rendered(
        "triage.html",
        mark=COMMENT,
        title=out.name,
        folder=out,
        rows=sorted(rows, key=lambda row: row.rank),
        counts=counts,
        words=STATUS_WORDS,
        pictures={"before": BEFORE, "after": AFTER},
        command=lambda row: shlex.join(["photoreg", "app", str(out / row.name)]),
    )
