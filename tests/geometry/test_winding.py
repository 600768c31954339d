"""Meshes wound in every way are seen alike; those wound rightly are left to the bit."""

import dataclasses

import numpy as np
import pytest
import trimesh

from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.ply import save_mesh
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface
from photoreg.geometry.visibility import visible
from photoreg.geometry.winding import consistently_wound, facing_cameras
from photoreg.registration.check_readiness import check_readiness
from photoreg.texture.bake import bake_texture
from photoreg.texture.config import TextureConfig
from tests.painted import ball_and_moon, cameras_around, photograph


@pytest.fixture(scope="module")
def mesh():
    return ball_and_moon(2)


def relief() -> Mesh:
    """An open scan: a bent sheet above the plane z = 0, its outside up."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-1, 1, 21)]))
    at = np.arange(21 * 21).reshape(21, 21)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    faces = np.stack([a, b, c, b, d, c], axis=-1).reshape(-1, 3)
    return Mesh(np.column_stack([x, y, 0.2 * np.cos(2 * x) * np.cos(y)]), faces)


def at_random(mesh: Mesh, seed: int = 0) -> Mesh:
    turned = np.random.default_rng(seed).random(len(mesh.faces)) < 0.5
    return dataclasses.replace(
        mesh, faces=np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    )


def soup(mesh: Mesh) -> Mesh:
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


def two_sided(mesh: Mesh, seed: int = 1) -> Mesh:
    """Each face twice, once turned, in any order."""
    faces = np.vstack([mesh.faces, mesh.faces[:, ::-1]])
    return Mesh(mesh.vertices, np.random.default_rng(seed).permutation(faces))


def agreement(one: Mesh, other: Mesh) -> np.ndarray:
    return np.einsum("mi,mi->m", one.face_normals, other.face_normals)


def test_what_is_wound_rightly_is_the_same_object(mesh):
    box = trimesh.creation.box()
    blocks = Mesh(
        np.vstack([box.vertices, box.vertices + np.array([0, 0, 1])]),
        np.vstack([box.faces, box.faces + len(box.vertices)]),
    )
    again = Mesh(mesh.vertices, np.vstack([mesh.faces, mesh.faces]))
    for sound in (mesh, soup(mesh), relief(), blocks, again):
        assert consistently_wound(sound) is sound
    assert facing_cameras(mesh, cameras_around(3)) is mesh


@pytest.mark.parametrize("make", [lambda m: m, soup])
def test_faces_wound_at_random_come_out_outwards(mesh, make):
    sound = make(mesh)
    wound = consistently_wound(at_random(sound))
    assert agreement(wound, sound).min() > 0.999
    assert "were wound the other way than their neighbours" in wound.notes[0]


def test_a_few_faces_wound_wrongly_are_turned_and_counted():
    sound = relief()
    faces = sound.faces.copy()
    faces[[5, 100, 101]] = faces[[5, 100, 101], ::-1]
    wound = consistently_wound(dataclasses.replace(sound, faces=faces))
    assert agreement(wound, sound).min() > 0.999
    assert wound.notes[0].startswith("3 of its faces")


def test_most_of_an_inward_part_keeps_it_inwards_until_cameras_tell():
    inwards = dataclasses.replace(relief(), faces=relief().faces[:, ::-1])
    assert consistently_wound(inwards) is inwards
    above = Camera.look_at([0.5, 0.4, 4], [0, 0, 0], [0, 1, 0], 300, 320, 240)
    assert agreement(facing_cameras(inwards, [above]), relief()).min() > 0.999
    below = Camera.look_at([0.5, 0.4, -4], [0, 0, 0], [0, 1, 0], 300, 320, 240)
    assert facing_cameras(inwards, [below]) is inwards


def test_texture_coordinates_turn_with_their_faces(mesh):
    uv = np.random.default_rng(3).random((len(mesh.faces), 3, 2))
    of_place = {
        tuple(corner): tuple(at)
        for face, corners in zip(mesh.faces, uv, strict=True)
        for corner, at in zip([(*face, i) for i in face], corners, strict=True)
    }
    own = dataclasses.replace(mesh, corner_uv=uv)
    turned = np.arange(len(mesh.faces)) % 2 == 0
    order = np.where(turned[:, None], [2, 1, 0], [0, 1, 2])
    mixed = dataclasses.replace(
        own,
        faces=np.take_along_axis(own.faces, order, 1),
        corner_uv=np.take_along_axis(uv, order[..., None], 1),
    )
    wound = consistently_wound(mixed)
    assert wound.corner_uv is not None
    for face, whole, corners in zip(
        wound.faces, mesh.faces, wound.corner_uv, strict=True
    ):
        for i, at in zip(face, corners, strict=True):
            assert of_place[(*whole, i)] == tuple(at)


def test_a_part_wound_inwards_among_others_is_turned_for_cameras(mesh):
    ball = len(trimesh.creation.icosphere(subdivisions=2).faces)
    faces = mesh.faces.copy()
    faces[ball:] = faces[ball:, ::-1]
    mixed = Mesh(mesh.vertices, faces)
    facing = facing_cameras(mixed, cameras_around(2))
    assert agreement(facing, mesh).min() > 0.999
    np.testing.assert_array_equal(
        facing.first_hits(np.tile([9.0, 0, 0], (1, 1)), np.array([[-1.0, 0, 0]]))[0],
        mesh.first_hits(np.tile([9.0, 0, 0], (1, 1)), np.array([[-1.0, 0, 0]]))[0],
    )


def test_a_mesh_made_in_memory_at_random_faces_the_cameras(mesh):
    facing = facing_cameras(at_random(mesh), cameras_around(2))
    assert agreement(facing, mesh).min() > 0.999


def test_a_moebius_strip_is_left_and_named():
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rim = [
        np.column_stack(
            [
                (2 + w * np.cos(turn / 2)) * np.cos(turn),
                (2 + w * np.cos(turn / 2)) * np.sin(turn),
                w * np.sin(turn / 2),
            ]
        )
        for w in (-0.5, 0.5)
    ]
    i, j = np.arange(40), (np.arange(40) + 1) % 40
    left, right = i, i + 40
    next_left = np.where(j == 0, 40, j)
    next_right = np.where(j == 0, 0, j + 40)
    faces = np.vstack(
        [
            np.column_stack([left, right, next_right]),
            np.column_stack([left, next_right, next_left]),
        ]
    )
    strip = Mesh(np.vstack(rim), faces)
    wound = consistently_wound(strip)
    np.testing.assert_array_equal(wound.faces, strip.faces)
    assert "cannot be wound as their neighbours" in wound.notes[0]


WINDINGS = {
    "inside out": lambda m: Mesh(m.vertices, m.faces[:, ::-1]),
    "at random": at_random,
    "two-sided": two_sided,
    "a soup at random": lambda m: at_random(soup(m)),
    "a two-sided soup": lambda m: soup(two_sided(m)),
}


@pytest.mark.parametrize("kind", WINDINGS)
def test_every_winding_is_seen_by_refine_and_texture_alike(mesh, kind, tmp_path):
    cameras = cameras_around(2, 240, 180)
    photos = [photograph(mesh, c, f"p{i}.png") for i, c in enumerate(cameras)]
    save_mesh(tmp_path / "m.ply", WINDINGS[kind](mesh))
    read = load_mesh(tmp_path / "m.ply")
    samples = sample_surface(facing_cameras(read, cameras), 2000, 0)
    seen = visible(samples, cameras, read, "rays").mean()
    expected = visible(sample_surface(mesh, 2000, 0), cameras, mesh, "rays").mean()
    assert seen == pytest.approx(expected, abs=0.02)
    assert check_readiness(read, photos, cameras).overlap == pytest.approx(
        check_readiness(mesh, photos, cameras).overlap, abs=0.05
    )
    config = TextureConfig(size=256)
    share = bake_texture(read, photos, cameras, config).seen_share
    assert share == pytest.approx(
        bake_texture(mesh, photos, cameras, config).seen_share, abs=0.02
    )
