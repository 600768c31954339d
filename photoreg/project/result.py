"""What a project has come to, for programs that do not know its documents."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.project.project import Project
from photoreg.project.types import check_value

RESULT = "result"
"""The setting that tells of it."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ProjectResult:
    """The cameras of a project, and what the refinement said of them."""

    cameras: Mapping[str, Camera]
    """Of the photos in use, by name."""
    grade: Literal["convincing", "plausible", "unconvincing"] | None = None
    """None where no refinement made these cameras."""
    sentence: str = ""
    """The verdict in words."""
    expected_error_px: float | None = None
    """Mean over the photos; None where it is not known."""


def read_result(folder: Path) -> ProjectResult | None:
    """The result of a project, which is only looked at; None of an older photoreg's.

    Raises:
        InputError: if the project cannot be read.
    """
    project = Project(folder, (ProjectResult, Lens), look_only=True)
    try:
        result = project.read_setting(RESULT, None, ProjectResult | None)
    finally:
        project.close()
    for name, camera in () if result is None else result.cameras.items():
        check_value(name, str, "the name of a photo")
        check_value(camera, Camera, "a camera")
    return result
