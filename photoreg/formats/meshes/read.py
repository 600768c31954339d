"""A mesh from a file, in the format of its suffix."""

import dataclasses
import logging
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from photoreg.checks import check_input_file
from photoreg.errors import InputError
from photoreg.formats.foreign import what_to_do
from photoreg.formats.meshes.contents import MeshContents, joined_pictures
from photoreg.formats.meshes.glb import read_glb
from photoreg.formats.meshes.headers import check_announced, check_counts
from photoreg.formats.meshes.obj import read_obj
from photoreg.formats.meshes.off import read_off
from photoreg.formats.meshes.packed import PACKED_SUFFIX, unpacked
from photoreg.formats.meshes.ply import read_ply
from photoreg.formats.meshes.stl import read_stl
from photoreg.geometry.mesh import Mesh, unit_rows
from photoreg.geometry.winding import consistently_wound
from photoreg.limits import Limits
from photoreg.sources import source_file

_READERS: dict[str, Callable[[Path, Limits], MeshContents]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_glb,
    ".off": read_off,
}

MESH_SUFFIXES = tuple(_READERS)
"""Of the files that `load_mesh` reads."""

COARSE_STEP = 0.02
"""Steps of single precision larger than this share of a face's size are reported."""

# What it tells in tracebacks, photoreg tells in sentences.
logging.getLogger("trimesh").setLevel(logging.CRITICAL)


def load_mesh(path: Path | str, limits: Limits | None = None) -> Mesh:
    """Loads OBJ, PLY, STL, GLB or OFF; units, axes, vertex and face order are the file's.

    Joined faces are wound alike, and of surfaces that are there twice, once turned, one
    side is kept; where that changes anything, the mesh's notes say it.

    Args:
        path: The file. What it names, an MTL or a texture, is read only from its folder.
        limits: How large it may be; None: as the environment says.

    Returns:
        The mesh; its ``notes`` say what of the file was left out.

    Raises:
        InputError: if the file is missing, empty, unreadable, of another kind, too
            large, holds no usable surface, or needs what is not understood.
    """
    limits = limits or Limits.of_environment()
    path = check_input_file(Path(path), "mesh", limits.file_mb)
    if path.suffix.lower() == PACKED_SUFFIX:
        with unpacked(path, MESH_SUFFIXES) as inside:
            mesh = load_mesh(inside.mesh, limits)
        return dataclasses.replace(mesh, source=source_file(path))
    if path.suffix.lower() not in _READERS:
        why = what_to_do(path)
        raise InputError(
            f"{path.name} is not a mesh file photoreg reads"
            f"{f': {why}' if why else ''}. The suffix should be one of "
            f"{', '.join(MESH_SUFFIXES)}."
        )
    check_announced(path, limits)
    contents = _read(path, limits)
    if len(contents.faces) == 0:
        raise InputError(_no_surface(path.name, contents))
    check_counts(path.name, len(contents.vertices), len(contents.faces), limits)
    contents, texture = joined_pictures(contents)
    mesh = Mesh(
        contents.vertices,
        contents.faces,
        contents.corner_uv,
        path.name,
        source_file(path),
        texture,
        contents.vertex_colours,
        _unit_normals(contents.vertex_normals),
        contents.notes,
    )
    note = _precision_note(mesh)
    if note:
        mesh = dataclasses.replace(mesh, notes=(*mesh.notes, note))
    return consistently_wound(mesh)


def _read(path: Path, limits: Limits) -> MeshContents:
    try:
        with warnings.catch_warnings():
            # numpy warns of what it then refuses, or reads up to.
            warnings.simplefilter("ignore")
            return _READERS[path.suffix.lower()](path, limits)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise InputError(
            f"{path.name} could not be read as a mesh: {_reason(error)}. Is the file "
            "complete?"
        ) from error


def _precision_note(mesh: Mesh) -> str:
    """Tells of coordinates whose last digits single precision has cut off."""
    largest = np.abs(mesh.bounds).max().astype(np.float32)
    step, edge = float(np.spacing(largest)), float(np.sqrt(mesh.area / len(mesh.faces)))
    if (
        step < COARSE_STEP * edge
        or not (mesh.vertices.astype(np.float32) == mesh.vertices).all()
    ):
        return ""
    return (
        f"Its coordinates, up to {largest:,.0f}, are kept in single precision, in steps of "
        f"{step:.2g}, so its faces of {edge:.2g} are bent. Export it in double precision, "
        "or moved near to the origin together with the cameras."
    )


def _no_surface(name: str, contents: MeshContents) -> str:
    if len(contents.vertices) == 0:
        why = f" {' '.join(contents.notes)}" if contents.notes else ""
        return (
            f"{name} has no triangles: it holds no surface, or none that is read.{why}"
        )
    return (
        f"{name} has no triangles ({len(contents.vertices):,} points only); photographs "
        "need a surface. Make a mesh of the points, in MeshLab by Screened Poisson or in "
        "CloudCompare by PoissonRecon, and save that as PLY."
    )


def _unit_normals(normals: np.ndarray | None) -> np.ndarray | None:
    """Normals of length 1; None where some have no direction."""
    if normals is None:
        return None
    unit = unit_rows(np.asarray(normals, dtype=np.float64))
    return unit if (np.abs(np.linalg.norm(unit, axis=1) - 1.0) < 1e-6).all() else None


def _reason(error: Exception) -> str:
    """What a reader ran into, in words; its own where they are some."""
    text = " ".join(str(error).split())
    if "escapes resolver root" in text:
        return "it names a file outside its own folder, which is not read"
    if "PLY is unexpected length" in text:
        return (
            "its length is not what its header says, or its faces have different numbers "
            "of corners (triangulate them)"
        )
    if isinstance(error, IndexError) or "index outside" in text:
        return "it names vertices or parts that do not exist"
    if isinstance(error, ValueError) and "could not be read to its end" in text:
        return "there are words where numbers should be"
    if isinstance(error, ValueError) and 20 < len(text) < 120 and "<" not in text:
        return text.rstrip(".!")
    return "its parts do not fit together"
