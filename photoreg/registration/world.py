"""Whether cameras and mesh are in the same world, where the photos can show it.

Cameras of another program are right to some pixels in their own world, so photos agree
over the surface there. In a world whose axes are others they may still show some of it, but
they show unrelated places.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from photoreg.errors import RefinementError
from photoreg.formats.cameras.cameras_json import CameraFile
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.unseen import guesses_by_view, share_in_view, turns
from photoreg.geometry.winding import facing_cameras
from photoreg.imaging.pairs import ALL_UP_TO
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo
from photoreg.polish.misfit import against_chance, disagreement
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.genetic_search import shared_samples
from photoreg.registration.verdict import Verdict, decide_verdict
from photoreg.search.photo_consistency import (
    PhotoConsistency,
    PhotoStack,
    stack_photos,
)

LITTLE_IN_VIEW = 0.5
"""Cameras that show less of the surface than this may be of another world."""
MOST_GUESSES = 6
"""At most so many other worlds are tried, those that show most of the surface."""
CLEARLY = 0.5
"""Photos agree in a world where they disagree by no more than this share of what they
do in another one, and of chance. True cameras measured 0.001 to 0.17 of chance where the
light is the same, rough ones 0.4 to 0.7, true ones in a wrong world mostly 0.5 to 1, and
less on plain backgrounds and flat objects, where nothing is decided."""

COMPARED = dataclasses.replace(RegistrationConfig().consistency, cost="ssd")
"""How photos are compared over a world: trimmed, what a fifth of the points shows would be
left out, which is all that is not background in a wrong one."""

MIRROR = np.diag([-1.0, 1.0, 1.0])


def share_of_chance(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> float:
    """How far photos disagree over a surface, relative to unrelated ones.

    1 where no two of them see enough of it.
    """
    photos = [
        undistorted_photo(photo, camera)
        for photo, camera in zip(photos, cameras, strict=True)
    ]
    stack = stack_photos(photos, COMPARED)
    return _share_of_chance(mesh, photos, [c.pinhole for c in cameras], stack)


def _share_of_chance(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera], stack: PhotoStack
) -> float:
    """The same of photos without lenses that are prepared already."""
    try:
        samples = shared_samples(mesh, cameras, RegistrationConfig())
    except RefinementError:
        return 1.0
    consistency = PhotoConsistency(samples, photos, COMPARED, stack=stack)
    cost, chance = consistency.cost_and_chance(cameras)
    return min(1.0, cost / chance) if chance > 0.0 else 1.0


def agree_clearly_better(disagreement: float, other: float) -> bool:
    """Whether photos that disagree by this ``share_of_chance`` show that a world is wrong."""
    return disagreement <= CLEARLY * min(1.0, other)


def why_of_another_world(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> str | None:
    """What is wrong with cameras that show little of the surface, if that is certain.

    It is certain where the photos agree in another world, and not in this one. Rough
    cameras agree in none.

    Args:
        mesh: The surface.
        photos: The photos.
        cameras: One camera a photo.

    Returns:
        Sentences that say so; None where nothing suggests another world, or where nothing
        is in view, which is reported elsewhere.
    """
    share = share_in_view(mesh, cameras)
    if not 0.0 < share < LITTLE_IN_VIEW or len(photos) < 2:
        return None
    guesses = guesses_by_view(mesh, cameras)[:MOST_GUESSES]
    if not guesses:
        return None
    given = share_of_chance(mesh, photos, cameras)
    if given < CLEARLY:
        return None
    best, sentence = 1.0, None
    for _, guess in guesses:
        found = share_of_chance(mesh, photos, guess.cameras_of_mesh())
        if found < best and agree_clearly_better(found, given):
            best, sentence = found, guess.sentence
    if sentence is None:
        return None
    return (
        f"Cameras and mesh are not in the same world: {100.0 * share:.0f} % of the surface is "
        f"in view, where the photos do not agree. {sentence}"
    )


def why_convincing_elsewhere(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> str | None:
    """In which axes of the mesh cameras would be convincing that are not as it is.

    Mirrored ones among them: no cameras fit a mirrored object, unless it is symmetric.
    Only cameras that are right to some pixels show this, as those of another program.

    Args:
        mesh: The surface.
        photos: The photos.
        cameras: One camera a photo.

    Returns:
        Sentences that say so; None where nothing speaks for it.
    """
    if len(photos) < 2:
        return None
    few = slice(ALL_UP_TO)
    photos = [
        undistorted_photo(photo, camera)
        for photo, camera in zip(photos[few], cameras[few], strict=True)
    ]
    cameras = [camera.pinhole for camera in cameras[few]]
    worlds = [
        (*world, stack_photos(world[0], COMPARED))
        for world in ((photos, cameras), _mirrored(photos, cameras))
    ]
    facing = facing_cameras(mesh, cameras)
    given = _share_of_chance(facing, photos, cameras, worlds[0][2])
    for axes, turn in turns():
        is_mirrored = bool(np.linalg.det(turn) < 0.0)
        shown, placed, stack = worlds[is_mirrored]
        turn = MIRROR @ turn if is_mirrored else turn
        seen = [
            dataclasses.replace(camera, R_cam_world=camera.R_cam_world @ turn)
            for camera in placed
        ]
        # A plain background agrees with itself, but no outline falls on it.
        facing = facing_cameras(mesh, seen)
        if (
            agree_clearly_better(_share_of_chance(facing, shown, seen, stack), given)
            and judge(facing, shown, seen).grade == "convincing"
        ):
            return (
                "The mesh is a mirror image: the photos do not agree on it, but do if its "
                f"x, y, z are {axes}. No cameras fit a mirrored object. Export it anew, "
                "with the handedness of the cameras."
                if is_mirrored
                else "The mesh's axes are not the cameras': the photos do not agree on it, "
                f"but do if its x, y, z are {axes}. Export it with the other axis up, as "
                "the cameras have it."
            )
    return None


def _mirrored(
    photos: Sequence[Photo], cameras: Sequence[Camera]
) -> tuple[list[Photo], list[Camera]]:
    """What cameras would have taken in a world whose x is turned round."""
    return [
        dataclasses.replace(
            photo,
            pixels=np.ascontiguousarray(photo.pixels[:, ::-1]),
            mask=None if photo.mask is None else photo.mask[:, ::-1].copy(),
        )
        for photo in photos
    ], [
        dataclasses.replace(
            camera,
            K=camera.K * [[1, 1, -1], [1, 1, 1], [1, 1, 1]]
            + [[0, 0, camera.width - 1], [0, 0, 0], [0, 0, 0]],
            R_cam_world=MIRROR @ camera.R_cam_world @ MIRROR,
            t_cam_world=MIRROR @ camera.t_cam_world,
        )
        for camera in cameras
    ]


def judge(mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]) -> Verdict:
    """What a refinement would say of cameras if it had ended in them."""
    config = RegistrationConfig().polish
    mesh = facing_cameras(mesh, cameras)
    small = [photo.resized(config.max_side_px) for photo in photos]
    fit = disagreement(mesh, small, cameras, config.min_cosine)
    fit = against_chance(fit, mesh, small, cameras)
    return decide_verdict(fit, [photo.name for photo in photos])


def is_of_world_before(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    before: Sequence[Camera],
) -> bool | None:
    """Whether the mesh is of the world that cameras were in before they were moved.

    Args:
        mesh: The surface.
        photos: The photos.
        cameras: One camera a photo, as they stand.
        before: The same, as they were.

    Returns:
        None where both show the surface and the photos do not tell.
    """
    shares = share_in_view(mesh, cameras), share_in_view(mesh, before)
    if min(shares) < CLEARLY * max(shares):
        return shares[1] > shares[0]
    if len(photos) < 2:
        return None
    here, there = (share_of_chance(mesh, photos, each) for each in (cameras, before))
    if agree_clearly_better(there, here):
        return True
    return False if agree_clearly_better(here, there) else None


def in_world_of_mesh(
    mesh: Mesh, photos: Sequence[Photo], file: CameraFile
) -> CameraFile:
    """Cameras that a program moved, in the one of both worlds that a mesh is of.

    Args:
        mesh: The surface.
        photos: The photos; those without a camera in the file count for nothing. Where
            there are none, all cameras of the file tell by what they show.
        file: The cameras, as they were read.

    Returns:
        The cameras with a note of what was done; the file as it is where it tells of no
        other world, or nothing decides.

    Raises:
        InputError: if a camera is for a photo of another size.
    """
    move = file.moved
    if move is None:
        return file
    known = [photo for photo in photos if file.of_photo(photo.name) is not None]
    given = file.of_photos(known) if photos else list(file.cameras.values())
    if not given:
        return file
    is_before = is_of_world_before(
        mesh, known, given, [move.undone(camera) for camera in given]
    )
    if is_before is None:
        return file
    cameras = file.cameras
    told = "they are taken as they stand, for the mesh is of that world"
    if is_before:
        cameras = {name: move.undone(camera) for name, camera in cameras.items()}
        told = "this was undone, for the mesh is of the world before"
    note = f"The cameras were moved to another world when their file was made; {told}."
    notes = (note, *(other for other in file.notes if other != move.note))
    return dataclasses.replace(file, cameras=cameras, notes=notes, moved=None)
