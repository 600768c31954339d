"""Doubts about a texture: cameras of another world, unconvincing ones, little seen."""

from collections.abc import Iterator, Sequence

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import N_SAMPLES
from photoreg.geometry.unseen import why_unseen
from photoreg.geometry.visibility import samples_for, seen_points
from photoreg.imaging.photo import Photo
from photoreg.registration.verdict import Verdict
from photoreg.registration.world import (
    judge,
    why_convincing_elsewhere,
    why_of_another_world,
)
from photoreg.texture.bake import TexturedMesh

LITTLE_SEEN = 0.1
"""A texture that covers less of the surface than this is reported as a possible fault."""


def check_cameras_of_texture(
    mesh: Mesh, photos: Sequence[Photo], cameras: Sequence[Camera]
) -> Verdict:
    """How far cameras can be trusted, before photos are laid on with them.

    Raises:
        InputError: if they are of another world than the mesh, with what is wrong.
    """
    verdict = judge(mesh, photos, cameras)
    why = why_of_another_world(mesh, photos, cameras)
    if why is None and verdict.grade != "convincing":
        why = why_convincing_elsewhere(mesh, photos, cameras)
    if why is not None:
        raise InputError(why)
    return verdict


def doubts_about_texture(
    textured: TexturedMesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    verdict: Verdict,
) -> Iterator[str]:
    """What the user should know before using the texture, a sentence each."""
    if not verdict.is_credible:
        yield verdict.sentence
    if textured.seen_share < LITTLE_SEEN:
        yield (
            "Little of the surface is seen. If the photos show more of it, cameras and "
            "mesh are not in the same world: check the axes, units and origin of both."
        )
    shares = zip(photos, cameras, textured.seen_share_by_photo, strict=True)
    for photo, camera, share in shares:
        if share == 0.0 and (why := why_blind(textured.mesh, camera)):
            yield f"The camera of {photo.name} {why}"


def why_blind(mesh: Mesh, camera: Camera) -> str:
    """Why a camera sees nothing of the mesh; empty where it sees some."""
    points = samples_for(mesh, [camera], N_SAMPLES, seed=0).points
    if seen_points(mesh, camera, points).any():
        return ""
    return f"sees nothing of {mesh.name}. {why_unseen(mesh, [camera])}"
