"""One object from its files to its folder: the work of a task, wherever it runs."""

import contextlib
import dataclasses
import faulthandler
import os
import re
import secrets
import shutil
import socket
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import cv2
import numba

from photoreg.batch.collection import FileState, Inputs, told_from
from photoreg.batch.record import (
    RECORD,
    ObjectRecord,
    hashed,
    load_record,
    save_record,
)
from photoreg.batch.settings import ObjectSettings, fingerprint
from photoreg.checks import inputs_read, noting_inputs
from photoreg.errors import OutputError, PhotoregError
from photoreg.formats.cameras.cameras_json import save_cameras
from photoreg.formats.mark import COMMENT, is_marked, marked_picture
from photoreg.formats.models.registry import save_textured
from photoreg.formats.writing import check_outputs, make_folder, write_files
from photoreg.imaging.encoding import encode_jpeg
from photoreg.overlay.disagreement_map import mean_disagreement
from photoreg.overlay.pictures import LiveOverlay, compose
from photoreg.parameters.freedom import Freedom
from photoreg.registration.attempts import refine_in_attempts
from photoreg.registration.events import Finished, Progress
from photoreg.registration.scene_files import LoadedScene, cropped_by_exif, load_scene
from photoreg.report.comparison import (
    JPEG_QUALITY,
    PICTURE_SIDE_PX,
    aligned_pair,
    draw_comparison,
)
from photoreg.report.cost_curve import CostCurve, CurvePoint
from photoreg.report.run_report import RunReport, report_html
from photoreg.sources import read_regular
from photoreg.texture.bake import TexturedMesh, baking

CAMERAS, MODEL, REPORT, LOG = "cameras.json", "model", "report.html", "log.txt"
BEFORE, AFTER = "before.jpg", "after.jpg"
THUMBNAIL_PX = 480

SCRATCH = ".photoreg-"
"""Folders in which results lie until they are whole begin so."""

_SCRATCH_NAME = re.compile(re.escape(SCRATCH) + r"\d+-\d+-.+-\d+-[0-9a-f]{6}")
"""Their whole names: object, attempt, host, process, and what makes them unique."""

MAX_THREADS: int = numba.get_num_threads()
"""Of numba, in this process."""

_one_at_a_time = threading.Lock()
"""Only one thread may call numba's parallel functions."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ObjectTask:
    """All that a worker needs to know of an object."""

    name: str
    base: Path
    """The folder that its files' paths are relative to."""
    inputs: Inputs
    files: Mapping[str, FileState]
    """All files that it may consist of, as they were when the task was made."""
    settings: ObjectSettings
    out: Path
    """The folder of all results."""
    scratch: str
    """What the folder is called, but for its end, in which the results become whole."""
    threads: int
    """Of the engine."""
    limit_s: float | None = None
    """After so long the worker's process ends itself."""
    contents: Mapping[str, bytes] | None = None
    """The files' contents, by path from ``base``; None: the worker reads the files."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of an attempt."""

    status: Literal["done", "failed", "out of memory"]
    sentence: str = ""
    """What is wrong, for people; empty where it is done."""
    log: str = ""
    """The same for those who mend it."""
    figures: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    results: Mapping[str, bytes] | None = None
    """Files and record, of a worker that was sent the contents."""


def run_task(task: ObjectTask) -> Outcome:
    """Makes an object's results; what the object itself does wrong is an outcome."""
    with _one_at_a_time:
        numba.set_num_threads(min(task.threads, MAX_THREADS))
        cv2.setNumThreads(task.threads)
        try:
            return _run(task)
        except MemoryError:
            return Outcome(
                status="out of memory", sentence="There was too little memory."
            )
        except PhotoregError as error:
            return Outcome(status="failed", sentence=str(error), log=_trace())
        except Exception as error:  # noqa: BLE001 - it is the object's, and is kept.
            words = f"It failed unexpectedly ({type(error).__name__}: {error})."
            return Outcome(status="failed", sentence=words, log=_trace())


def _trace() -> str:
    return f"On {socket.gethostname()}:\n{traceback.format_exc()}"


def _run(task: ObjectTask) -> Outcome:
    if task.contents is not None:
        with tempfile.TemporaryDirectory(prefix="photoreg-") as folder:
            return _run_shipped(task, Path(folder), task.contents)
    with _scratch_folder(task.out, task.scratch) as scratch:
        with _limited(task.limit_s, scratch / "hang.txt"):
            record = make_results(task, task.base, scratch)
        place_results(scratch, task.out / task.name, record)
    return Outcome(status="done", figures=record.figures)


def _run_shipped(
    task: ObjectTask, folder: Path, contents: Mapping[str, bytes]
) -> Outcome:
    """The same of contents that came with the task; the results go back with it."""
    base, results = folder / "base", folder / "results"
    results.mkdir()
    for name, content in contents.items():
        path = base / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        _, time_ns = task.files[name]
        os.utime(path, ns=(time_ns, time_ns))
    with _limited(task.limit_s, None):
        record = make_results(task, base, results)
    record = dataclasses.replace(record, base=str(task.base))
    save_record(results, record)
    files = {path.name: path for path in results.iterdir()}
    return Outcome(
        status="done",
        figures=record.figures,
        results={name: read_regular(path) for name, path in files.items()},
    )


def sweep(out: Path, beginning: str = SCRATCH) -> None:
    """Removes what attempts left that were cut short; folders of other names stay."""
    for entry in os.scandir(out):
        is_scratch = _SCRATCH_NAME.fullmatch(entry.name) is not None
        is_scratch &= entry.name.startswith(beginning)
        if is_scratch and entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.path, ignore_errors=True)


@contextlib.contextmanager
def _scratch_folder(out: Path, name: str) -> Iterator[Path]:
    folder = out / f"{name}-{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(3)}"
    try:
        folder.mkdir()
    except OSError as error:
        raise OutputError(
            f"{out} cannot be written from {socket.gethostname()}: "
            f"{error.strerror or error}. Share it with the workers, or use --ship."
        ) from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _limited(limit_s: float | None, trace: Path | None) -> Iterator[None]:
    """Ends the process after so long, even where compiled code hangs.

    Args:
        limit_s: After how many seconds; None: never.
        trace: Where to write what the process was doing; None: nowhere.
    """
    if limit_s is None:
        yield
        return
    with Path(os.devnull if trace is None else trace).open("w") as file:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=file)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
    if trace is not None:
        trace.unlink()


def make_results(task: ObjectTask, base: Path, folder: Path) -> ObjectRecord:
    """Refines, textures and reports an object; its record is for `place_results`.

    Args:
        task: The object.
        base: The folder that its files are in here.
        folder: An empty folder for the results.

    Raises:
        PhotoregError: if the object cannot be used, or nothing can be written.
    """
    began = time.perf_counter()
    inputs = Inputs(
        base / told_from(task.base, task.inputs.mesh),
        tuple(base / told_from(task.base, path) for path in task.inputs.photos),
        base / told_from(task.base, task.inputs.cameras),
        task.inputs.has_textures,
    )
    with noting_inputs():
        scene = load_scene(
            inputs.mesh,
            inputs.photos,
            inputs.cameras,
            has_textures=inputs.has_textures,
        )
        read = {told_from(base, path) for path in inputs_read()}
    files = hashed(base, task.files, read)
    figures = _refine_and_write(scene, task.settings, folder, task.name)
    used = {photo.source.path for photo in scene.photos if photo.source is not None}
    return ObjectRecord(
        ending="done",
        settings=fingerprint(task.settings),
        base=str(task.base),
        mesh=told_from(base, inputs.mesh),
        photos=tuple(
            told_from(base, path) for path in inputs.photos if path.absolute() in used
        ),
        cameras=told_from(base, inputs.cameras),
        files=files,
        outputs=tuple(sorted(p.name for p in folder.iterdir() if p.name != "hang.txt")),
        figures={**figures, "total_s": time.perf_counter() - began},
    )


def _refine_and_write(
    scene: LoadedScene, settings: ObjectSettings, folder: Path, name: str
) -> dict[str, Any]:
    """Cameras, model, report and thumbnails; returns what the summary says."""
    mesh, photos = scene.mesh, scene.photos
    names = [photo.name for photo in photos]
    freedom = Freedom.of_photos(
        names,
        lock=settings.lock,
        lock_focal=settings.lock_focal,
        lock_principal_point=settings.lock_principal_point,
        lock_pose=settings.lock_pose,
        lock_distortion=settings.lock_distortion,
        share_focal=settings.share_focal,
        cropped=[*settings.cropped, *cropped_by_exif(photos, settings.cropped)],
    )
    curve, points = CostCurve(), []
    finished = None
    for event in refine_in_attempts(
        mesh, photos, scene.cameras, settings.config, freedom
    ):
        if isinstance(event, Progress):
            points += curve.points(event)
        else:
            finished = event
    assert finished is not None  # The last event of every refinement is its end.
    best = dict(zip(names, finished.cameras, strict=True))
    save_cameras(folder / CAMERAS, scene.file.with_cameras(best))
    figures = _figures(finished, names)
    figures["notes"] = scene.notes
    if settings.model != "none":
        *_, textured = baking(mesh, photos, finished.cameras, settings.texture)
        assert isinstance(textured, TexturedMesh)
        model = folder / f"{MODEL}.{settings.model}"
        save_textured(model, textured, picture=settings.picture)
        figures["seen_share"] = textured.seen_share
    overlay = LiveOverlay(mesh, photos, PICTURE_SIDE_PX)
    _write_thumbnails(folder, overlay, scene, finished)
    if settings.report:
        text = _report(scene, overlay, settings, finished, tuple(points), name)
        write_files({folder / REPORT: text})
    return figures


def _figures(finished: Finished, names: list[str]) -> dict[str, Any]:
    verdict, mesh_error = finished.verdict, finished.mesh_error
    return {
        "verdict": None if verdict is None else verdict.grade,
        "sentence": finished.reason if verdict is None else verdict.sentence,
        "photos": len(names),
        "expected_error_px": finished.expected_error_px,
        "start_cost": finished.start_cost,
        "cost": finished.cost,
        "mesh_error": None if mesh_error is None else dataclasses.asdict(mesh_error),
        "warnings": list(finished.warnings),
        "refine_s": finished.elapsed_s,
    }


def _write_thumbnails(
    folder: Path, overlay: LiveOverlay, scene: LoadedScene, finished: Finished
) -> None:
    """Overlays before and after, of the photo that fits the others worst."""
    pairs = [
        aligned_pair(overlay, finished.cameras, onto)
        for onto in range(len(scene.photos))
    ]
    levels = [mean_disagreement(pair) or 0.0 for pair in pairs]
    worst = max(range(len(pairs)), key=lambda onto: levels[onto])
    drawn = {
        BEFORE: aligned_pair(overlay, scene.cameras, worst),
        AFTER: pairs[worst],
    }
    for name, pair in drawn.items():
        picture = encode_jpeg(compose(pair, "blend"), JPEG_QUALITY, THUMBNAIL_PX)
        write_files({folder / name: marked_picture(picture)})


def _report(
    scene: LoadedScene,
    overlay: LiveOverlay,
    settings: ObjectSettings,
    finished: Finished,
    curve: tuple[CurvePoint, ...],
    name: str,
) -> str:
    verdict = "" if finished.verdict is None else finished.verdict.sentence
    told = []
    if finished.mesh_error is not None:
        told = [finished.mesh_error.in_words(scene.mesh.diagonal)]
    return report_html(
        RunReport(
            title=name,
            subtitle=f"{scene.mesh.name} · {len(scene.photos)} photos",
            outcome=f"{finished.reason} {verdict}",
            warnings=[w for w in finished.warnings if w != verdict],
            comparisons=draw_comparison(
                overlay, scene.cameras, finished.cameras, "blend"
            ),
            left="start",
            elapsed_s=finished.elapsed_s,
            generations=finished.generations,
            evaluations=finished.evaluations,
            expected_error_px=finished.expected_error_px,
            costs=(finished.start_cost, finished.cost),
            certainty=(*finished.standard_errors, *told, *finished.undetermined),
            curve=curve,
            photo_names=[photo.name for photo in scene.photos],
            start=scene.cameras,
            cameras=finished.cameras,
            config=settings.config,
        )
    )


def place_results(scratch: Path, folder: Path, record: ObjectRecord) -> None:
    """Puts whole results in place: without their record, which comes last, they are none.

    Whatever else lies in the folder, such as a project, stays.

    Args:
        scratch: Where they are, on the same disk.
        folder: Where they go.
        record: Of them.

    Raises:
        OutputError: if a file that is not photoreg's is in the way.
    """
    make_folder(folder)
    check_outputs([folder / name for name in (*record.outputs, RECORD)])
    old = load_record(folder)
    (folder / RECORD).unlink(missing_ok=True)
    for name in record.outputs:
        (scratch / name).replace(folder / name)
    for name in {LOG, *(() if old is None else old.outputs)} - {*record.outputs}:
        path = folder / name
        if Path(name).name == name and path.is_file() and is_marked(path):
            path.unlink()
    save_record(folder, record)


def place_shipped(
    results: Mapping[str, bytes], out: Path, name: str, scratch: str
) -> ObjectRecord:
    """Puts results that came back from a worker in place, as `place_results`."""
    with _scratch_folder(out, scratch) as folder:
        for file, content in results.items():
            (folder / Path(file).name).write_bytes(content)
        record = load_record(folder)
        if record is None:
            raise OutputError(f"The results of {name} came back without their record.")
        place_results(folder, out / name, record)
    return record


def place_failure(folder: Path, record: ObjectRecord, log: str) -> None:
    """Notes an object that is set aside, with its log.

    Raises:
        OutputError: if a file that is not photoreg's is in the way.
    """
    make_folder(folder)
    write_files({folder / LOG: f"# {COMMENT}\n{log}"})
    save_record(folder, record)
