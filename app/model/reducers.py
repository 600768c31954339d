"""What the worker's events make of the state: pure functions, old state to new."""

import dataclasses

from app.model import session as rules
from app.model.camera_moves import first_camera
from app.model.durations import seconds_left
from app.model.messages import (
    CamerasFound,
    CamerasLoaded,
    Checked,
    Live,
    MeshLoaded,
    PhotoLoaded,
    Refined,
    Working,
)
from app.model.pictures import Picture
from app.model.run import Run
from app.model.scene_files import first_names, with_cameras_of_file
from app.model.state import Document, Job, State
from app.model.up_axis import guessed_up
from photoreg.geometry.camera import Camera, same_camera
from photoreg.report.cost_curve import CurvePoint

MAX_CURVE_POINTS = 600
"""Beyond this every second point of the cost curve is dropped."""


def with_mesh(state: State, event: MeshLoaded) -> State:
    """A new mesh; cameras are placed anew, the old ones were for another object."""
    document = state.document
    up, _ = guessed_up(event.display_mesh)
    placed: list[Camera] = []
    for entry in document.photos:
        placed.append(first_camera(event.mesh, entry.photo, up, tuple(placed)))
    photos = tuple(
        dataclasses.replace(entry, camera=camera)
        for entry, camera in zip(document.photos, placed, strict=True)
    )
    return dataclasses.replace(
        state,
        document=Document(event.mesh, event.display_mesh, photos, up=up),
        texture=None,
        note=" ".join([f"{event.mesh.name} is loaded.", *event.mesh.notes]),
    )


def with_photo(state: State, event: PhotoLoaded) -> State:
    """A new photo, with a sensible first camera, at the end."""
    document = state.document
    others = tuple(entry.camera for entry in document.photos)
    camera = first_camera(document.mesh, event.photo, document.up, others)
    state = rules.with_photo_added(event.photo, camera)(state)
    return dataclasses.replace(state, note=f"{event.photo.name} is added.")


def with_loaded_cameras(state: State, event: CamerasLoaded) -> State:
    """The photos have the cameras that were read, as far as there are any.

    Raises:
        InputError: if they are not for these photos.
    """
    name, file = event.name, event.file
    document = with_cameras_of_file(state.document, file, name)
    names = [entry.name for entry in document.photos]
    lacking = [name for name in names if file.of_photo(name) is None]
    note = f"The cameras are those of {name}."
    if lacking:
        note = (
            f"{name} has cameras for {len(names) - len(lacking)} of {len(names)} photos; "
            f"{first_names(lacking)} kept the old ones."
        )
    note = " ".join([note, *file.notes])
    return dataclasses.replace(state, document=document, note=note)


def worked(state: State, event: Working) -> State:
    """The job continues; one that is being stopped stays marked so until it has ended."""
    job = state.job or Job("")
    title = job.title if job.is_stopping else event.title
    job = dataclasses.replace(job, title=title, fraction=event.fraction)
    return dataclasses.replace(state, job=job)


def advanced(state: State, event: Live) -> State:
    """The run goes on: its newest best cameras, cost and words."""
    run, progress = state.run, event.progress
    if not run.is_active:
        return state
    curve = (*run.curve, *event.curve)
    if len(curve) > MAX_CURVE_POINTS:
        curve = (*_thinned(curve[:-1]), curve[-1])
    elapsed_s = progress.elapsed_s - event.paused_s
    rate = run.evaluations_per_s
    if progress.evaluations > run.evaluations > 0 and elapsed_s > run.elapsed_s:
        now = (progress.evaluations - run.evaluations) / (elapsed_s - run.elapsed_s)
        rate = now if rate is None else 0.7 * rate + 0.3 * now
    config = run.config or state.settings
    run = dataclasses.replace(
        run,
        status="running" if run.status == "starting" else run.status,
        phase=progress.phase,
        step=progress.step,
        fraction=progress.fraction,
        elapsed_s=elapsed_s,
        generation=progress.generation,
        evaluations=progress.evaluations,
        evaluations_per_s=rate,
        time_left_s=seconds_left(
            state.speed, run.preset, config, progress, rate, elapsed_s
        ),
        cameras=tuple(progress.cameras),
        curve=curve,
        polish_error_px=progress.expected_error_px,
    )
    return dataclasses.replace(state, run=run, cloud=event.cloud)


def _thinned(curve: tuple[CurvePoint, ...]) -> tuple[CurvePoint, ...]:
    """Every second point, and every point where something begins."""
    return tuple(
        point for i, point in enumerate(curve) if i % 2 == 0 or point.mark != ""
    )


def pictured(state: State, event: Picture) -> State:
    """The newest pictures, and the true error of their cameras where it is known."""
    run = state.run
    first = run.start_error_px if run.start_error_px is not None else event.error_px
    run = dataclasses.replace(
        run,
        error_px=event.error_px,
        start_error_px=first if run.status != "idle" else None,
    )
    return dataclasses.replace(state, run=run, drawn=event, shows_other=False)


def checked(state: State, event: Checked) -> State:
    """What a refinement can be expected to bring, if it is about the cameras now."""
    now = state.document.used_cameras
    if len(now) != len(event.cameras) or not all(map(same_camera, now, event.cameras)):
        return state
    return dataclasses.replace(state, readiness=event.readiness)


def ended(state: State, event: Refined) -> State:
    """The run is over; its cameras wait to be accepted or reverted."""
    run, finished = state.run, event.finished
    if not run.is_active:
        return state
    run = dataclasses.replace(
        run,
        cameras=event.cameras,
        fraction=1.0,
        start_error_px=event.start_error_px,
        error_px=event.error_px,
    )
    if finished is None:
        outcome = "Stopped; this is the best until then."
        if run.is_unwanted:
            outcome = "Stopped and reverted."
        elif not has_moved(run):
            outcome = "Stopped before anything better than the start was found."
        run = dataclasses.replace(run, outcome=outcome)
    else:
        state = dataclasses.replace(state, kept_search=None)
        verdict = finished.verdict
        sentence = "" if verdict is None else verdict.sentence
        mesh, mesh_error = state.document.mesh, finished.mesh_error
        told = ()
        if mesh is not None and mesh_error is not None:
            told = (mesh_error.in_words(mesh.diagonal, state.document.unit),)
        run = dataclasses.replace(
            run,
            outcome=finished.reason,
            warnings=tuple(w for w in finished.warnings if w != sentence),
            grade=None if verdict is None else verdict.grade,
            verdict=sentence,
            start_cost=finished.start_cost,
            cost=finished.cost,
            elapsed_s=finished.elapsed_s - event.paused_s,
            evaluations=finished.evaluations,
            generation=finished.generations,
            expected_errors_px=tuple(finished.expected_errors_px),
            standard_errors=(*finished.standard_errors, *told),
            undetermined=tuple(finished.undetermined),
        )
    return kept(state, run)


def found(state: State, event: CamerasFound) -> State:
    """Cameras that were looked for stand where they may be; the rest stays."""
    cameras = {one.photo: one.candidates[0] for one in event.found if one.candidates}
    names = {
        grade: [one.photo for one in event.found if one.grade == grade]
        for grade in ("found", "unsure", "not found")
    }
    parts = [
        f"{words}: {first_names(names[grade])}."
        for grade, words in (
            ("found", "Found"),
            ("unsure", "Unsure, look at the poses in Align"),
            ("not found", "Not found"),
        )
        if names[grade]
    ]
    return dataclasses.replace(
        rules.with_cameras(cameras)(state),
        found=event.found,
        job=None,
        note=" ".join(parts),
    )


def broken_off(state: State, outcome: str) -> State:
    """The run ended by a failure: it waits as it was; one that did nothing is gone.

    ``outcome`` is what happened, and is continued: "The engine died".
    """
    run, search = state.run, state.kept_search
    if not run.is_active:
        return state
    if has_moved(run):
        outcome += "; this is the best until then."
    elif search is not None and search.run == run.number:
        outcome += " before anything better than the start was found."
    else:
        return dataclasses.replace(state, run=Run(), kept_search=None)
    return kept(state, dataclasses.replace(run, outcome=outcome))


def has_moved(run: Run) -> bool:
    """Whether something better than the start was found.

    The first best of a search is the start itself, so a run that is stopped within its
    first generations has nothing to offer.
    """
    return any(
        not same_camera(a, b) for a, b in zip(run.start, run.cameras, strict=True)
    )


def kept(state: State, run: Run) -> State:
    """Puts an ended run into the list, and on screen unless nobody wants it."""
    run = dataclasses.replace(run, status="review", step="", time_left_s=None)
    others = tuple(other for other in state.runs if other.number != run.number)
    return dataclasses.replace(
        state,
        runs=(*others, run),
        run=Run() if run.is_unwanted else run,
        compared_with=0,
    )
