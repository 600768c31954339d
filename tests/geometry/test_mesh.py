import collections
import pickle

import numpy as np
import pytest
import trimesh
from PIL import Image

from photoreg.errors import InputError
from photoreg.formats.meshes.read import MESH_SUFFIXES, load_mesh
from photoreg.geometry.mesh import Mesh


@pytest.fixture(scope="module")
def sphere() -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=2.0)
    return Mesh(ball.vertices + np.array([10.0, -4.0, 3.0]), ball.faces)


def tetrahedron(folder, suffix=".ply"):
    path = folder / f"mesh{suffix}"
    corners = [[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    trimesh.Trimesh(corners, faces, process=False).export(path)
    return path


def test_normals_point_outwards_and_vertex_normals_are_radial(sphere):
    radial = sphere.vertices - [10.0, -4.0, 3.0]
    radial /= np.linalg.norm(radial, axis=1, keepdims=True)
    assert (sphere.vertex_normals * radial).sum(axis=1).min() > 0.999


def test_area_and_centroid_of_a_sphere(sphere):
    assert sphere.area == pytest.approx(4 * np.pi * 4, rel=3e-3)
    assert sphere.centroid == pytest.approx([10.0, -4.0, 3.0], abs=1e-9)
    assert sphere.diagonal == pytest.approx(4 * np.sqrt(3), rel=1e-9)


def test_first_hits_meets_the_near_side_at_the_right_distance(sphere):
    origins = np.array([[10.0, -4.0, 13.0], [10.0, -4.0, 13.0]])
    directions = np.array([[0.0, 0.0, -2.0], [0.0, 0.0, 2.0]])
    face, distance = sphere.first_hits(origins, directions)
    # Distances are counted in lengths of the direction: 8 units at length 2 is 4.
    assert distance[0] == pytest.approx(4.0, abs=2e-3)
    assert sphere.face_normals[face[0], 2] > 0.99
    assert face[1] == -1
    assert np.isinf(distance[1])


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_the_far_side_is_occluded_in_any_unit(sphere, unit):
    mesh = Mesh(sphere.vertices * unit, sphere.faces)
    viewpoint = np.array([10.0, -4.0, 103.0]) * unit
    seen = mesh.is_unoccluded(mesh.vertices, viewpoint)
    to_eye = viewpoint - mesh.vertices
    cosine = (mesh.vertex_normals * to_eye).sum(axis=1) / np.linalg.norm(to_eye, axis=1)
    assert seen[cosine > 0.05].all()
    assert not seen[cosine < -0.05].any()


def test_a_thin_wall_hides_its_other_side_and_not_its_own():
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    behind = np.array([0.0, 0.0, 5e-4 * np.sqrt(8.0)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    wall = Mesh(
        np.concatenate([square, square - behind]),
        np.concatenate([faces, faces + 4]),
    )
    inside = 0.9 * square
    for distance in (3.0, 100.0 * wall.diagonal):
        viewpoint = np.array([0.3, 0.2, distance])
        assert wall.is_unoccluded(inside, viewpoint).all()
        assert not wall.is_unoccluded(inside - behind, viewpoint).any()


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_every_format_gives_the_same_surface(tmp_path, suffix):
    mesh = load_mesh(tetrahedron(tmp_path, suffix))
    assert len(mesh.vertices) == 4
    assert len(mesh.faces) == 4
    assert mesh.area == pytest.approx(1.5 + np.sqrt(3) / 2, rel=1e-6)
    assert mesh.centroid @ np.ones(3) > 0
    outwards = mesh.face_normals @ np.ones(3)
    assert np.sort(outwards) == pytest.approx([-1, -1, -1, np.sqrt(3)], abs=1e-6)


def test_vertex_order_and_coordinates_survive_loading(tmp_path):
    path = tmp_path / "mesh.obj"
    path.write_text(
        "v 100 0 0\nv 7 7 7\nv 101 0 0\nv 100 1 0\nv 100 0 1\n"
        "f 1 3 4\nf 1 4 5\nf 1 5 3\nf 3 5 4\n"
    )
    mesh = load_mesh(path)
    expected = [[100, 0, 0], [7, 7, 7], [101, 0, 0], [100, 1, 0], [100, 0, 1]]
    assert mesh.vertices.tolist() == expected
    # A vertex that no face uses stretches nothing.
    assert mesh.bounds.tolist() == [[100, 0, 0], [101, 1, 1]]


def test_texture_coordinates_are_kept_by_corner_along_a_seam(tmp_path):
    path = tmp_path / "seam.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .5 .5\n"
        "f 1/1 2/2 3/3\nf 1/5 3/4 4/1\n"
    )
    mesh = load_mesh(path)
    assert len(mesh.vertices) == 4
    expected = [[[0, 0], [1, 0], [1, 1]], [[0.5, 0.5], [0, 1], [0, 0]]]
    assert mesh.corner_uv is not None
    assert mesh.corner_uv.tolist() == expected


def test_normals_are_smooth_where_a_file_repeats_a_vertex():
    vertices = np.array(
        [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 1]]
    )
    mesh = Mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]]))
    assert mesh.position_index.tolist() == [0, 1, 2, 0, 2, 5]
    assert np.array_equal(mesh.vertex_normals, mesh.vertex_normals[mesh.position_index])
    assert not np.array_equal(mesh.vertex_normals[0], mesh.face_normals[0])


def test_a_pickled_mesh_is_the_same_mesh(sphere):
    sphere.first_hits(np.zeros((1, 3)), np.ones((1, 3)))
    back = pickle.loads(pickle.dumps(sphere))
    assert np.array_equal(back.vertices, sphere.vertices)
    assert back.area == sphere.area


def test_decimated_keeps_the_shape_and_never_adds_faces(sphere):
    coarse = sphere.decimated(600)
    assert len(coarse.faces) <= 600
    assert coarse.area == pytest.approx(sphere.area, rel=0.02)
    assert sphere.decimated(10**6) is sphere


@pytest.mark.parametrize("side", [1, 2, 4])
def test_a_mesh_of_loose_pieces_is_decimated_as_far(side):
    cracked = loose_pieces(60 // side, side)
    coarse = cracked.decimated(1000)
    assert 500 < len(coarse.faces) <= 1100, f"{len(coarse.faces)} faces"
    assert coarse.area == pytest.approx(cracked.area, rel=0.05)
    low, high = cracked.bounds
    assert np.abs(coarse.bounds - [low, high]).max() < 0.05, "all of it is there"


def loose_pieces(n: int, side: int) -> Mesh:
    """A wavy sheet of n x n pieces of side x side squares, a little out of place."""
    rng, steps = np.random.default_rng(0), np.arange(side + 1)
    i, j = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
    a = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    below = a + side + 1
    squares = np.concatenate(
        [np.column_stack([a, a + 1, below + 1]), np.column_stack([a, below + 1, below])]
    )
    vertices, faces = [], []
    for k in range(n * n):
        x, y = (k // n + i / side) / n, (k % n + j / side) / n
        sheet = np.column_stack([x, y, 0.05 * np.sin(9 * x) * np.cos(7 * y)])
        vertices.append(sheet + 1e-4 * rng.normal(size=3))
        faces.append(squares + k * len(i))
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.ply", b"", "empty"),
        ("no-faces.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("nan.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "zero area"),
        ("text.ply", b"this is not a mesh at all\n", "could not be read"),
        ("text.glb", b"this is not a mesh at all\n", "could not be read"),
        ("mesh.docx", b"whatever", "suffix"),
    ],
)
def test_an_unusable_mesh_is_refused_in_words(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        load_mesh(path)
    assert name in str(caught.value)


def test_a_missing_mesh_is_named(tmp_path):
    with pytest.raises(InputError, match=r"shell\.ply does not exist"):
        load_mesh(tmp_path / "shell.ply")


def test_faces_that_name_missing_vertices_are_refused():
    with pytest.raises(InputError, match="vertex 9"):
        Mesh(np.eye(3), np.array([[0, 1, 9]]))


def test_an_obj_s_texture_and_normals_are_kept(tmp_path):
    picture = np.arange(48, dtype=np.uint8).reshape(4, 4, 3) * 5
    Image.fromarray(picture).save(tmp_path / "t.png")
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd t.png\n")
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"
        "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0.6 0.8\nvn 0 0 1\nvn 1 0 0\n"
        "f 1/1/1 2/2/2 3/3/3\n"
    )
    mesh = load_mesh(tmp_path / "m.obj")
    np.testing.assert_array_equal(mesh.own_texture, picture)
    expected = [[0, 0.6, 0.8], [0, 0, 1], [1, 0, 0]]
    np.testing.assert_allclose(mesh.normals_to_keep, expected, atol=1e-7)


def test_a_ply_s_colours_and_normals_are_kept(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    colours = np.random.default_rng(1).integers(0, 256, (42, 4), dtype=np.uint8)
    trimesh.Trimesh(
        ball.vertices,
        ball.faces,
        vertex_normals=-ball.vertices,
        vertex_colors=colours,
        process=False,
    ).export(tmp_path / "m.ply", vertex_normal=True)
    mesh = load_mesh(tmp_path / "m.ply")
    np.testing.assert_array_equal(mesh.vertex_colours, colours[:, :3])
    np.testing.assert_allclose(mesh.normals_to_keep, -ball.vertices, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_border_faces_are_those_with_an_edge_of_their_own(seed):
    rng = np.random.default_rng(seed)
    whole = trimesh.creation.icosphere(subdivisions=2)
    faces = whole.faces[rng.random(len(whole.faces)) < 0.9]
    # A seam is no border: some faces get vertices of their own at the same places.
    vertices = np.concatenate([whole.vertices, whole.vertices])
    faces = np.where(rng.random(len(faces))[:, None] < 0.3, faces + 162, faces)
    edges = collections.Counter(
        frozenset((face[k] % 162, face[k - 1] % 162))
        for face in faces
        for k in range(3)
    )
    expected = [
        any(edges[frozenset((face[k] % 162, face[k - 1] % 162))] == 1 for k in range(3))
        for face in faces
    ]
    assert any(expected)
    assert not all(expected)
    assert (Mesh(vertices, faces).is_border_face == expected).all()


def test_a_closed_mesh_has_no_border_faces():
    whole = trimesh.creation.icosphere(subdivisions=1)
    assert not Mesh(whole.vertices, whole.faces).is_border_face.any()
