"""The box that a person draws around the object in a photo.

Pure functions, old state to new.
"""

from app.model.point_pairs import index_of_photo
from app.model.session import Change, with_entry
from app.model.state import State
from photoreg.errors import InputError
from photoreg.placing.outcome import Box

LEAST_PX = 8.0
"""A box that is narrower or lower holds no object that could be found."""


def with_box(name: str, box: Box) -> Change:
    """A box in place of the one before; what of it lies beyond the photo is cut off.

    Args:
        name: The photo's name.
        box: In pixels; (0, 0) is the corner of the photo.

    Raises:
        InputError: if hardly anything of it lies in the photo.
    """

    def change(state: State) -> State:
        index = index_of_photo(state, name)
        photo = state.document.photos[index].photo
        left, top, width, height = box
        right, bottom = min(left + width, photo.width), min(top + height, photo.height)
        left, top = max(left, 0.0), max(top, 0.0)
        width, height = right - left, bottom - top
        if not min(width, height) >= LEAST_PX:
            raise InputError(
                f"A box around the object should be at least {LEAST_PX:g} px wide and "
                f"high within {name}. Drag it from one corner to the other."
            )
        return with_entry(index, box=(left, top, width, height))(state)

    return change


def without_box(name: str) -> Change:
    """The photo without its box."""
    return lambda state: with_entry(index_of_photo(state, name), box=None)(state)
