"""Undo and redo: the documents before and after the one in force, by name of the step."""

import dataclasses
import itertools
from collections.abc import Hashable, Sequence

from app.model.state import Document

UNDO_STEPS = 200


@dataclasses.dataclass(frozen=True, eq=False)
class UndoStep:
    """The document after a step of the history."""

    name: str | None
    """Name of the step that led to it; None where it is not known."""
    document: Document


class UndoHistory:
    """What undo and redo reach. Not safe to call from several threads at once."""

    def __init__(self) -> None:
        self._past: list[tuple[str, Document]] = []
        self._future: list[tuple[str, Document]] = []
        self._gesture: Hashable = None

    @classmethod
    def of_steps(cls, steps: Sequence[UndoStep], now: int) -> "UndoHistory":
        """A history from its documents, oldest first; ``now`` is the one in force."""
        history = cls()
        history._past = [
            (after.name or "Change", before.document)
            for before, after in itertools.pairwise(steps[: now + 1])
        ]
        history._future = [
            (step.name or "Change", step.document) for step in steps[now + 1 :]
        ][::-1]
        return history

    @property
    def undo_name(self) -> str | None:
        """Name of the step that undo takes back; None if there is none."""
        return self._past[-1][0] if self._past else None

    @property
    def redo_name(self) -> str | None:
        """Name of the step that redo does again; None if there is none."""
        return self._future[-1][0] if self._future else None

    def record(self, name: str, before: Document, gesture: Hashable = None) -> None:
        """Records a step, and the document before it; what was undone is forgotten.

        Steps in a row with the same gesture are one.
        """
        if gesture is None or gesture != self._gesture:
            self._past.append((name, before))
            del self._past[:-UNDO_STEPS]
        self._future.clear()
        self._gesture = gesture

    def undo(self, current: Document) -> UndoStep | None:
        """The step taken back, and the document before it; None if there is none."""
        return self._travel(self._past, self._future, current)

    def redo(self, current: Document) -> UndoStep | None:
        """The step done again, and the document after it; None if there is none."""
        return self._travel(self._future, self._past, current)

    def steps(self, current: Document) -> tuple[list[UndoStep], int]:
        """All steps that undo and redo reach, and which of them is in force."""
        steps, name = [], None
        for following, document in self._past:
            steps.append(UndoStep(name, document))
            name = following
        steps.append(UndoStep(name, current))
        steps += [UndoStep(*ahead) for ahead in reversed(self._future)]
        return steps, len(self._past)

    def _travel(
        self,
        source: list[tuple[str, Document]],
        target: list[tuple[str, Document]],
        current: Document,
    ) -> UndoStep | None:
        if not source:
            return None
        name, document = source.pop()
        target.append((name, current))
        self._gesture = None
        return UndoStep(name, document)
