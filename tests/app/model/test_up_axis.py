"""The axis upwards: guessed from meshes of known stance, chosen, and what follows it."""

import dataclasses

import numpy as np
import pytest
import trimesh

from app.model.camera_moves import first_camera, orbited
from app.model.state import Document, PhotoEntry, State
from app.model.up_axis import Y_UP, Z_UP, guessed_up, moved_photos, with_up_axis
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rotations import rotation_matrix
from photoreg.imaging.photo import Photo

RNG = np.random.default_rng(5)


def lump_on_a_plinth() -> trimesh.Trimesh:
    """A rough sphere on a box, z upwards: its underside is level ground."""
    ball = trimesh.creation.icosphere(3, 1.0)
    ball.vertices *= 1.0 + 0.05 * RNG.standard_normal((len(ball.vertices), 1))
    ball.apply_translation([0, 0, 1.4])
    plinth = trimesh.creation.box((1.2, 1.0, 1.0))
    whole = trimesh.util.concatenate([ball, plinth])
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def mesh_of(
    shape: trimesh.Trimesh,
    name: str = "scan.ply",
    axes=(0, 1, 2),
    shift=(0.0, 0.0, 0.0),
):
    vertices = np.asarray(shape.vertices)[:, list(axes)] + shift
    return Mesh(vertices, np.asarray(shape.faces), name=name)


@pytest.mark.parametrize(("axes", "up"), [((0, 1, 2), Z_UP), ((1, 2, 0), Y_UP)])
def test_what_stands_on_level_ground_stands_upright(axes, up):
    assert guessed_up(mesh_of(lump_on_a_plinth(), axes=axes))[0] == up


def test_a_survey_has_its_heights_along_the_axis_that_is_small():
    ball = trimesh.creation.icosphere(2)
    assert guessed_up(mesh_of(ball, shift=(431250.0, 5411800.0, 30.0)))[0] == Z_UP
    assert guessed_up(mesh_of(ball, shift=(431250.0, 30.0, -5411800.0)))[0] == Y_UP
    # On a mountain, as far above the sea as many sizes of the object.
    assert guessed_up(mesh_of(ball, shift=(431250.0, 5411800.0, 2210.0)))[0] == Z_UP
    assert guessed_up(mesh_of(ball, shift=(431250.0, 2210.0, -5411800.0)))[0] == Y_UP


def test_gltf_and_what_tells_nothing_have_y_upwards():
    assert guessed_up(mesh_of(lump_on_a_plinth(), "scan.glb"))[0] == Y_UP
    assert guessed_up(mesh_of(trimesh.creation.icosphere(2)))[0] == Y_UP


def test_the_flat_back_of_a_relief_is_no_ground():
    relief = trimesh.creation.box((4.0, 3.0, 0.3))
    assert guessed_up(mesh_of(relief.subdivide()))[0] == Y_UP


def test_moving_the_first_camera_moves_no_other():
    mesh = mesh_of(lump_on_a_plinth())
    photos = [Photo(f"{i}.png", np.zeros((60, 80, 3), np.uint8)) for i in range(3)]
    firsts: list[Camera] = []
    for photo in photos:
        firsts.append(first_camera(mesh, photo, Y_UP, tuple(firsts)))
    entries = tuple(map(PhotoEntry, photos, firsts))
    document = Document(mesh, mesh, entries, up=Y_UP)
    assert moved_photos(document) == []
    middle = mesh.bounds.mean(axis=0)
    turned = orbited(firsts[0], middle, rotation_matrix(np.radians([0.0, 50.0, 0.0])))
    first = dataclasses.replace(entries[0], camera=turned)
    document = dataclasses.replace(document, photos=(first, *entries[1:]))
    assert moved_photos(document) == [first]
    # One that came after the first was moved stands beside where that is now.
    late = Photo("late.png", np.zeros((60, 80, 3), np.uint8))
    others = (turned, *firsts[1:])
    entry = PhotoEntry(late, first_camera(mesh, late, Y_UP, others))
    document = dataclasses.replace(document, photos=(*document.photos, entry))
    assert moved_photos(document) == [first]
    at_hand = PhotoEntry(
        late, dataclasses.replace(entry.camera, t_cam_world=turned.center)
    )
    document = dataclasses.replace(document, photos=(*document.photos[:3], at_hand))
    assert moved_photos(document) == [first, at_hand]


def test_a_choice_turns_the_cameras_that_nobody_placed_and_no_other():
    mesh = mesh_of(lump_on_a_plinth())
    photo = Photo("a.png", np.zeros((60, 80, 3), np.uint8))
    other = Photo("b.png", np.zeros((60, 80, 3), np.uint8))
    first = first_camera(mesh, photo, Y_UP)
    placed = dataclasses.replace(first, t_cam_world=first.t_cam_world + 0.5)
    document = Document(
        mesh, mesh, (PhotoEntry(photo, first), PhotoEntry(other, placed)), up=Y_UP
    )
    state = with_up_axis(State(document=document), "z")
    assert state.document.up == Z_UP
    turned, kept = state.document.photos
    assert kept.camera is placed
    # Upright: the photo's own upwards, -y, is the world's z.
    assert -turned.camera.R_cam_world[1] @ np.array(Z_UP) > 0.9
    back = with_up_axis(state, "y")
    np.testing.assert_allclose(
        back.document.photos[0].camera.R_cam_world, first.R_cam_world, atol=1e-12
    )
    assert with_up_axis(state, "auto").document.up_axis == "auto"
