"""Whether an untrusted project can be opened: all of it is read, nothing is written."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.limits import Limits
from photoreg.project.files import FileProblem
from photoreg.project.project import Project, StoredStep
from photoreg.project.values import Loaded
from photoreg.sources import SourceFile


@dataclasses.dataclass(frozen=True)
class CheckedProject:
    """What was read of a project that can be opened."""

    problems: tuple[FileProblem, ...]
    """Files that are not as they were; with any, no document was read."""
    steps: tuple[StoredStep, ...]
    """The history around the document in force."""
    loaded: Loaded
    """The meshes and photos that were read from files."""


def check_project(
    folder: Path | str,
    types: Iterable[type] = (),
    document: Any = Any,
    settings: Mapping[str, Any] | None = None,
    *,
    files: Mapping[str, SourceFile] | None = None,
    limits: Limits | None = None,
    on_part: Callable[[str], None] = lambda _: None,
) -> CheckedProject:
    """Reads of a project what opening it needs, without a trace in its folder.

    Args:
        folder: The project's folder.
        types: The dataclasses that its documents consist of.
        document: The type of its documents.
        settings: The types of its settings by name; others are not read.
        files: Files of the project, by key, that are elsewhere than it knows.
        limits: How large it may be; None: as the environment says.
        on_part: Told what is read next.

    Raises:
        InputError: if it cannot be opened: it is damaged, of a newer photoreg, too large
            or not as photoreg makes it, or a file of it is not valid.
    """
    on_part("its database")
    project = Project(folder, types, create=False, look_only=True, limits=limits)
    project.files.assume(files or {})
    try:
        for name, kind in (settings or {}).items():
            project.read_setting(name, None, kind)
        unfinished = project.runs.unfinished_run()
        if unfinished is not None:
            project.runs.checkpoint(unfinished.id)
        on_part("its files")
        problems = tuple(project.file_problems())
        if problems:
            return CheckedProject(problems, (), {})
        on_part("its history")
        steps = tuple(project.read_history(kind=document)[1])
        loaded: dict[tuple[type, Path, str], Any] = {}
        for step in steps:
            _collect(step.document, loaded)
    finally:
        project.close()
    return CheckedProject((), steps, loaded)


def _collect(value: Any, loaded: dict[tuple[type, Path, str], Any]) -> None:
    if isinstance(value, Mesh | Photo):
        if value.source is not None:
            loaded[type(value), value.source.path, value.source.sha256] = value
    elif isinstance(value, tuple):
        for item in value:
            _collect(item, loaded)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _collect(getattr(value, field.name), loaded)
