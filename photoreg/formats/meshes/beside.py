"""Files that a mesh names: found in its own folder, and nowhere else."""

import re
from pathlib import Path

from photoreg.checks import note_input
from photoreg.limits import Limits


def find_beside(
    mesh_path: Path, name: str, what: str, limits: Limits
) -> tuple[Path | None, str]:
    """The file that a mesh, or its MTL file, means by a name.

    Names were often written on another system: backslashes separate folders, and case
    does not matter where no file has just these. Where there is nothing at the place that
    is named, a file of that name right beside the mesh is meant: it came without its
    folder.

    Args:
        mesh_path: The mesh.
        name: As it stands in the file.
        what: What the name is for, for the sentence: "material file".
        limits: How large it may be.

    Returns:
        The file, or None and the sentence that says why it is not read.
    """
    without = f"so {mesh_path.name} was read without it."
    parts = [part for part in name.strip().replace("\\", "/").split("/") if part != "."]
    is_absolute = parts[:1] == [""] or re.match(r"[A-Za-z]:", name.strip()) is not None
    is_elsewhere = is_absolute or ".." in parts or not parts
    last = parts[-1] if parts and parts[-1] not in ("", "..") else ""
    beside = _entry(mesh_path.parent, last)
    if (
        last
        and beside.is_file()
        and (is_elsewhere or not _at(mesh_path, parts).exists())
    ):
        parts, is_elsewhere = [last], False
    if is_elsewhere:
        return None, (
            f"The {what} {name!r} lies outside the mesh's own folder, {without} "
            "Put it beside the mesh and name it without a folder."
        )
    folder = _at(mesh_path, parts)
    if not folder.resolve().is_relative_to(mesh_path.parent.resolve()):
        return None, (
            f"The {what} {name} is a link out of the mesh's own folder, {without}"
        )
    if not folder.is_file():
        return None, f"The {what} {name} is not there, {without}"
    size = folder.stat().st_size
    if size > limits.file_bytes:
        return None, (
            f"The {what} {name} has {size / 1e6:,.1f} MB; up to {limits.file_mb:g} MB are "
            f"read, {without}"
        )
    note_input(folder)
    return folder, ""


def _at(mesh_path: Path, parts: list[str]) -> Path:
    folder = mesh_path.parent
    for part in parts:
        folder = _entry(folder, part)
    return folder


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
