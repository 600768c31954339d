"""Textured GLB (binary glTF 2.0), the texture within."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import trimesh
import trimesh.visual
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial

from photoreg.formats.mark import GENERATOR
from photoreg.formats.models.encode_texture import PictureKind, encode_picture
from photoreg.formats.models.split_vertices import (
    origin_to_write,
    source_files,
    split_at_seams,
)
from photoreg.formats.writing import NOTHING, Content, check_suffix, write_files
from photoreg.texture.bake import TexturedMesh


@dataclasses.dataclass(frozen=True)
class _EncodedPicture:
    """What trimesh takes for an image: saved as it was encoded, not once more."""

    format: str
    content: bytes

    def save(self, file: IO[bytes], format: str) -> None:
        """Writes the bytes; the format is the one they have."""
        del format
        file.write(self.content)


def save_textured_glb(
    path: Path | str,
    textured: TexturedMesh,
    picture: PictureKind = "png",
    overwrite: bool = False,
    beside: Mapping[Path, Content] = NOTHING,
) -> list[Path]:
    """Writes the model as one file.

    The mesh's vertices come first and in their order, then those doubled along seams.
    glTF holds coordinates in single precision: where they are large for the mesh's
    size, they are written from its middle, and a node moves them back.

    Args:
        path: Where it goes (.glb).
        textured: What `bake_texture` returned.
        picture: How the texture is embedded; JPEG is several times smaller.
        overwrite: Whether a file without photoreg's mark may be replaced.
        beside: Other files that are written with it, all or none.

    Returns:
        The file, and others.

    Raises:
        OutputError: if it cannot be written there.
    """
    path = check_suffix(path, (".glb",))
    contents = {path: textured_glb(textured, picture), **beside}
    return write_files(contents, source_files(textured), overwrite)


def textured_glb(textured: TexturedMesh, picture: PictureKind = "png") -> bytes:
    """The file of `save_textured_glb`, for a download."""
    vertex_index, uv, faces = split_at_seams(textured)
    mesh = textured.mesh
    origin = origin_to_write(mesh)
    model = trimesh.Trimesh(
        mesh.vertices[vertex_index] - origin,
        faces,
        vertex_normals=mesh.normals_to_keep[vertex_index],
        visual=trimesh.visual.TextureVisuals(uv, _material(textured, picture)),
        process=False,
        validate=False,
    )
    move = np.eye(4)
    move[:3, 3] = origin
    scene = trimesh.Scene()
    scene.add_geometry(model, node_name="model", geom_name="model", transform=move)
    return export_glb(scene, include_normals=True, tree_postprocessor=_signed)


def _signed(document: dict[str, Any]) -> None:
    document["asset"]["generator"] = GENERATOR


def _material(textured: TexturedMesh, picture: PictureKind) -> PBRMaterial:
    image = _EncodedPicture(picture.upper(), encode_picture(textured.texture, picture))
    # Neither metal nor gloss: viewers show the texture much as it is.
    return PBRMaterial(
        name="textured",
        baseColorTexture=image,
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
