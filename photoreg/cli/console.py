"""What a command says: sentences and a bar on standard error, JSON on standard output."""

import json
import sys
from collections.abc import Iterable
from typing import Any

import rich.console
import rich.progress

log = rich.console.Console(stderr=True, highlight=False, soft_wrap=True)

TOLD = rich.progress.TextColumn("{task.fields[told]}")
"""Words beside the bar, the task's field ``told``."""


def print_notes(notes: Iterable[str]) -> None:
    """Prints what was left out of a file, or could only be guessed."""
    for note in notes:
        log.print(f"Note: {note}", markup=False)


def progress_bar(
    columns: Iterable[rich.progress.ProgressColumn] = (
        rich.progress.TaskProgressColumn(),
        TOLD,
        rich.progress.TimeRemainingColumn(),
    ),
) -> rich.progress.Progress:
    """A bar that disappears when it ends.

    Args:
        columns: What comes after the bar.
    """
    return rich.progress.Progress(
        rich.progress.TextColumn("{task.description}"),
        rich.progress.BarColumn(),
        *columns,
        console=log,
        transient=True,
    )


def print_json(figures: dict[str, Any]) -> None:
    """Prints figures for programs."""
    json.dump(figures, sys.stdout, indent=1)
    print()
