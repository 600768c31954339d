"""USDZ, read back by OpenUSD itself and judged by its validators."""

import dataclasses
import importlib.util
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from photoreg.errors import OutputError
from photoreg.formats.mark import is_marked
from photoreg.formats.models.registry import save_textured, textured_files
from photoreg.geometry.mesh import Mesh
from photoreg.texture.bake import TexturedMesh, bake_texture
from photoreg.texture.config import TextureConfig
from tests.painted import ball_and_moon, cameras_around, photograph

FAR = np.array([4.5e6, 5.1e5, 300.0])


@pytest.fixture(scope="module")
def textured() -> TexturedMesh:
    mesh, cameras = ball_and_moon(2), cameras_around(2)
    photos = [photograph(mesh, c, f"photo{i}.png") for i, c in enumerate(cameras)]
    return bake_texture(mesh, photos, cameras, TextureConfig(size=256))


def pxr(name: str) -> Any:
    return importlib.import_module(f"pxr.{name}")


def read(path: Path) -> tuple[Any, np.ndarray, Any]:
    """The stage, the mesh's vertices in the world, and the mesh."""
    stage = pxr("Usd").Stage.Open(str(path))
    (prim,) = [p for p in stage.Traverse() if p.IsA(pxr("UsdGeom").Mesh)]
    mesh = pxr("UsdGeom").Mesh(prim)
    to_world = np.array(pxr("UsdGeom").XformCache().GetLocalToWorldTransform(prim))
    points = np.array(mesh.GetPointsAttr().Get(), dtype=np.float64)
    # USD multiplies rows by matrices.
    return stage, points @ to_world[:3, :3] + to_world[3, :3], mesh


@pytest.mark.parametrize("offset", [np.zeros(3), FAR])
def test_usd_reads_the_mesh_s_own_vertices_faces_and_texture_coordinates(
    tmp_path, textured, offset
):
    mesh = Mesh(textured.vertices + offset, textured.faces)
    model = dataclasses.replace(textured, mesh=mesh)
    (path,) = save_textured(tmp_path / "a model.usdz", model)
    stage, vertices, found = read(path)
    # In single precision as they stand, the far ones would be off by 0.25.
    assert np.abs(vertices - mesh.vertices).max() < 1e-6
    indices = np.array(found.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    np.testing.assert_array_equal(indices, mesh.faces)
    st = pxr("UsdGeom").PrimvarsAPI(found).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    corner_uv = np.array(st.ComputeFlattened()).reshape(-1, 3, 2)
    np.testing.assert_allclose(corner_uv, textured.corner_uv, atol=1e-6)
    normals = np.array(found.GetNormalsAttr().Get())
    np.testing.assert_allclose(normals, mesh.vertex_normals, atol=1e-6)
    assert found.GetSubdivisionSchemeAttr().Get() == "none"
    assert stage.GetDefaultPrim().GetName() == "model"
    assert is_marked(path)


@pytest.mark.parametrize(("picture", "suffix"), [("png", ".png"), ("jpeg", ".jpg")])
def test_the_material_shows_the_texture_that_is_packed(
    tmp_path, textured, picture, suffix
):
    (path,) = save_textured(tmp_path / "m.usdz", textured, picture=picture)
    stage, _, mesh = read(path)
    shade = pxr("UsdShade")
    material, _ = shade.MaterialBindingAPI(mesh.GetPrim()).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    assert surface.GetIdAttr().Get() == "UsdPreviewSurface"
    image = shade.Shader(
        surface.GetInput("diffuseColor").GetConnectedSources()[0][0].source
    )
    # The package's own file, found by USD's resolver.
    assert image.GetInput("file").Get().resolvedPath.endswith(f"texture{suffix}]")
    with zipfile.ZipFile(path) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(suffix)]
        pixels = np.asarray(Image.open(io.BytesIO(archive.read(name))).convert("RGB"))
    error = np.abs(pixels.astype(int) - textured.texture).mean()
    assert error == 0.0 if picture == "png" else error < 2.5, error
    del stage


def test_openusd_s_validators_find_nothing_wrong(tmp_path, textured):
    (path,) = save_textured(tmp_path / "m.usdz", textured)
    validation = pxr("UsdValidation")
    registry = validation.ValidationRegistry()
    names = [m.name for m in registry.GetAllValidatorMetadata() if not m.isSuite]
    assert "usdUtilsValidators:UsdzPackageValidator" in names
    context = validation.ValidationContext(registry.GetOrLoadValidatorsByName(names))
    stage = pxr("Usd").Stage.Open(str(path))
    errors = [error.GetMessage() for error in context.Validate(stage)]
    assert errors == []


def test_the_file_is_a_function_of_the_model(tmp_path, textured):
    contents = [
        save_textured(tmp_path / f"{i}.usdz", textured)[0].read_bytes()
        for i in range(2)
    ]
    assert contents[0] == contents[1]


def test_without_usd_core_it_is_refused_in_a_sentence(tmp_path, textured, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    for attempt in (
        lambda: textured_files(tmp_path / "m.usdz"),
        lambda: save_textured(tmp_path / "m.usdz", textured),
    ):
        with pytest.raises(OutputError, match="extra `usd`, or write a GLB"):
            attempt()
