"""The list of photos: their names, order and use. Pure, old state to new."""

import dataclasses

from app.model.point_pairs import index_of_photo
from app.model.session import Change, with_document, with_entry, with_photo_removed
from app.model.state import State
from photoreg.errors import InputError
from photoreg.names import presentable

MAX_NAME = 120


def renamed(old: str, new: str) -> Change:
    """Another name for a photo; names are unique, for cameras are matched by them."""

    def change(state: State) -> State:
        index = index_of_photo(state, old)
        name = new.strip()
        if not name or len(name) > MAX_NAME or any(c in "/\\" or c < " " for c in name):
            raise InputError(
                f"A photo's name should have 1 to {MAX_NAME} characters and no slash, "
                f"but is {name[:40]!r}."
            )
        if presentable(name) != name:
            raise InputError(
                f"The name {presentable(name)[:40]} holds characters that cannot be "
                "shown or kept. Leave out what stands with % in it."
            )
        if any(entry.name == name for entry in state.document.photos):
            raise InputError(
                f"There is a photo {name} already. Cameras are matched to photos by "
                "name, so names must differ."
            )
        photo = dataclasses.replace(state.document.photos[index].photo, name=name)
        truth = tuple(
            (name if known == old else known, camera)
            for known, camera in state.document.truth
        )
        return with_document(truth=truth)(with_entry(index, photo=photo)(state))

    return change


def enabled(name: str, on: bool) -> Change:
    """Whether a photo takes part in refinement and texture."""
    return lambda state: with_entry(index_of_photo(state, name), enabled=on)(state)


def cropped(name: str, on: bool) -> Change:
    """Whether a part of a photo was cut off after it was taken."""
    return lambda state: with_entry(index_of_photo(state, name), cropped=on)(state)


def removed(name: str) -> Change:
    """A photo leaves the list; its file stays."""
    return lambda state: with_photo_removed(index_of_photo(state, name))(state)


def shifted(name: str, by: int) -> Change:
    """A photo moves up (-1) or down (1); the selected photo stays selected."""

    def change(state: State) -> State:
        photos = list(state.document.photos)
        index = index_of_photo(state, name)
        target = min(max(index + by, 0), len(photos) - 1)
        chosen = photos[state.selected]
        photos.insert(target, photos.pop(index))
        state = with_document(photos=tuple(photos))(state)
        return dataclasses.replace(state, selected=photos.index(chosen))

    return change
