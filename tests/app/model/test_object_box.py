"""The box around the object in a photo."""

import pytest

from app.engine.warm_up import toy_scene
from app.model.object_box import with_box, without_box
from app.model.state import Document, PhotoEntry, State
from photoreg.errors import InputError

WIDTH, HEIGHT = 160, 120


@pytest.fixture
def state():
    mesh, photos, cameras = toy_scene()
    assert (photos[0].width, photos[0].height) == (WIDTH, HEIGHT)
    return State(document=Document(mesh, mesh, tuple(map(PhotoEntry, photos, cameras))))


def test_a_box_is_kept_with_its_photo_and_cut_off_at_the_frame(state):
    name = state.document.photos[1].name
    boxed = with_box(name, (-20.0, 30.5, 60.0, 500.0))(state)
    first, second = boxed.document.photos
    assert first.box is None
    assert second.box == (0.0, 30.5, 40.0, HEIGHT - 30.5)
    assert boxed.document != state.document
    assert without_box(name)(boxed).document == state.document


@pytest.mark.parametrize(
    "box",
    [(10.0, 10.0, 5.0, 50.0), (WIDTH - 3.0, 0.0, 50.0, 50.0), (-90.0, 0.0, 80.0, 9.0)],
)
def test_a_box_that_holds_hardly_anything_of_the_photo_is_refused(state, box):
    with pytest.raises(InputError, match="at least 8 px"):
        with_box(state.document.photos[0].name, box)(state)
