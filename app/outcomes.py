"""What the worker's events make of the state: pure functions, old state to new."""

import dataclasses

from app import session as rules
from app.messages import Live, MeshLoaded, PhotoLoaded, Picture, Refined
from app.placement import first_camera
from app.state import Document, Run, State, same_camera
from photoreg.camera import Camera

MAX_CURVE_POINTS = 600
"""Beyond this every second point of the cost curve is dropped."""


def with_mesh(state: State, event: MeshLoaded) -> State:
    """A new mesh; cameras are placed anew, the old ones were for another object."""
    document = state.document
    placed: list[Camera] = []
    for entry in document.photos:
        placed.append(first_camera(event.mesh, entry.photo, (0, 1, 0), tuple(placed)))
    photos = tuple(
        dataclasses.replace(entry, camera=camera)
        for entry, camera in zip(document.photos, placed, strict=True)
    )
    return dataclasses.replace(
        state,
        document=Document(event.mesh, event.display_mesh, photos),
        texture=None,
        note=f"{event.mesh.name} is loaded.",
    )


def with_photo(state: State, event: PhotoLoaded) -> State:
    """A new photo, with a sensible first camera, at the end."""
    document = state.document
    others = tuple(entry.camera for entry in document.photos)
    camera = first_camera(document.mesh, event.photo, document.up, others)
    state = rules.with_photo_added(event.photo, camera)(state)
    return dataclasses.replace(state, note=f"{event.photo.name} is added.")


def advanced(state: State, event: Live) -> State:
    """The run goes on: its newest best cameras, cost and words."""
    if not state.run.is_active:
        return state
    progress, run = event.progress, state.run
    curve = (*run.curve, *event.curve)
    if len(curve) > MAX_CURVE_POINTS:
        curve = (*curve[:-1:2], curve[-1])
    run = dataclasses.replace(
        run,
        status="running" if run.status == "starting" else run.status,
        phase=progress.phase,
        step=progress.step,
        fraction=progress.fraction,
        elapsed_s=progress.elapsed_s,
        evaluations=progress.evaluations,
        cameras=tuple(progress.cameras),
        curve=curve,
    )
    return dataclasses.replace(state, run=run)


def measured(state: State, event: Picture) -> State:
    """The true error of the cameras shown, where the truth is known."""
    run = state.run
    first = run.start_error_px if run.start_error_px is not None else event.error_px
    run = dataclasses.replace(
        run,
        error_px=event.error_px,
        start_error_px=first if run.status != "idle" else None,
    )
    return dataclasses.replace(state, run=run)


def ended(state: State, event: Refined) -> State:
    """The run is over; its cameras wait to be accepted or reverted."""
    run, finished = state.run, event.finished
    if not run.is_active:
        return state
    run = dataclasses.replace(
        run,
        status="review",
        cameras=event.cameras,
        fraction=1.0,
        start_error_px=event.start_error_px,
        error_px=event.error_px,
        step="",
    )
    if finished is None:
        run = dataclasses.replace(run, outcome="Stopped; this is the best until then.")
    else:
        run = dataclasses.replace(
            run,
            outcome=finished.reason,
            warnings=tuple(finished.warnings),
            start_cost=finished.start_cost,
            cost=finished.cost,
            elapsed_s=finished.elapsed_s,
            evaluations=finished.evaluations,
        )
    return dataclasses.replace(state, run=run)


def broken_off(state: State, outcome: str, keep: bool) -> State:
    """The run ended by a failure: the best so far waits, or all is as before."""
    run = state.run
    if not run.is_active:
        return state
    moved = any(
        not same_camera(a, b) for a, b in zip(run.start, run.cameras, strict=True)
    )
    if not keep or not moved:
        return dataclasses.replace(state, run=Run())
    run = dataclasses.replace(run, status="review", step="", outcome=outcome)
    return dataclasses.replace(state, run=run)
