"""The textured model as the worker makes it for download and preview."""

import dataclasses
import io
import zipfile
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import trimesh

from app.engine.bake_job import BakeJob
from app.engine.warm_up import toy_scene
from app.model.camera_moves import rolled
from app.model.messages import Bake, Baked, Working
from app.model.state import ModelChoice, Texture
from photoreg.errors import InputError
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.texture.atlas import make_atlas
from photoreg.texture.config import TextureConfig
from tests.scenes import small_scene


def toy_job(
    config: TextureConfig | None = None,
) -> tuple[Mesh, Sequence[Photo], Bake]:
    mesh, photos, cameras = toy_scene()
    return mesh, photos, Bake(cameras, config or TextureConfig())


@pytest.fixture(scope="module")
def baker() -> BakeJob:
    return BakeJob()


@pytest.fixture(scope="module")
def baked(baker) -> Texture:
    *steps, model = baker.bake(*toy_job())
    fractions = [step.fraction for step in steps if isinstance(step, Working)]
    assert fractions == sorted(fractions)
    assert isinstance(model, Baked)
    return model.texture


def test_the_preview_is_the_model_in_page_axes_with_texture(baked):
    loaded: Any = trimesh.load(
        io.BytesIO(baked.glb), file_type="glb", force="mesh", process=False
    )
    assert len(loaded.faces) == len(toy_scene()[0].faces)
    low, high = loaded.bounds
    assert np.linalg.norm(high - low) == pytest.approx(2.0, rel=1e-6)
    assert low + high == pytest.approx(np.zeros(3), abs=1e-6)
    uv = np.asarray(loaded.visual.uv)
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    picture = np.asarray(loaded.visual.material.baseColorTexture)
    assert picture.std() > 10.0, "the texture should not be of one colour"


@pytest.mark.parametrize(
    ("choice", "name", "files"),
    [
        (ModelChoice(), "rock-textured.zip", ["rock.mtl", "rock.obj", "rock.png"]),
        (
            ModelChoice("ply", "jpeg"),
            "rock-textured.zip",
            ["rock.jpg", "rock.ply"],
        ),
    ],
)
def test_the_archive_holds_files_named_after_the_mesh(
    baker, baked, choice, name, files
):
    packed = baker.pack(choice)
    assert packed.name == name
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        assert archive.testzip() is None
        assert sorted(archive.namelist()) == files


@pytest.mark.parametrize("format", ["glb", "coloured ply"])
def test_a_model_of_one_file_is_not_zipped(baker, baked, format):
    packed = baker.pack(ModelChoice(format))
    suffix = format.split()[-1]
    assert packed.name == f"rock.{suffix}"
    loaded: Any = trimesh.load(
        io.BytesIO(packed.content), file_type=suffix, force="mesh", process=False
    )
    assert len(loaded.faces) == len(toy_scene()[0].faces)


def test_usdz_is_one_file(baker, baked):
    packed = baker.pack(ModelChoice("usdz"))
    assert packed.name == "rock.usdz"
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        assert archive.namelist()[0].endswith(".usdc")


def test_without_a_texture_there_is_nothing_to_pack():
    with pytest.raises(InputError, match="Make it first"):
        BakeJob().pack(ModelChoice())


def test_baking_that_is_left_keeps_the_model_from_before(baked):
    baker = BakeJob()
    list(baker.bake(*toy_job()))
    before = baker.pack(ModelChoice("glb")).content
    steps = baker.bake(*toy_job(TextureConfig(size=256)))
    assert isinstance(next(steps), Working)
    steps.close()
    assert baker.pack(ModelChoice("glb")).content == before


def test_the_model_s_own_layout_is_kept_by_choice():
    mesh, photos, cameras = toy_scene()
    own = make_atlas(mesh)
    laid_out = dataclasses.replace(mesh, corner_uv=own.uv[own.uv_faces])
    baker = BakeJob()
    for keep, words in ((True, "laid out as the mesh's own"), (False, "laid out anew")):
        config = TextureConfig(size=256, keep_uv=keep)
        *_, made = baker.bake(laid_out, photos, Bake(cameras, config))
        assert isinstance(made, Baked)
        assert words in made.texture.summary


def test_the_shares_of_the_photos_are_told_with_colours_that_differ(baked):
    names = [photo.name for photo in toy_scene()[1]]
    assert [name for name, _, _ in baked.coverage] == names
    shares = [share for _, share, _ in baked.coverage]
    assert min(shares) > 0.05
    assert f"cover {100 * sum(shares):.0f} %" in baked.summary
    assert len({colour for _, _, colour in baked.coverage}) == len(names)


def test_the_model_remembers_the_cameras_it_was_made_with(baked):
    cameras = toy_scene()[2]
    assert all(
        np.array_equal(a.P, b.P) for a, b in zip(baked.cameras, cameras, strict=True)
    )


def test_cameras_of_another_world_and_unconvincing_ones_are_told_as_in_the_command_line():
    scene = small_scene()
    mesh, photos, cameras = scene.mesh, scene.photos, scene.cameras
    # In OpenGL's axes, they look away.
    flip = np.diag([1.0, -1.0, -1.0])
    away = [
        dataclasses.replace(
            camera,
            R_cam_world=flip @ camera.R_cam_world,
            t_cam_world=flip @ camera.t_cam_world,
        )
        for camera in cameras
    ]
    baker = BakeJob()
    with pytest.raises(InputError, match="OpenGL"):
        list(baker.bake(mesh, photos, Bake(tuple(away))))
    moved = (rolled(cameras[0], 9.0), cameras[1])
    *_, baked = baker.bake(mesh, photos, Bake(moved))
    assert isinstance(baked, Baked)
    assert baked.texture.doubts[0].startswith("Unconvincing: ")
    assert baked.texture.took_s > 0.0
    *_, baked = baker.bake(mesh, photos, Bake(cameras))
    assert isinstance(baked, Baked)
    assert baked.texture.doubts == ()


def test_a_model_is_told_by_its_mesh_its_cameras_its_settings_and_its_masks():
    mesh, photos, cameras = toy_scene()
    config, masks = TextureConfig(size=256), "one"
    baker, job = BakeJob(), Bake(cameras, config, masks)
    assert not baker.has(mesh, job)
    *_, baked = baker.bake(mesh, photos, job)
    assert isinstance(baked, Baked)
    assert baked.texture.masks == masks
    same = dataclasses.replace(mesh, vertices=mesh.vertices.copy())
    assert baker.has(same, Bake(cameras, TextureConfig(size=256), "one"))
    assert not baker.has(mesh, Bake(cameras[::-1], config, masks))
    assert not baker.has(mesh, Bake(cameras[:1], config, masks))
    assert not baker.has(mesh, Bake(cameras, TextureConfig(size=512), masks))
    assert not baker.has(mesh, Bake(cameras, config, "other"))
    other = dataclasses.replace(mesh, vertices=mesh.vertices + 1e-3)
    assert not baker.has(other, job)
