"""Which axis of a scan points upwards: guessed from the mesh, or chosen by a person."""

import dataclasses
import functools

import numpy as np

from app.model.camera_moves import first_camera, up_of
from app.model.state import Document, PhotoEntry, State, UpAxis
from photoreg.geometry.camera import Camera, same_camera
from photoreg.geometry.mesh import Mesh

Y_UP, Z_UP = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

SURVEY_OFFSET = 50.0
"""Diagonals of the mesh from the origin beyond which a coordinate is a survey's."""

HEIGHT_SHARE = 0.05
"""The most that a height is of a survey's eastings and northings: 431,250 m east of a grid's
origin that is 21 km, above any ground."""

GROUND_DEPTH, GROUND_COSINE = 0.02, np.cos(np.radians(10.0))
"""Ground is what lies in this lowest share of the height, level to 10 degrees."""

GROUND_SHARE, GROUND_RATIO = 0.02, 3.0
"""The least share of the surface that is ground, and how much more of it than along the
other axis: a sheet that faces an axis is not ground by itself."""

THIN = 0.2
"""An extent below this share of the longest: a relief or facade, whose flat back is not
ground."""


def guessed_up(mesh: Mesh) -> tuple[tuple[float, float, float], str]:
    """The axis that probably points upwards, and why in a sentence.

    glTF says so itself. National grids have large eastings and northings and small
    heights. Else it is the axis along which the object stands on level ground; y where
    nothing tells.
    """
    if mesh.name.lower().endswith((".glb", ".gltf")):
        return Y_UP, "glTF files have y upwards."
    centre, extent = mesh.bounds.mean(axis=0), mesh.bounds[1] - mesh.bounds[0]
    away = np.abs(centre)
    is_far = away > SURVEY_OFFSET * mesh.diagonal

    def is_height(axis: int, other: int) -> bool:
        # A few hundred metres above the sea are far from a small object, too.
        return bool(away[axis] < HEIGHT_SHARE * min(away[0], away[other]))

    if is_far[0] and is_far[1] and is_height(2, 1):
        return Z_UP, "Its coordinates look like a survey's, with heights along z."
    if is_far[0] and is_far[2] and is_height(1, 2):
        return Y_UP, "Its coordinates look like a survey's, with heights along y."
    along_y, along_z = ground_share(mesh, 1), ground_share(mesh, 2)
    is_relief = extent[2] < THIN * extent.max()
    if along_z > max(GROUND_SHARE, GROUND_RATIO * along_y) and not is_relief:
        return Z_UP, "It stands on level ground along z."
    if along_y > max(GROUND_SHARE, GROUND_RATIO * along_z):
        return Y_UP, "It stands on level ground along y."
    return Y_UP, "Nothing in the mesh tells; choose Z if it lies on its side."


def ground_share(mesh: Mesh, axis: int) -> float:
    """The share of the surface that is level and at the lower end of an axis."""
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    height = corners[:, :, axis].max(axis=1) - mesh.bounds[0, axis]
    is_low = height <= GROUND_DEPTH * (mesh.bounds[1, axis] - mesh.bounds[0, axis])
    is_level = np.abs(across[:, axis]) >= GROUND_COSINE * area
    return float(area[is_low & is_level & (area > 0)].sum() / area.sum())


def with_up_axis(state: State, choice: UpAxis) -> State:
    """The choice in force; cameras that nobody has placed yet stand upright by it."""
    document = state.document
    mesh, moved = document.display_mesh, moved_photos(document)
    up = Z_UP if choice == "z" else Y_UP
    if choice == "auto":
        cameras = tuple(entry.camera for entry in moved)
        up = up_of(cameras) or (Y_UP if mesh is None else guessed_up(mesh)[0])
    photos: list[PhotoEntry] = []
    for entry in document.photos:
        if not any(entry is other for other in moved):
            others = tuple(other.camera for other in photos)
            camera = first_camera(document.mesh, entry.photo, up, others)
            entry = dataclasses.replace(entry, camera=camera)
        photos.append(entry)
    document = dataclasses.replace(
        document, up=up, up_axis=choice, photos=tuple(photos)
    )
    return dataclasses.replace(state, document=document)


def moved_photos(document: Document) -> list[PhotoEntry]:
    """The photos whose cameras are no longer as they were first put.

    A photo is put beside those before it: as these stand, or as they stood before they
    were moved themselves.
    """
    now: list[Camera] = []
    at_first: list[Camera] = []
    moved = []
    for entry in document.photos:
        put = functools.partial(first_camera, document.mesh, entry.photo, document.up)
        beside_first = put(tuple(at_first))
        if not (
            same_camera(entry.camera, beside_first)
            or same_camera(entry.camera, put(tuple(now)))
        ):
            moved.append(entry)
        now.append(entry.camera)
        at_first.append(beside_first)
    return moved
