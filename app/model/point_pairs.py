"""Point pairs: what a click in the photo or on the surface makes of the state.

Pure functions, old state to new. Clicks may come in either order, singly or several
of one kind first: a click completes the first pair that lacks its kind of point.
"""

import dataclasses

import numpy as np

from app.model.session import Change, with_entry
from app.model.state import PhotoEntry, PointPair, State
from photoreg.errors import InputError
from photoreg.geometry.camera import Camera

MAX_PAIRS = 200


def index_of_photo(state: State, name: str) -> int:
    """The place of a photo in the list.

    Raises:
        InputError: if there is none of that name.
    """
    for i, entry in enumerate(state.document.photos):
        if entry.name == name:
            return i
    raise InputError(f"There is no photo {name} any more.")


def with_photo_point(name: str, pixel: tuple[float, float]) -> Change:
    """A click in the photo."""
    return _with_point(name, pixel=pixel)


def with_surface_point(name: str, world: tuple[float, float, float]) -> Change:
    """A click on the surface."""
    return _with_point(name, world=world)


def with_moved_point(name: str, number: int, pixel: tuple[float, float]) -> Change:
    """A marker in the photo dragged to another place."""

    def change(state: State) -> State:
        _check_pixel(state.document.photos[index_of_photo(state, name)], pixel)
        return _with_pair(name, number, pixel=pixel)(state)

    return change


def with_moved_surface_point(
    name: str, number: int, world: tuple[float, float, float]
) -> Change:
    """A marker on the surface dragged to another place."""
    return _with_pair(name, number, world=world)


def without_point(name: str, number: int) -> Change:
    """A pair deleted; the others keep their numbers."""

    def change(state: State) -> State:
        index = index_of_photo(state, name)
        entry = state.document.photos[index]
        _pair(entry, number)
        pairs = tuple(pair for pair in entry.pairs if pair.number != number)
        return with_entry(index, pairs=pairs)(state)

    return change


def with_surface_points_of(name: str, other: str) -> Change:
    """The surface points of another photo, to be clicked in this one."""

    def change(state: State) -> State:
        index = index_of_photo(state, name)
        entry = state.document.photos[index]
        source = state.document.photos[index_of_photo(state, other)]
        taken = {pair.number for pair in entry.pairs}
        known = {pair.world for pair in entry.pairs}
        added = tuple(
            PointPair(pair.number, pair.world)
            for pair in source.pairs
            if pair.world is not None
            and pair.world not in known
            and pair.number not in taken
        )
        if not added:
            raise InputError(f"{other} has no surface points that {name} lacks.")
        pairs = sorted((*entry.pairs, *added), key=lambda pair: pair.number)
        return with_entry(index, pairs=tuple(pairs))(state)

    return change


def chosen(name: str, number: int | None) -> Change:
    """Marks a pair whose points the next clicks replace; the same again unmarks it."""

    def change(state: State) -> State:
        index = index_of_photo(state, name)
        if number is not None:
            _pair(state.document.photos[index], number)
        again = state.chosen_pair == number
        return dataclasses.replace(
            state, selected=index, chosen_pair=None if again else number
        )

    return change


def residuals_px(entry: PhotoEntry, camera: Camera) -> dict[int, float]:
    """Distance in the photo, by number of the whole pairs; infinite behind the camera."""
    pairs = entry.whole_pairs
    if not pairs:
        return {}
    world = np.array([pair.world for pair in pairs], dtype=np.float64)
    offsets = camera.project(world) - np.array([pair.pixel for pair in pairs])
    lengths = np.hypot(offsets[:, 0], offsets[:, 1])
    lengths[np.isnan(lengths)] = np.inf
    return {pair.number: float(d) for pair, d in zip(pairs, lengths, strict=True)}


def to_be_clicked(
    state: State,
) -> list[tuple[int, PhotoEntry, tuple[float, float]]]:
    """Points on the surface that the selected photo lacks: where another photo has them."""
    entry, found = state.selected_photo, []
    for pair in () if entry is None else entry.pairs:
        if pair.pixel is not None or pair.world is None:
            continue
        for other in state.document.photos:
            same = (p.pixel for p in other.pairs if p.world == pair.world and p.pixel)
            pixel = next(same, None)
            if pixel is not None:
                found.append((pair.number, other, pixel))
                break
    return found


def next_click(state: State) -> str:
    """What the person may do next, in one short sentence."""
    entry = state.selected_photo
    if entry is None:
        return ""
    if state.chosen_pair is not None:
        return f"Click where point {state.chosen_pair} belongs, in the photo or model."
    for pair in entry.pairs:
        if pair.world is None:
            return f"Now click point {pair.number} on the model."
    for pair in entry.pairs:
        if pair.pixel is None:
            return f"Now click point {pair.number} in the photo."
    return "Click a point in the photo, and the same on the model."


def _with_point(
    name: str,
    pixel: tuple[float, float] | None = None,
    world: tuple[float, float, float] | None = None,
) -> Change:
    field = "pixel" if world is None else "world"
    value = pixel if world is None else world

    def change(state: State) -> State:
        index = index_of_photo(state, name)
        entry = state.document.photos[index]
        if pixel is not None:
            _check_pixel(entry, pixel)
        if world is not None and not np.isfinite(world).all():
            raise InputError("A point of the surface should be three finite numbers.")
        numbers = {pair.number for pair in entry.pairs}
        target = state.chosen_pair if state.chosen_pair in numbers else None
        if target is None:
            target = next(
                (p.number for p in entry.pairs if getattr(p, field) is None), None
            )
        if target is None:
            if len(entry.pairs) >= MAX_PAIRS:
                raise InputError(f"{MAX_PAIRS} points are enough; delete some first.")
            number = max(numbers, default=0) + 1
            pairs = (*entry.pairs, PointPair(number, world, pixel))
        else:
            pairs = tuple(
                dataclasses.replace(pair, **{field: value})
                if pair.number == target
                else pair
                for pair in entry.pairs
            )
        state = with_entry(index, pairs=pairs)(state)
        return dataclasses.replace(state, chosen_pair=None)

    return change


def _with_pair(name: str, number: int, **values: tuple[float, ...]) -> Change:
    """Other points for one of the pairs."""

    def change(state: State) -> State:
        index = index_of_photo(state, name)
        entry = state.document.photos[index]
        _pair(entry, number)
        pairs = tuple(
            dataclasses.replace(pair, **values) if pair.number == number else pair
            for pair in entry.pairs
        )
        return with_entry(index, pairs=pairs)(state)

    return change


def _pair(entry: PhotoEntry, number: int) -> PointPair:
    for pair in entry.pairs:
        if pair.number == number:
            return pair
    raise InputError(f"{entry.name} has no point {number} any more.")


def _check_pixel(entry: PhotoEntry, pixel: tuple[float, float]) -> None:
    u, v = pixel
    width, height = entry.photo.width, entry.photo.height
    if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
        raise InputError(
            f"A point in {entry.name} should lie within {width}x{height} px, but is at "
            f"({u:g}, {v:g})."
        )
