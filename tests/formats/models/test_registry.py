"""GLB and PLY read back by trimesh; a model in the format of the suffix."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from photoreg.errors import OutputError
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.glb import save_textured_glb, textured_glb
from photoreg.formats.models.ply import save_coloured_ply, save_textured_ply
from photoreg.formats.models.registry import TEXTURED_FORMATS, save_textured
from photoreg.formats.models.split_vertices import split_at_seams, vertex_colours
from photoreg.geometry.mesh import Mesh
from photoreg.texture.bake import TexturedMesh, bake_texture
from photoreg.texture.config import TextureConfig
from tests.painted import ball_and_moon, cameras_around, paint, photograph


@pytest.fixture(scope="module")
def textured() -> TexturedMesh:
    mesh, cameras = ball_and_moon(2), cameras_around(2)
    photos = [photograph(mesh, c, f"photo{i}.png") for i, c in enumerate(cameras)]
    return bake_texture(mesh, photos, cameras, TextureConfig(size=512))


def moved(textured: TexturedMesh, offset: np.ndarray) -> TexturedMesh:
    mesh = Mesh(textured.vertices + offset, textured.faces)
    return dataclasses.replace(textured, mesh=mesh)


def read(path: Path) -> Any:
    """The model as trimesh reads it, its vertices not merged."""
    return trimesh.load(path, process=False, force="mesh")


def colour_error(loaded: Any, textured: TexturedMesh, offset: float = 0.0) -> float:
    """Mean error of the texture, read back, at random points of the surface."""
    rng = np.random.default_rng(5)
    face = rng.integers(0, len(loaded.faces), 4000)
    bary = rng.dirichlet([1, 1, 1], 4000)
    points = (bary[:, :, None] * loaded.vertices[loaded.faces[face]]).sum(axis=1)
    uv = (bary[:, :, None] * loaded.visual.uv[loaded.faces[face]]).sum(axis=1)
    material = loaded.visual.material
    image = getattr(material, "baseColorTexture", None) or material.image
    texture = np.asarray(image.convert("RGB")).astype(float)
    height, width = texture.shape[:2]
    x = np.clip(np.floor(uv[:, 0] * width), 0, width - 1).astype(int)
    # Row 0 of the picture is v = 1.
    y = np.clip(np.floor((1.0 - uv[:, 1]) * height), 0, height - 1).astype(int)
    seen = textured.photo_index[y, x] >= 0
    assert seen.sum() > 500
    return float(np.abs(texture[y, x] - paint(points - offset))[seen].mean())


def test_glb_has_the_mesh_s_vertices_first_and_in_order(tmp_path, textured):
    (path,) = save_textured_glb(tmp_path / "a model.glb", textured)
    loaded = read(path)
    n = len(textured.vertices)
    np.testing.assert_allclose(loaded.vertices[:n], textured.vertices, atol=1e-6)
    # Face for face and corner for corner the same surface.
    np.testing.assert_allclose(
        loaded.vertices[loaded.faces], textured.vertices[textured.faces], atol=1e-6
    )
    np.testing.assert_allclose(
        loaded.visual.uv[loaded.faces], textured.corner_uv, atol=1e-6
    )
    # As the file has them: merged into one mesh, trimesh makes its own.
    (model,) = trimesh.load_scene(path, process=False).geometry.values()
    np.testing.assert_allclose(
        np.asarray(model.vertex_normals)[:n], textured.mesh.vertex_normals, atol=1e-5
    )


def test_glb_holds_the_texture_to_the_bit_and_shows_true_colours(tmp_path, textured):
    loaded = read(save_textured_glb(tmp_path / "model.glb", textured)[0])
    image = np.asarray(loaded.visual.material.baseColorTexture.convert("RGB"))
    np.testing.assert_array_equal(image, textured.texture)
    # The nearest texel is up to half a texel off, at up to 40 a texel: mean 1.5 seen.
    error = colour_error(loaded, textured)
    assert error < 4.0, error


def test_glb_with_jpeg_is_smaller_and_nearly_the_same(tmp_path, textured):
    png = save_textured_glb(tmp_path / "png.glb", textured)[0]
    jpeg = save_textured_glb(tmp_path / "jpeg.glb", textured, picture="jpeg")[0]
    assert jpeg.stat().st_size < png.stat().st_size
    assert b'"mimeType":"image/jpeg"' in jpeg.read_bytes().replace(b'": "', b'":"')
    image = np.asarray(read(jpeg).visual.material.baseColorTexture).astype(float)
    error = np.abs(image - textured.texture).mean()
    # Encoded once, at quality 95: 1.2 seen; at Pillow's 75 it would be 3.
    assert error < 2.0, error


def test_glb_keeps_large_coordinates(tmp_path, textured):
    offset = np.array([4.5e6, 5.1e5, 300.0])
    far = moved(textured, offset)
    loaded = read(save_textured_glb(tmp_path / "far.glb", far)[0])
    n = len(far.vertices)
    error = np.abs(loaded.vertices[:n] - far.vertices).max()
    # In single precision as they stand, they would be off by 0.25.
    assert error < 1e-6, error


def test_seams_split_into_vertices_with_one_coordinate_each(textured):
    vertex_index, uv, faces = split_at_seams(textured)
    n = len(textured.vertices)
    np.testing.assert_array_equal(vertex_index[:n], np.arange(n))
    np.testing.assert_array_equal(vertex_index[faces], textured.faces)
    np.testing.assert_array_equal(uv[faces], textured.corner_uv)
    assert len(np.unique(faces)) == len(vertex_index)


def test_textured_ply_keeps_coordinates_order_and_faces_exactly(tmp_path, textured):
    far = moved(textured, np.array([4.5e6, 5.1e5, 300.0]))
    written = save_textured_ply(tmp_path / "my model.ply", far)
    assert [path.name for path in written] == ["my model.ply", "my_model.png"]
    mesh = load_mesh(written[0])
    # trimesh doubles the vertices of textured PLY on reading; the file does not.
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], far.vertices[far.faces])
    header = written[0].read_bytes().split(b"end_header")[0].decode()
    assert "comment TextureFile my_model.png\n" in header
    assert f"element vertex {len(far.vertices)}\n" in header
    assert mesh.corner_uv is not None
    np.testing.assert_allclose(mesh.corner_uv, far.corner_uv, atol=1e-6)


def test_textured_ply_read_back_shows_true_colours(tmp_path, textured):
    loaded = read(save_textured_ply(tmp_path / "model.ply", textured)[0])
    error = colour_error(loaded, textured)
    assert error < 4.0, error


def test_coloured_ply_has_the_true_colour_at_each_seen_vertex(tmp_path, textured):
    (path,) = save_coloured_ply(tmp_path / "model.ply", textured)
    loaded = read(path)
    np.testing.assert_array_equal(loaded.vertices, textured.vertices)
    np.testing.assert_array_equal(loaded.faces, textured.faces)
    written = loaded.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(
        np.column_stack([written[f"n{axis}"] for axis in "xyz"]).reshape(-1, 3),
        textured.mesh.vertex_normals,
        atol=1e-6,
    )
    colours = np.asarray(loaded.visual.vertex_colors)[:, :3]
    np.testing.assert_array_equal(colours, vertex_colours(textured))
    seen = all_around_seen(textured)
    assert seen.sum() > 50
    error = np.abs(colours - paint(textured.vertices))[seen].mean()
    # Bilinear in an atlas of 512 texels: 1.0 seen.
    assert error < 4.0, error


def all_around_seen(textured: TexturedMesh) -> np.ndarray:
    """Vertices whose texel, in each of their charts, a photo sees."""
    height, width = textured.texture.shape[:2]
    uv, owner = textured.atlas.uv, textured.atlas.uv_vertex
    x = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    y = np.clip(((1.0 - uv[:, 1]) * height).astype(int), 0, height - 1)
    seen = np.ones(len(textured.vertices), dtype=bool)
    np.logical_and.at(seen, owner, textured.photo_index[y, x] >= 0)
    return seen


READ_BY_TRIMESH = [suffix for suffix in TEXTURED_FORMATS if suffix != ".usdz"]


@pytest.mark.parametrize("suffix", [*READ_BY_TRIMESH, ".GLB"])
def test_the_suffix_chooses_the_format(tmp_path, textured, suffix):
    written = save_textured(tmp_path / f"m{suffix}", textured)
    assert written[0] == tmp_path / f"m{suffix}"
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert len(read(written[0]).faces) == len(textured.faces)


def test_a_place_that_cannot_be_written_is_refused_and_nothing_is_left(
    tmp_path, textured
):
    for name in ("m.stl", "m", "missing/m.glb", "missing/m.ply"):
        with pytest.raises(OutputError, match="Cannot write"):
            save_textured(tmp_path / name, textured)
    with pytest.raises(OutputError, match=r"into a \.ply"):
        save_textured(tmp_path / "m.glb", textured, at_vertices=True)
    assert list(tmp_path.iterdir()) == []


def test_the_download_is_the_file(tmp_path, textured):
    (path,) = save_textured_glb(tmp_path / "m.glb", textured)
    assert path.read_bytes() == textured_glb(textured)


@pytest.mark.parametrize(
    ("name", "at_vertices"),
    [("a.obj", False), ("a.glb", False), ("a.ply", False), ("b.ply", True)],
)
def test_coordinates_order_and_own_normals_are_kept_in_every_format(
    tmp_path, textured, name, at_vertices
):
    """Normals that are not those of the surface: recomputed ones would show."""
    rng = np.random.default_rng(2)
    own = rng.standard_normal(textured.vertices.shape)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    mesh = dataclasses.replace(textured.mesh, own_normals=own)
    kept = dataclasses.replace(textured, mesh=mesh)
    loaded = load_mesh(save_textured(tmp_path / name, kept, at_vertices)[0])
    n = len(mesh.vertices)
    if name == "a.glb":  # In single precision, and vertices of seams come again behind.
        np.testing.assert_allclose(loaded.vertices[:n], mesh.vertices, atol=1e-6)
        places = loaded.vertices[loaded.faces]
        np.testing.assert_allclose(places, mesh.vertices[mesh.faces], atol=1e-6)
    else:
        np.testing.assert_array_equal(loaded.vertices, mesh.vertices)
        np.testing.assert_array_equal(loaded.faces, mesh.faces)
    assert loaded.own_normals is not None
    error = np.abs(loaded.own_normals[loaded.faces] - own[mesh.faces]).max()
    assert error < 2e-6, error


def test_normals_of_a_placed_glb_are_turned_with_it(tmp_path):
    ball: Any = trimesh.creation.icosphere(subdivisions=1)
    own = np.random.default_rng(3).standard_normal(ball.vertices.shape)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    turn[:3, 3] = [4, 5, 6]
    model = trimesh.Trimesh(
        ball.vertices, ball.faces, vertex_normals=own, process=False
    )
    scene = trimesh.Scene()
    scene.add_geometry(model, transform=turn)
    scene.export(tmp_path / "placed.glb", include_normals=True)
    loaded = load_mesh(tmp_path / "placed.glb")
    assert loaded.own_normals is not None
    np.testing.assert_allclose(loaded.own_normals, own @ turn[:3, :3].T, atol=1e-6)


def soup(mesh: Mesh) -> Mesh:
    """Each triangle with its own three vertices and normals, as in STL."""
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    normals = np.repeat(mesh.face_normals, 3, axis=0)
    return Mesh(vertices, faces, own_normals=normals)


def test_all_vertices_at_a_place_get_its_colour(textured):
    """The soup's vertices have the colours of the mesh's that they are."""
    mesh, cameras = textured.mesh, cameras_around(2)
    photos = [photograph(mesh, c, f"photo{i}.png") for i, c in enumerate(cameras)]
    apart = bake_texture(soup(mesh), photos, cameras, textured.config)
    expected = vertex_colours(textured)[mesh.faces].reshape(-1, 3).astype(int)
    error = np.abs(vertex_colours(apart) - expected)
    # A vertex on a chart's border has the mean of its charts in the one, and its own
    # chart's colour in the other; levels of one texel.
    assert np.percentile(error, 95) <= 8, np.percentile(error, [50, 95, 100])
    assert (vertex_colours(apart) == 128).all(axis=1).mean() < 0.01


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_vertices_at_a_place_keep_their_own_normals(tmp_path, textured, suffix):
    apart = soup(textured.mesh)
    cameras = cameras_around(2)
    photos = [photograph(apart, c, f"photo{i}.png") for i, c in enumerate(cameras)]
    baked = bake_texture(apart, photos, cameras, textured.config)
    loaded = load_mesh(save_textured(tmp_path / f"m{suffix}", baked)[0])
    assert loaded.own_normals is not None
    assert apart.own_normals is not None
    error = np.abs(loaded.own_normals[loaded.faces] - apart.own_normals[apart.faces])
    assert error.max() < 1e-5, error.max()
