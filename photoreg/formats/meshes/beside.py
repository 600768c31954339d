"""Files that a mesh names: found in its own folder, and nowhere else."""

import re
from pathlib import Path

from photoreg.checks import note_input


def find_beside(mesh_path: Path, name: str, what: str) -> tuple[Path | None, str]:
    """The file that a mesh, or its MTL file, means by a name.

    Names were often written on another system: backslashes part folders, and capitals
    do not matter where no file has just these.

    Args:
        mesh_path: The mesh.
        name: As it stands in the file.
        what: What the name is for, for the sentence: "material file".

    Returns:
        The file, or None and the sentence that says why it is not read.
    """
    without = f"so {mesh_path.name} was read without it."
    parts = [part for part in name.strip().replace("\\", "/").split("/") if part != "."]
    is_absolute = parts[:1] == [""] or re.match(r"[A-Za-z]:", name.strip()) is not None
    if is_absolute or ".." in parts or not parts:
        return None, (
            f"The {what} {name!r} lies outside the mesh's own folder, {without} "
            "Put it beside the mesh and name it without a folder."
        )
    folder = mesh_path.parent
    for part in parts:
        folder = _entry(folder, part)
    if not folder.resolve().is_relative_to(mesh_path.parent.resolve()):
        return None, (
            f"The {what} {name} is a link out of the mesh's own folder, {without}"
        )
    if not folder.is_file():
        return None, f"The {what} {name} is not there, {without}"
    note_input(folder)
    return folder, ""


def _entry(folder: Path, name: str) -> Path:
    """The entry of that name, or else the first that differs in capitals only."""
    path = folder / name
    try:
        if path.exists() or not folder.is_dir():
            return path
        alike = sorted(
            entry
            for entry in folder.iterdir()
            if entry.name.casefold() == name.casefold()
        )
    except (OSError, ValueError):
        return path
    return alike[0] if alike else path
