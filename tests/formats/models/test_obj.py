"""Textured OBJ, read back by trimesh: another program's idea of the format."""

import io
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from photoreg.errors import OutputError
from photoreg.formats.models.obj import save_textured_obj
from photoreg.formats.models.registry import textured_download
from photoreg.texture.bake import bake_texture
from photoreg.texture.config import TextureConfig
from tests.painted import ball_and_moon, cameras_around, paint, photograph


@pytest.fixture(scope="module")
def textured():
    mesh, cameras = ball_and_moon(2), cameras_around(2)
    photos = [photograph(mesh, c, f"photo{i}.png") for i, c in enumerate(cameras)]
    return bake_texture(mesh, photos, cameras, TextureConfig(size=512))


def read(path: Path) -> Any:
    return trimesh.load(path, process=False, force="mesh")


def lines(path: Path, key: str) -> list[list[str]]:
    rows = [line.split() for line in path.read_text().splitlines()]
    return [row[1:] for row in rows if row and row[0] == key]


def test_vertices_keep_their_order_and_every_digit(tmp_path, textured):
    obj = save_textured_obj(tmp_path / "model.obj", textured)[0]
    written = np.array(lines(obj, "v"), dtype=np.float64)
    np.testing.assert_array_equal(written, textured.vertices)
    faces = [[int(c.split("/")[0]) - 1 for c in row] for row in lines(obj, "f")]
    np.testing.assert_array_equal(faces, textured.faces)


def test_normals_are_those_of_the_surface(tmp_path, textured):
    obj = save_textured_obj(tmp_path / "model.obj", textured)[0]
    written = np.array(lines(obj, "vn"), dtype=np.float64)
    np.testing.assert_allclose(written, textured.mesh.vertex_normals, atol=1e-6)


def test_a_reader_finds_the_texture_and_coordinates_in_range(tmp_path, textured):
    obj = save_textured_obj(tmp_path / "model.obj", textured)[0]
    loaded = read(obj)
    uv = loaded.visual.uv
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    image = np.asarray(loaded.visual.material.image.convert("RGB"))
    np.testing.assert_array_equal(image, textured.texture)


def test_surface_points_read_back_have_the_true_colours(tmp_path, textured):
    loaded = read(save_textured_obj(tmp_path / "model.obj", textured)[0])
    rng = np.random.default_rng(5)
    face = rng.integers(0, len(loaded.faces), 4000)
    bary = rng.dirichlet([1, 1, 1], 4000)
    points = (bary[:, :, None] * loaded.vertices[loaded.faces[face]]).sum(axis=1)
    uv = (bary[:, :, None] * loaded.visual.uv[loaded.faces[face]]).sum(axis=1)
    height, width = textured.texture.shape[:2]
    x = np.clip(np.floor(uv[:, 0] * width), 0, width - 1).astype(int)
    # Row 0 of the picture is v = 1.
    y = np.clip(np.floor((1.0 - uv[:, 1]) * height), 0, height - 1).astype(int)
    seen = textured.photo_index[y, x] >= 0
    assert seen.sum() > 500
    error = np.abs(textured.texture[y, x] - paint(points))[seen]
    # The nearest texel is up to half a texel off, at up to 40 a texel: mean 1.5 seen.
    assert error.mean() < 4.0, error.mean()


def test_files_refer_to_each_other_by_names_without_spaces(tmp_path, textured):
    written = save_textured_obj(tmp_path / "my old shell.obj", textured)
    assert [path.name for path in written] == [
        "my old shell.obj",
        "my_old_shell.mtl",
        "my_old_shell.png",
    ]
    assert lines(written[0], "mtllib") == [["my_old_shell.mtl"]]
    assert lines(written[1], "map_Kd") == [["my_old_shell.png"]]
    assert read(written[0]).visual.material.image is not None


def test_the_folder_holds_only_the_three_files(tmp_path, textured):
    written = save_textured_obj(tmp_path / "model.obj", textured)
    save_textured_obj(tmp_path / "model.obj", textured)
    assert sorted(tmp_path.iterdir()) == sorted(written)


def test_the_zip_holds_the_same_three_files(tmp_path, textured):
    written = save_textured_obj(tmp_path / "model.obj", textured)
    name, content = textured_download("model.obj", textured)
    assert name == "model-textured.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        contents = {name: archive.read(name) for name in archive.namelist()}
    assert contents == {path.name: path.read_bytes() for path in written}


@pytest.mark.parametrize("name", ["model.stl", "missing/model.obj", "folder.obj"])
def test_a_place_that_cannot_be_written_is_refused_and_nothing_is_left(
    tmp_path, textured, name
):
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(OutputError, match="Cannot write"):
        save_textured_obj(tmp_path / name, textured)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.obj"]


def test_a_failure_half_way_leaves_the_old_files(tmp_path, textured, monkeypatch):
    old = save_textured_obj(tmp_path / "model.obj", textured)
    before = [path.read_bytes() for path in old]
    sync, synced = os.fsync, []

    def full_disk(descriptor):
        synced.append(descriptor)
        if len(synced) == 3:
            raise OSError(28, "No space left on device")
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OutputError, match="No space left"):
        save_textured_obj(tmp_path / "model.obj", textured)
    assert sorted(tmp_path.iterdir()) == sorted(old)
    assert [path.read_bytes() for path in old] == before
