"""The rules of the app: the state is replaced whole, with undo by name.

No viser and no engine here; everything on screen is made from the state, and every
click changes the state and nothing else.
"""

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

from app.model.run import Run
from app.model.state import Document, PhotoEntry, State
from app.model.undo_history import UndoHistory, UndoStep
from photoreg.errors import InputError, OutputError, RefinementError
from photoreg.geometry.camera import Camera
from photoreg.imaging.photo import Photo

Change = Callable[[State], State]
Listener = Callable[[State, State], None]

OF_THE_PROGRAM = (
    *("worker", "dark", "waiting"),
    *("drawn", "shows_other", "surface_glb", "comparison"),
)
"""Fields of the state that a project does not bring: those of what is drawn are of the
scene, which may be the same in it."""


class Session:
    """Holds the state; replaces it whole; remembers documents for undo.

    Safe to call from any thread. Listeners are called in the order of the changes,
    with the old and the new state, and must return at once.
    """

    def __init__(self, state: State | None = None) -> None:
        self._state = state if state is not None else State()
        self.lock = threading.RLock()
        """Held during a change; hold it to make several changes as one."""
        self._listeners: list[Listener] = []
        self._undo_history = UndoHistory()

    @property
    def state(self) -> State:
        """The state now."""
        return self._state

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Calls ``listener(old, new)`` after each change; returns how to stop that."""
        with self.lock:
            self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def change(
        self, name: str | None, change: Change, gesture: Hashable = None
    ) -> bool:
        """Replaces the state by ``change(state)``.

        Args:
            name: Name of the undo step, like "Move camera 2"; None for changes that
                cannot touch the document.
            change: Makes the new state from the old; may raise, then nothing happens.
            gesture: Changes in a row with the same gesture are one undo step, so a
                drag is one step however many updates it sends.

        Returns:
            Whether anything changed.
        """
        with self.lock:
            old = self._state
            new = change(old)
            if new == old:
                return False
            if new.document != old.document:
                if name is None:
                    raise ValueError("A change of the document needs a name.")
                if old.read_only:
                    raise OutputError(old.read_only)
                if old.run.is_active:
                    raise RefinementError(
                        "The refinement is running. Stop it first, or wait for its end."
                    )
                self._undo_history.record(name, old.document, gesture)
            self._replace(new)
            return True

    def undo(self) -> str | None:
        """Takes the last step back; returns its name, None if there is none."""
        return self._travel(self._undo_history.undo)

    def redo(self) -> str | None:
        """Does the step taken back again; returns its name, None if there is none."""
        return self._travel(self._undo_history.redo)

    def history(self) -> tuple[list[UndoStep], int]:
        """All steps that undo and redo reach, and which of them is in force."""
        with self.lock:
            return self._undo_history.steps(self._state.document)

    def begin(self, document: Document) -> None:
        """Begins anew with a document; nothing can be undone."""
        self.restore([UndoStep(None, document)], 0)

    def restore(
        self,
        steps: Sequence[UndoStep],
        now: int,
        choices: Mapping[str, Any] | None = None,
        run: Run | None = None,
    ) -> None:
        """Puts a whole history in place of this one.

        Args:
            steps: The documents, oldest first.
            now: Which of them is in force.
            choices: Fields of the state that were chosen.
            run: A run that waits to be accepted; None: none.
        """
        with self.lock:
            self._undo_history = UndoHistory.of_steps(steps, now)
            self._replace(
                dataclasses.replace(
                    State(),
                    **{
                        **{name: getattr(self._state, name) for name in OF_THE_PROGRAM},
                        **(choices or {}),
                        "document": steps[now].document,
                        "run": run if run is not None else Run(),
                    },
                )
            )

    def _travel(self, take: Callable[[Document], UndoStep | None]) -> str | None:
        with self.lock:
            history = self._undo_history
            if not (history.undo_name if take == history.undo else history.redo_name):
                return None
            if self._state.read_only:
                raise OutputError(self._state.read_only)
            if self._state.run.status != "idle":
                raise RefinementError(
                    "Accept or revert the refinement first; then undo works again."
                    if self._state.run.status == "review"
                    else "The refinement is running. Stop it first."
                )
            step = take(self._state.document)
            assert step is not None
            self._replace(dataclasses.replace(self._state, document=step.document))
            return step.name

    def _replace(self, new: State) -> None:
        old = self._state
        if not new.document.shows_same_as(old.document):
            # What was measured and drawn of another scene would mislead.
            new = dataclasses.replace(
                new,
                agreement=None,
                readiness=None,
                drawn=None,
                surface_glb=None,
                run=dataclasses.replace(new.run, error_px=None)
                if new.run.status == "idle"
                else new.run,
            )
        run = new.run
        self._state = dataclasses.replace(
            new,
            cloud=new.cloud if run.is_active else None,
            comparison=new.comparison if run.status == "review" else None,
            selected=min(new.selected, max(0, len(new.document.photos) - 1)),
            undo_name=self._undo_history.undo_name,
            redo_name=self._undo_history.redo_name,
        )
        # All hear of it, and what one of them raises reaches whoever made the change.
        with contextlib.ExitStack() as in_order:
            for listener in reversed(self._listeners):
                in_order.callback(listener, old, self._state)


def setting(**values: Any) -> Change:
    """A change of fields of the state that are not the document."""
    return lambda state: dataclasses.replace(state, **values)


def blinked(state: State) -> State:
    """The turn of the other picture of a blink, if there is one."""
    if state.drawn is None or state.drawn.other_jpeg is None:
        return state
    return dataclasses.replace(state, shows_other=not state.shows_other)


def select(index: int) -> Change:
    """Chooses a photo."""

    def change(state: State) -> State:
        if not 0 <= index < len(state.document.photos):
            raise InputError(f"There is no photo {index + 1}.")
        return dataclasses.replace(state, selected=index)

    return change


def with_document(**values: Any) -> Change:
    """A change of fields of the document."""
    return lambda state: dataclasses.replace(
        state, document=dataclasses.replace(state.document, **values)
    )


def with_entry(index: int, **values: Any) -> Change:
    """A change of fields of one photo's entry."""

    def change(state: State) -> State:
        photos = list(state.document.photos)
        if not 0 <= index < len(photos):
            raise InputError(f"There is no photo {index + 1} any more.")
        if state.run.status == "review":
            raise RefinementError("Accept or revert the refinement first.")
        photos[index] = dataclasses.replace(photos[index], **values)
        return with_document(photos=tuple(photos))(state)

    return change


def with_photo_added(photo: Photo, camera: Camera) -> Change:
    """Adds a photo at the end; a name that is taken gets a number."""

    def change(state: State) -> State:
        taken = {entry.name for entry in state.document.photos}
        name, number = photo.name, 2
        while name in taken:
            stem, dot, suffix = photo.name.rpartition(".")
            name = f"{stem}-{number}.{suffix}" if dot else f"{photo.name}-{number}"
            number += 1
        entry = PhotoEntry(dataclasses.replace(photo, name=name), camera)
        photos = (*state.document.photos, entry)
        return dataclasses.replace(
            with_document(photos=photos)(state), selected=len(photos) - 1
        )

    return change


def with_photo_removed(index: int) -> Change:
    """Removes a photo; the files on disk stay."""

    def change(state: State) -> State:
        photos = state.document.photos
        if not 0 <= index < len(photos):
            raise InputError(f"There is no photo {index + 1} any more.")
        return with_document(photos=photos[:index] + photos[index + 1 :])(state)

    return change


def with_cameras(cameras: dict[str, Camera]) -> Change:
    """Replaces the cameras of the photos that are named."""

    def change(state: State) -> State:
        return with_document(
            photos=tuple(
                dataclasses.replace(entry, camera=cameras.get(entry.name, entry.camera))
                for entry in state.document.photos
            )
        )(state)

    return change


def accepted(state: State) -> State:
    """Takes the run's cameras into the document."""
    if state.run.status != "review":
        raise RefinementError("There is no finished refinement to accept.")
    cameras = dict(zip(state.run.photo_names, state.run.cameras, strict=True))
    run = Run(error_px=state.run.error_px)
    return dataclasses.replace(with_cameras(cameras)(state), run=run, compared_with=0)


def reverted(state: State) -> State:
    """Leaves the run's cameras; those from before it are in force again."""
    if state.run.status != "review":
        raise RefinementError("There is no finished refinement to revert.")
    return dataclasses.replace(state, run=Run(), compared_with=0)


def looking_at(number: int) -> Change:
    """Puts an ended run on screen, to be compared, accepted or left."""

    def change(state: State) -> State:
        if state.run.is_active:
            raise RefinementError("The refinement is running. Stop it first.")
        for run in state.runs:
            if run.number == number:
                return dataclasses.replace(state, run=run, compared_with=0)
        raise InputError(f"There is no run {number} any more.")

    return change
