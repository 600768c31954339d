"""The surface itself as a camera sees it, to lay over a photo: lines and normals.

Lines: the silhouette (edges between a face seen from the front and one from behind, and
borders) and the creases, without what the surface hides. They stay lines in space, so a
viewer draws them as thin and crisp as the screen allows.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.geometry.visibility import seen_points
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo

MIN_CREASE_DEG = 30.0
"""Faces that meet at a smaller angle are one smooth surface."""

MAX_CREASE_SHARE = 0.04
"""Of all edges at most this share are creases, the sharpest: every edge of a rough scan
bends by more than 30 degrees, and would hide the photo."""


class SurfaceLines:
    """The lines of one mesh; edges and creases are found once."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        welded = mesh.position_index[mesh.faces]
        ends = np.stack([welded, np.roll(welded, -1, axis=1)], axis=-1).reshape(-1, 2)
        ends.sort(axis=1)
        keys = ends[:, 0].astype(np.int64) * len(mesh.vertices) + ends[:, 1]
        order = np.argsort(keys, kind="stable")
        edges, first, counts = np.unique(
            keys[order], return_index=True, return_counts=True
        )
        face = np.repeat(np.arange(len(mesh.faces)), 3)[order]
        self.edges = np.column_stack(
            [edges // len(mesh.vertices), edges % len(mesh.vertices)]
        )
        """Vertices at the ends of each edge, (e, 2)."""
        self._faces = np.column_stack([face[first], face[first + (counts > 1)]])
        # Where more than two faces meet, or one ends, is a line from everywhere.
        self._always = counts != 2
        a, b = (mesh.face_normals[self._faces[:, i]] for i in (0, 1))
        cosine = np.einsum("ij,ij->i", a, b)
        sharpest = float(np.quantile(cosine, MAX_CREASE_SHARE))
        # Equal creases, as of a box, are kept all, however many.
        self._crease = cosine <= min(np.cos(np.radians(MIN_CREASE_DEG)), sharpest)

    def seen_from(self, camera: Camera) -> Float[np.ndarray, "s 2 3"]:
        """Segments of silhouette and creases that ``camera`` sees, in world axes."""
        mesh = self.mesh
        to_camera = camera.center - mesh.vertices[mesh.faces[:, 0]]
        facing = np.einsum("ij,ij->i", mesh.face_normals, to_camera) > 0.0
        front = facing[self._faces]
        drawn = (front[:, 0] != front[:, 1]) | self._always | self._crease
        chosen = np.flatnonzero(drawn)
        segments = mesh.vertices[self.edges[chosen]]
        return segments[seen_points(mesh, camera, segments.mean(axis=1))]


def shaded_normals(
    mesh: Mesh, photo: Photo, camera: Camera, share: float = 0.7
) -> UInt8[np.ndarray, "h w 3"]:
    """The photo, undistorted, with the surface over it, coloured by its normals.

    They are as ``camera`` sees them.

    Red grows to the right, green upwards, blue towards the camera: relief shows
    whatever the light in the photo was.

    Args:
        mesh: The surface.
        photo: The photo beneath; its size is the picture's.
        camera: Its camera, for whatever size.
        share: How much of the normals is mixed in, in [0, 1].
    """
    photo = undistorted_photo(photo, camera)
    camera = camera.resized(photo.width, photo.height).pinhole
    face_index = render_geometry(mesh, camera).face_index
    to_camera = camera.center - mesh.vertices[mesh.faces[:, 0]]
    # Meshes of scans may be wound inwards: the side that is seen counts.
    away = np.einsum("ij,ij->i", mesh.face_normals, to_camera) < 0.0
    normals = np.where(away, -1.0, 1.0)[:, None] * mesh.face_normals
    normals = normals @ camera.R_cam_world.T * (1.0, -1.0, -1.0)
    colours = np.rint(127.5 + 127.5 * normals).astype(np.uint8)
    mixed = cv2.addWeighted(photo.pixels, 1.0 - share, colours[face_index], share, 0.0)
    covered = (face_index >= 0).view(np.uint8)
    return cv2.copyTo(mixed, covered, photo.pixels.copy())
