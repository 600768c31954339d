"""Which pictures of the photos go with a state: what the worker is asked to draw."""

from app.model.messages import MeasureReach
from app.model.pictures import Compare, Compared, OverlayView
from app.model.state import State
from photoreg.geometry.camera import Camera, same_camera


def wanted_view(state: State) -> OverlayView:
    """How the overlay is drawn, and what goes with it."""
    return OverlayView(
        style=state.overlay_style,
        onto=state.overlay_onto,
        share=state.overlay_share,
        through=state.through_style,
        mesh_opacity=state.mesh_opacity if state.through_style == "normals" else 0.0,
        start_line=state.start_line,
        surface=state.worn,
    )


def shown_cameras(state: State) -> tuple[Camera, ...]:
    """The cameras on screen of the photos in use: those of the run while there is one."""
    return tuple(entry.camera for entry in state.photos if entry.enabled)


def needs_overlay(old: State, new: State) -> bool:
    """Whether the overlay of the new state is another one."""
    return (
        wanted_view(new) != wanted_view(old)
        or not new.document.shows_same_as(old.document)
        or old.document.masks != new.document.masks
        or old.run.is_active
        or not _same_cameras(shown_cameras(new), shown_cameras(old))
    )


def wanted_reach(state: State) -> MeasureReach | None:
    """What the next run's reach depends on beside the cameras; None without a photo."""
    if state.document.mesh is None or not state.document.used:
        return None
    return MeasureReach(state.settings, state.freedom)


def wanted_comparison(state: State) -> Compare | None:
    """The run on screen, and what it is compared with; None without one.

    A photo that is used now but was not in one of them keeps its own camera.
    """
    run = state.run
    if run.status != "review":
        return None
    other = dict(zip(run.photo_names, run.start, strict=True))
    for candidate in state.runs:
        if candidate.number == state.compared_with:
            other |= dict(zip(candidate.photo_names, candidate.cameras, strict=True))
    used = state.document.used
    if not used:
        return None
    before = tuple(other.get(entry.name, entry.camera) for entry in used)
    return Compare(before, shown_cameras(state), state.overlay_style, state.surface)


def next_comparison(old: State, new: State) -> Compare | None:
    """What the new state compares; None: nothing, or what the old one did."""
    wanted, before = wanted_comparison(new), wanted_comparison(old)
    if wanted is None or (before is not None and _is_same(wanted, before)):
        return None
    return wanted


def current_comparison(state: State) -> Compared | None:
    """The pictures of what is compared now; None while they are being drawn."""
    wanted, drawn = wanted_comparison(state), state.comparison
    if wanted is None or drawn is None or not _is_same(wanted, drawn.asked):
        return None
    return drawn


def _is_same(a: Compare, b: Compare) -> bool:
    return (
        (a.style, a.surface) == (b.style, b.surface)
        and _same_cameras(a.before, b.before)
        and _same_cameras(a.after, b.after)
    )


def _same_cameras(a: tuple[Camera, ...], b: tuple[Camera, ...]) -> bool:
    return len(a) == len(b) and all(map(same_camera, a, b))
