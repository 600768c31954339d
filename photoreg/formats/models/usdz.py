"""Textured USDZ, by usd-core (extra ``usd``): one file for Apple's devices, Blender, USD.

The mesh's vertices and faces are in their own order, texture coordinates at the corners of
faces. USD holds coordinates in single precision: where they are large for the mesh's size,
they are written from its middle, and a transform in double precision moves them back. Like
GLB, the file says that y is up and the unit a metre: what the mesh's are is not known.

References:
    https://openusd.org/release/spec_usdz.html, https://openusd.org/release/spec_usdpreviewsurface.html
"""

import importlib
import importlib.util
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.errors import OutputError
from photoreg.formats.mark import USDZ_LAYER
from photoreg.formats.models.encode_texture import (
    PICTURE_SUFFIX,
    PictureKind,
    encode_picture,
)
from photoreg.formats.models.split_vertices import origin_to_write, source_files
from photoreg.formats.writing import NOTHING, Content, check_suffix, write_files
from photoreg.sources import read_regular
from photoreg.texture.bake import TexturedMesh


def save_textured_usdz(
    path: Path | str,
    textured: TexturedMesh,
    picture: PictureKind = "png",
    overwrite: bool = False,
    beside: Mapping[Path, Content] = NOTHING,
) -> list[Path]:
    """Writes the model as one file.

    Args:
        path: Where it goes (.usdz).
        textured: What `bake_texture` returned.
        picture: How the texture is embedded; JPEG is several times smaller.
        overwrite: Whether a file without photoreg's mark may be replaced.
        beside: Other files that are written with it, all or none.

    Returns:
        The file, and others.

    Raises:
        OutputError: if it cannot be written there, or usd-core is not installed.
    """
    path = check_suffix(path, (".usdz",))
    contents = {path: textured_usdz(textured, picture), **beside}
    return write_files(contents, source_files(textured), overwrite)


def check_usd_core() -> None:
    """Raises OutputError if usd-core, which writes USDZ, is not installed."""
    if importlib.util.find_spec("pxr") is None:
        raise OutputError(
            "USDZ is written by the package usd-core, which is not installed: install "
            "photoreg with its extra `usd`, or write a GLB."
        )


def textured_usdz(textured: TexturedMesh, picture: PictureKind = "png") -> bytes:
    """The file of `save_textured_usdz`.

    Raises:
        OutputError: if usd-core is not installed, or could not write it.
    """
    check_usd_core()
    utils: Any = importlib.import_module("pxr.UsdUtils")
    with tempfile.TemporaryDirectory(prefix="photoreg-") as directory:
        folder = Path(directory)
        image = folder / f"texture{PICTURE_SUFFIX[picture]}"
        image.write_bytes(encode_picture(textured.texture, picture))
        layer, package = folder / USDZ_LAYER, folder / "model.usdz"
        _write_layer(layer, image.name, textured)
        if not utils.CreateNewARKitUsdzPackage(str(layer), str(package)):
            raise OutputError("usd-core could not write the USDZ; write a GLB instead.")
        return read_regular(package)


def _write_layer(path: Path, image_name: str, textured: TexturedMesh) -> None:
    # Loaded only here: they take a third of a second.
    usd, geom, gf, vt = (
        importlib.import_module(f"pxr.{name}")
        for name in ("Usd", "UsdGeom", "Gf", "Vt")
    )
    stage: Any = usd.Stage.CreateNew(str(path))
    geom.SetStageUpAxis(stage, geom.Tokens.y)
    geom.SetStageMetersPerUnit(stage, 1.0)
    model = geom.Xform.Define(stage, "/model")
    stage.SetDefaultPrim(model.GetPrim())
    origin = origin_to_write(textured.mesh)
    if origin.any():
        move = model.AddTranslateOp(geom.XformOp.PrecisionDouble)
        move.Set(gf.Vec3d(*map(float, origin)))
    points = (textured.vertices - origin).astype(np.float32)
    mesh = geom.Mesh.Define(stage, "/model/mesh")
    mesh.CreatePointsAttr(vt.Vec3fArray.FromNumpy(points))
    mesh.CreateExtentAttr(
        vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)]))
    )
    counts = np.full(len(textured.faces), 3, dtype=np.int32)
    mesh.CreateFaceVertexCountsAttr(vt.IntArray.FromNumpy(counts))
    corners = np.ascontiguousarray(textured.faces, dtype=np.int32).ravel()
    mesh.CreateFaceVertexIndicesAttr(vt.IntArray.FromNumpy(corners))
    normals = np.ascontiguousarray(textured.mesh.normals_to_keep, dtype=np.float32)
    mesh.CreateNormalsAttr(vt.Vec3fArray.FromNumpy(normals))
    mesh.SetNormalsInterpolation(geom.Tokens.vertex)
    # By default USD rounds a mesh off.
    mesh.CreateSubdivisionSchemeAttr(geom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    _bind_texture(stage, mesh, image_name, textured)
    stage.GetRootLayer().Save()


def _bind_texture(
    stage: Any, mesh: Any, image_name: str, textured: TexturedMesh
) -> None:
    geom, shade, sdf, vt = (
        importlib.import_module(f"pxr.{name}")
        for name in ("UsdGeom", "UsdShade", "Sdf", "Vt")
    )
    types: Any = sdf.ValueTypeNames
    st = geom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", types.TexCoord2fArray, geom.Tokens.faceVarying
    )
    uv = np.ascontiguousarray(textured.atlas.uv, dtype=np.float32)
    st.Set(vt.Vec2fArray.FromNumpy(uv))
    uv_corners = np.ascontiguousarray(textured.atlas.uv_faces, dtype=np.int32).ravel()
    st.SetIndices(vt.IntArray.FromNumpy(uv_corners))

    material = shade.Material.Define(stage, "/model/textured")
    reader = shade.Shader.Define(stage, "/model/textured/st")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    image = shade.Shader.Define(stage, "/model/textured/picture")
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", types.Asset).Set(sdf.AssetPath(image_name))
    image.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
    image.CreateInput("st", types.Float2).ConnectToSource(
        reader.CreateOutput("result", types.Float2)
    )
    # Neither metal nor gloss: viewers show the texture much as it is.
    surface = shade.Shader.Define(stage, "/model/textured/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", types.Float).Set(1.0)
    surface.CreateInput("metallic", types.Float).Set(0.0)
    surface.CreateInput("diffuseColor", types.Color3f).ConnectToSource(
        image.CreateOutput("rgb", types.Float3)
    )
    material.CreateSurfaceOutput().ConnectToSource(
        surface.CreateOutput("surface", types.Token)
    )
    shade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
