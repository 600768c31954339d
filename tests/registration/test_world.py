"""Cameras and meshes of different worlds are told apart by what the photos show."""

import dataclasses
import re

import numpy as np
import pytest

from photoreg.errors import RefinementError
from photoreg.formats.cameras.registry import read_cameras
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.unseen import share_in_view
from photoreg.registration.refinement import refine
from photoreg.registration.world import (
    in_world_of_mesh,
    is_of_world_before,
    share_of_chance,
    why_convincing_elsewhere,
    why_of_another_world,
)
from photoreg.synthetic.rough_cameras import rough_start
from tests.moved_cameras import SCALE, TURN, write_moved
from tests.polish_scene import make_polish_scene, moved
from tests.scenes import small_scene

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.fixture(scope="module")
def scene():
    """Off the origin, so that turned axes take half of the ball out of the photos."""
    place = np.array([0.0, -0.95, 0.95])
    return moved(make_polish_scene(), 1.0, np.eye(3), place)


@pytest.fixture(scope="module")
def turned(scene):
    return Mesh(scene.mesh.vertices @ Y_UP.T, scene.mesh.faces)


def test_turned_axes_that_leave_a_part_in_view_are_named(scene, turned):
    assert 0.02 < share_in_view(turned, scene.cameras) < 0.5
    why = why_of_another_world(turned, scene.photos, scene.cameras)
    assert why is not None
    assert "x, y, z were x, -z, y" in why
    with pytest.raises(RefinementError, match="x, y, z were x, -z, y"):
        next(iter(_past_the_start(turned, scene)))


def _past_the_start(mesh, scene):
    events = refine(mesh, scene.photos, scene.cameras)
    next(events)
    yield next(events)


def test_cameras_of_the_mesh_s_world_are_left_in_peace(scene):
    # Close up, too, where they show little of the surface.
    near = [
        dataclasses.replace(c, K=np.diag([3.0, 3.0, 1.0]) @ c.K) for c in scene.cameras
    ]
    for cameras in (scene.cameras, scene.rough, near):
        assert why_of_another_world(scene.mesh, scene.photos, cameras) is None


def test_photos_agree_in_their_own_world_only(scene, turned):
    assert share_of_chance(scene.mesh, scene.photos, scene.cameras) < 0.05
    assert share_of_chance(turned, scene.photos, scene.cameras) > 0.5


def turned_by(mesh, turn):
    """The surface with other axes; a mirror image keeps its outside."""
    order = 1 if np.linalg.det(turn) > 0.0 else -1
    return Mesh(mesh.vertices @ turn.T, mesh.faces[:, ::order].copy())


@pytest.mark.parametrize(
    ("turn", "said"),
    [
        (np.diag([1.0, 1.0, -1.0]), "mirror image: .* x, y, z are x, y, -z"),
        (np.eye(3)[[0, 2, 1]], "mirror image: .* x, y, z are x, z, y"),
        (Y_UP, "axes are not the cameras': .* x, y, z are x, -z, y"),
    ],
)
def test_other_axes_of_a_mesh_that_is_all_in_view_are_named(turn, said):
    scene = small_scene()
    mesh = turned_by(scene.mesh, turn)
    assert share_in_view(mesh, scene.cameras) > 0.5
    why = why_convincing_elsewhere(mesh, scene.photos, scene.cameras)
    assert why is not None
    assert re.search(said, why), why


@pytest.mark.parametrize("seed", range(4))
def test_neither_right_nor_rough_cameras_are_said_to_be_of_another_world(seed):
    scene = small_scene(seed)
    rough = rough_start(scene.true_mesh, scene.cameras, (10.0, 20.0), seed)
    mirrored = turned_by(scene.mesh, np.diag([1.0, 1.0, -1.0]))
    for mesh, cameras in (
        (scene.mesh, scene.cameras),
        (scene.mesh, scene.rough_cameras),
        (scene.mesh, rough),
        (mirrored, scene.rough_cameras),  # Mirrored it is, but nothing shows it.
    ):
        assert why_convincing_elsewhere(mesh, scene.photos, cameras) is None


def test_of_two_worlds_the_one_that_the_mesh_is_of_is_chosen(scene):
    def seen_in(turn):
        return [
            dataclasses.replace(c, R_cam_world=c.R_cam_world @ turn)
            for c in scene.cameras
        ]

    mesh, photos, here = scene.mesh, scene.photos, list(scene.cameras)
    assert is_of_world_before(mesh, photos, seen_in(Y_UP), here) is True
    assert is_of_world_before(mesh, photos, here, seen_in(Y_UP)) is False
    # About the middle of the object everything stays in view; the photos tell.
    middle = mesh.centroid
    centred = Mesh(mesh.vertices - middle, mesh.faces)

    def about_the_middle(turn):
        return [
            dataclasses.replace(
                c,
                R_cam_world=c.R_cam_world @ turn,
                t_cam_world=c.t_cam_world + c.R_cam_world @ middle,
            )
            for c in scene.cameras
        ]

    here, there = about_the_middle(np.eye(3)), about_the_middle(Y_UP)
    assert share_in_view(centred, there) == 1.0
    assert is_of_world_before(centred, photos, there, here) is True
    assert is_of_world_before(centred, photos, here, there) is False
    assert is_of_world_before(centred, photos[:1], here[:1], there[:1]) is None
    assert is_of_world_before(centred, photos, here, here) is None


def test_a_file_of_moved_cameras_is_put_into_the_mesh_s_world_or_left_as_it_is(
    scene, tmp_path
):
    names = [photo.name for photo in scene.photos]
    before = dict(zip(names, scene.cameras, strict=True))
    write_moved(tmp_path / "transforms.json", before)
    file = read_cameras(tmp_path / "transforms.json")
    assert file.moved is not None
    # Without photos, as where cameras are measured, what is in view tells.
    for photos in (scene.photos, ()):
        undone = in_world_of_mesh(scene.mesh, photos, file)
        assert "undone" in undone.notes[0]
        assert undone.moved is None
        for name, camera in before.items():
            np.testing.assert_allclose(undone.cameras[name].P, camera.P, atol=1e-6)
    vertices = SCALE * (scene.mesh.vertices @ TURN[:, :3].T + TURN[:, 3])
    stands = in_world_of_mesh(Mesh(vertices, scene.mesh.faces), scene.photos, file)
    assert "as they stand" in stands.notes[0]
    assert stands.cameras == file.cameras
    other = [dataclasses.replace(scene.photos[0], name="other.jpg")]
    assert in_world_of_mesh(scene.mesh, other, file) is file
