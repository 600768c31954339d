"""Why cameras do not see a surface: what programs most often disagree about is tried."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface

N_POINTS = 500
N_CAMERAS = 12
MIN_IN_VIEW = 0.25
"""Share of the surface in a photo, on average, by which a guess may be right."""
MIN_SPAN = 0.15
"""Of the photo's longer side: what is smaller is far off, by chance in the background."""
CLEARLY = 1.1
"""A guess that asks for more must explain so much more."""
SCALES = (1000.0, 100.0, 10.0, 0.1, 0.01, 0.001, 0.0254, 1 / 0.0254, 0.3048, 1 / 0.3048)
FAR = 50.0
"""Diagonals of the mesh from it to the cameras that are too many for one world."""
MIN_SIZE_PX = 8.0

_Points = Float[np.ndarray, "n 3"]


def why_unseen(mesh: Mesh, cameras: Sequence[Camera]) -> str:
    """What is wrong with cameras that do not see a mesh, and what to do, in a sentence.

    Args:
        mesh: The surface, in the cameras' world or not.
        cameras: The cameras.
    """
    points = sample_surface(mesh, N_POINTS, 0).points
    if any(camera.contains(camera.project(points)).any() for camera in cameras):
        return _of_what_is_in_view(points, cameras)
    # Some of many are enough to tell.
    cameras = cameras[:: max(1, len(cameras) // N_CAMERAS)]
    best, found = MIN_IN_VIEW / CLEARLY, ""
    for guess in _guesses(mesh, cameras):
        share = _in_view(guess.moved(points), guess.cameras)
        if share > CLEARLY * best:
            best, found = share, guess.sentence
    if found:
        return found
    middle = np.mean([camera.center for camera in cameras], axis=0)
    away = float(np.linalg.norm(middle - mesh.centroid)) / mesh.diagonal
    if away > FAR:
        return (
            f"The cameras are {away:,.0f} times the mesh's size away from it, so the two "
            "are not in one world: one may be moved to an origin of its own, or be in "
            "other units. Export both together, in one coordinate system."
        )
    return (
        "The surface is out of all photos, so the cameras are not of this mesh's world. "
        "Export both from one program, in one coordinate system, or align the cameras "
        "in the app."
    )


def _of_what_is_in_view(points: _Points, cameras: Sequence[Camera]) -> str:
    spans = [
        float(np.ptp(pixels[camera.contains(pixels)], axis=0).max())
        for camera in cameras
        for pixels in (camera.project(points),)
        if camera.contains(pixels).any()
    ]
    if max(spans) < MIN_SIZE_PX:
        return (
            f"The whole surface is only {max(spans):.1f} px large in the photos: the "
            "mesh and the cameras are in other units, or not of one world. Export both "
            "together."
        )
    return (
        "The surface is in view, but hidden behind other parts of the mesh, too flat to "
        "the view, at the very border, or masked. Check the cameras and masks in the app, "
        "and that nothing stands between the cameras and the surface."
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Guess:
    """What may be wrong between a mesh and cameras."""

    sentence: str
    """What it is, and what to do."""
    cameras: Sequence[Camera]
    """The cameras as they would be if it were true, but for the mesh's world."""
    turn: Float[np.ndarray, "3 3"] = dataclasses.field(
        default_factory=lambda: np.eye(3)
    )
    """What the mesh's axes would be turned by, or mirrored,"""
    scale: float = 1.0
    """and enlarged by,"""
    middle: Float[np.ndarray, "3"] = dataclasses.field(
        default_factory=lambda: np.zeros(3)
    )
    """after this place of it is moved to the origin."""

    def moved(self, points: _Points) -> _Points:
        """Points of the mesh where they would be."""
        return self.scale * (points - self.middle) @ self.turn.T

    def cameras_of_mesh(self) -> list[Camera]:
        """Cameras that see the mesh, as it is, as it would be seen."""
        R, t = self.turn, -self.turn @ self.middle
        return [
            dataclasses.replace(
                camera,
                R_cam_world=camera.R_cam_world @ R,
                t_cam_world=camera.t_cam_world / self.scale + camera.R_cam_world @ t,
            )
            for camera in self.cameras
        ]


def guesses_by_view(mesh: Mesh, cameras: Sequence[Camera]) -> list[tuple[float, Guess]]:
    """Share of the surface in the photos by each guess that is no mirror, largest first.

    Those that show clearly more of it than the cameras do as they stand.
    """
    points = sample_surface(mesh, N_POINTS, 0).points
    least = max(MIN_IN_VIEW, CLEARLY * share_in_view(mesh, cameras))
    found = []
    for guess in _guesses(mesh, cameras):
        if np.linalg.det(guess.turn) > 0.0:
            share = _in_view(guess.moved(points), guess.cameras)
            if share >= least:
                found.append((share, guess))
    return sorted(found, key=lambda one: -one[0])


def share_in_view(mesh: Mesh, cameras: Sequence[Camera]) -> float:
    """Share of the surface in the photos, on average, hidden or not."""
    points = sample_surface(mesh, N_POINTS, 0).points
    inside = [camera.contains(camera.project(points)).mean() for camera in cameras]
    return float(np.mean(inside))


def _guesses(mesh: Mesh, cameras: Sequence[Camera]) -> Iterator[Guess]:
    flip = np.diag([1.0, -1.0, -1.0])
    yield Guess(
        "The cameras look away from the surface: their axes are those of OpenGL or "
        "Blender (y up, looking along -z), and should be OpenCV's (y down, looking along "
        "+z). Multiply the second and third row of R and t by -1.",
        _changed(cameras, lambda R, t: (flip @ R, flip @ t)),
    )
    yield Guess(
        "The cameras' R and t take camera to world, and should take world to camera. "
        "Give the inverse: R transposed, and minus R transposed times t.",
        _changed(cameras, lambda R, t: (R.T, -R.T @ t)),
    )
    for axes, turn in turns():
        yield Guess(
            "The mesh's axes are not the cameras': the surface would be seen if its "
            f"x, y, z were {axes}. Export the mesh with the other axis up, as the "
            "cameras have it.",
            cameras,
            turn=turn,
        )
    for scale in SCALES:
        yield Guess(
            "The mesh's units are not the cameras': the surface would be seen if it were "
            f"{scale:.4g} times as large. Export the mesh in the cameras' units.",
            cameras,
            scale=scale,
        )
    for axes, turn in turns():
        for scale in SCALES:
            yield Guess(
                "Neither units nor axes of the mesh are the cameras': the surface would "
                f"be seen if it were {scale:.4g} times as large and its x, y, z were "
                f"{axes}. Export both together, in one coordinate system.",
                cameras,
                turn=turn,
                scale=scale,
            )
    middle = mesh.bounds.mean(axis=0)
    if np.linalg.norm(middle) > mesh.diagonal:
        yield Guess(
            "The mesh is moved against the cameras: the surface would be seen if its "
            f"middle, now at {_place(middle)}, were at 0, 0, 0. Export both in one "
            "coordinate system, with one origin.",
            cameras,
            middle=middle,
        )


def _changed(
    cameras: Sequence[Camera],
    change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> list[Camera]:
    changed = []
    for camera in cameras:
        R, t = change(camera.R_cam_world, camera.t_cam_world)
        changed.append(dataclasses.replace(camera, R_cam_world=R, t_cam_world=t))
    return changed


def turns() -> Iterator[tuple[str, Float[np.ndarray, "3 3"]]]:
    """All ways to name the axes but the given one, in words; rotations come first."""
    ways = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.diag(signs) @ np.eye(3)[list(order)]
            words = (
                f"{'-' if s < 0 else ''}{'xyz'[i]}"
                for s, i in zip(signs, order, strict=True)
            )
            ways.append((", ".join(words), turn))
    ways.sort(key=lambda way: (np.linalg.det(way[1]) < 0.0, -np.trace(way[1])))
    yield from ways[1:]


def _in_view(points: _Points, cameras: Sequence[Camera]) -> float:
    """Share of the points in the photos, on average, of those that show them large."""
    shares = []
    for camera in cameras:
        pixels = camera.project(points)
        seen = pixels[camera.contains(pixels)]
        span = float(np.ptp(seen, axis=0).max()) if len(seen) else 0.0
        is_large = span > MIN_SPAN * max(camera.width, camera.height)
        shares.append(len(seen) / len(points) if is_large else 0.0)
    return float(np.mean(shares))


def _place(point: Float[np.ndarray, "3"]) -> str:
    return ", ".join(f"{value:.6g}" for value in point)
