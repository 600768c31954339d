"""`photoreg batch`: a collection of objects, on this machine's cores or on a cluster."""

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import rich.progress
import tyro

from photoreg.batch.batch import BatchConfig, BatchFinished, BatchProgress, run_batch
from photoreg.batch.collection import read_collection
from photoreg.batch.settings import ModelKind, ObjectSettings
from photoreg.batch.summary import PAGE, SUMMARY, SummaryRow, check_summary
from photoreg.cli.console import TOLD, log, progress_bar
from photoreg.cli.stopping import asked_to_stop
from photoreg.errors import OutputError
from photoreg.formats.models.encode_texture import PictureKind
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.texture.config import TextureConfig
from photoreg.words import in_words

MOST_NAMED = 10
"""How many failed objects are named; the page lists all."""


def make_batch_command(preset: RegistrationConfig) -> Callable[..., int]:
    """The command, with the defaults of a preset."""

    def batch_command(
        collection: Annotated[
            Path, tyro.conf.Positional, tyro.conf.arg(metavar="COLLECTION")
        ],
        /,
        *,
        out: Path,
        preset: PresetName = "default",
        model: ModelKind = "glb",
        picture: PictureKind = "png",
        report: bool = True,
        batch: Annotated[BatchConfig, tyro.conf.arg(name="")] = BatchConfig(),
        config: Annotated[RegistrationConfig, tyro.conf.arg(name="")] = preset,
        texture: TextureConfig = TextureConfig(),
    ) -> int:
        """Refine, texture and report many objects, each as `photoreg refine` would.

        The same command continues where it stopped: what is done already, with the same
        content and settings, is not done again. Ctrl-C ends it. Needs the extra `cluster`.

        Args:
            collection: A folder with one folder for each object, in which mesh, photos and
                rough cameras are recognised by their suffixes; or a table (.csv) with columns
                object, mesh, photos (separated by semicolons, or a folder), cameras, and
                optionally preset, seed, distortion, lock, lock_focal, ..., share_focal,
                cropped.
            out: Folder for the results: one folder for each object, summary.csv, and
                index.html, which lists what needs a look.
            preset: What the options of the refinement default to; see `photoreg refine`.
            model: Kind of the textured model; none: no texture is made.
            picture: The texture as PNG, or as JPEG, which is several times smaller.
            report: Write a report of each refinement.
            batch: How the batch runs.
            config: How to refine.
            texture: How the textures are made.
        """
        del preset  # `config` began as it.
        settings = ObjectSettings(
            config=config, model=model, picture=picture, texture=texture, report=report
        )
        things = read_collection(collection, settings)
        _check_apart(collection, out)
        if out.is_dir():
            check_summary(out)
        with (
            progress_bar((rich.progress.MofNCompleteColumn(), TOLD)) as bar,
            asked_to_stop() as stop,
        ):
            task = bar.add_task("looking for what is done", total=len(things), told="")
            told_of_dashboard = False
            last = None
            with contextlib.closing(run_batch(things, out, batch)) as events:
                for event in events:
                    if isinstance(event, BatchFinished):
                        return _tell(event)
                    last = event
                    if event.dashboard and not told_of_dashboard:
                        log.print(f"Dask's dashboard: {event.dashboard}")
                        told_of_dashboard = True
                    _update(bar, task, event)
                    if stop.is_set():
                        break
        done = 0 if last is None else last.done
        log.print(
            f"Stopped; {done} done. {out / PAGE} shows what is there; the same command "
            "goes on."
        )
        return 1

    return batch_command


def _check_apart(collection: Path, out: Path) -> None:
    """Refuses results among the objects: they would be mistaken for objects."""
    inputs = Path(os.path.realpath(collection))
    folder = inputs if inputs.is_dir() else inputs.parent
    results = Path(os.path.realpath(out))
    if results == folder or (inputs.is_dir() and results.is_relative_to(inputs)):
        raise OutputError(
            f"The results cannot go to {out}, which is where the objects are. Name a "
            "folder elsewhere."
        )


def _update(
    bar: rich.progress.Progress, task: rich.progress.TaskID, now: BatchProgress
) -> None:
    words = [] if now.per_hour is None else [f"{now.per_hour:,.0f} an hour"]
    if now.time_left_s is not None:
        words.append(f"{in_words(now.time_left_s)} left")
    words.append(f"{now.failed} failed")
    if now.lost:
        words.append(f"{now.lost} attempts lost")
    bar.update(
        task,
        completed=now.done + now.known + now.failed,
        description=f"{now.workers} workers" if now.workers else "waiting for workers",
        told=" · ".join(words),
    )


def _tell(event: BatchFinished) -> int:
    """Reports the outcome; returns the exit status."""
    now = event.progress
    by_verdict: dict[str, int] = {}
    for row in event.rows:
        key = row.verdict or row.status
        by_verdict[key] = by_verdict.get(key, 0) + 1
    counts = ", ".join(f"{n} {key}" for key, n in sorted(by_verdict.items()))
    log.print(
        f"{now.total} objects: {counts}. {now.done} done now in "
        f"{in_words(now.elapsed_s)}, {now.known} before.",
        markup=False,
    )
    if now.lost:
        what = "attempt was" if now.lost == 1 else "attempts were"
        log.print(f"{now.lost} {what} lost with their workers and repeated.")
    wrong = [r for r in event.rows if r.status in ("failed", "lost", "refused")]
    for row in wrong[:MOST_NAMED]:
        log.print(_in_words(row), markup=False)
    if len(wrong) > MOST_NAMED:
        log.print(f"And {len(wrong) - MOST_NAMED} more, see {SUMMARY}.", markup=False)
    log.print(f"What needs a look: {event.page}", markup=False)
    return 1 if wrong else 0


def _in_words(row: SummaryRow) -> str:
    where = (
        f" Its log is {row.name}/log.txt; --retry tries again." if row.has_log else ""
    )
    return f"{row.name} ({row.status}): {row.sentence}{where}"
