"""The textured model: baked step by step, packed for download, and previewed."""

import dataclasses
import time
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np

from app.engine.glb_file import GlbFile
from app.model.camera_moves import DisplayFrame
from app.model.messages import Bake, Baked, Download, Working
from app.model.state import ModelChoice, Texture
from photoreg.errors import InputError
from photoreg.formats.models.registry import textured_download
from photoreg.geometry.camera import same_camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.encoding import encode_jpeg
from photoreg.imaging.photo import Photo
from photoreg.registration.texture_doubts import (
    check_cameras_of_texture,
    doubts_about_texture,
)
from photoreg.texture.atlas import Atlas, make_atlas
from photoreg.texture.bake import BakingStep, TexturedMesh, baking
from photoreg.words import percent

PREVIEW_SIDE_PX = 4096
"""Texels of the preview's longer side at most; software WebGL ends at 8192."""

PREVIEW_QUALITY = 90
COVERAGE_SIDE_PX = 560
"""Twice the width of the panel, for screens of fine pixels."""


class BakeJob:
    """Bakes textures; keeps the last, and the charts of the mesh, which take longest."""

    def __init__(self) -> None:
        self._mesh: Mesh | None = None
        self._keep_uv = True
        self._atlas: Atlas | None = None
        self._textured: TexturedMesh | None = None
        self._made_with = Bake(())

    def bake(
        self,
        mesh: Mesh,
        photos: Sequence[Photo],
        job: Bake,
    ) -> Generator[Working | Baked]:
        """Bakes, telling what comes next; the last event is the model.

        Whoever stops iterating ends it; the model made before is then still there.

        Raises:
            InputError: if the cameras are of another world than the mesh.
        """
        cameras, config, began = job.cameras, job.config, time.monotonic()
        yield Working("Looking at the cameras", 0.01)
        verdict = check_cameras_of_texture(mesh, photos, cameras)
        made_for = self._mesh, self._keep_uv
        if self._atlas is None or made_for != (mesh, config.keep_uv):
            yield Working("Unfolding the surface", 0.02)
            self._atlas = make_atlas(mesh, config.keep_uv)
            self._mesh, self._keep_uv = mesh, config.keep_uv
        for step in baking(mesh, photos, cameras, config, self._atlas):
            if isinstance(step, BakingStep):
                yield Working(step.title, step.fraction)
            else:
                yield Working("Making the preview", 0.95)
                doubts = doubts_about_texture(step, photos, cameras, verdict)
                texture = _texture(step, photos, job, tuple(doubts))
                self._textured, self._made_with = step, job
                took_s = time.monotonic() - began
                yield Baked(dataclasses.replace(texture, took_s=took_s))

    def has(self, mesh: Mesh, job: Bake) -> bool:
        """Whether the model made last is of this mesh, and was made like this."""
        if self._textured is None:
            return False
        known, before = self._textured.mesh, self._made_with
        return (
            (job.config, job.masks) == (before.config, before.masks)
            and len(before.cameras) == len(job.cameras)
            and all(map(same_camera, before.cameras, job.cameras))
            and np.array_equal(known.vertices, mesh.vertices)
            and np.array_equal(known.faces, mesh.faces)
        )

    def pack(self, choice: ModelChoice) -> Download:
        """The model made last as one file for download.

        Raises:
            InputError: if there is none.
        """
        textured = self._textured
        if textured is None:
            raise InputError("There is no texture. Make it first.")
        at_vertices = choice.format == "coloured ply"
        suffix = ".ply" if at_vertices else f".{choice.format}"
        name = f"{Path(textured.mesh.name).stem or 'model'}{suffix}"
        return Download(*textured_download(name, textured, at_vertices, choice.picture))


def _texture(
    textured: TexturedMesh,
    photos: Sequence[Photo],
    job: Bake,
    doubts: tuple[str, ...],
) -> Texture:
    height, width = textured.texture.shape[:2]
    filled = {
        "diffuse": "filled from its neighbours",
        "colour": "in the colour chosen",
        "own": "in the model's own colours",
    }[job.config.unseen]
    summary = (
        f"Texture of {width} × {height} px, {textured.layout_in_words}. The photos cover "
        f"{percent(textured.seen_share)} of the surface; the rest is {filled}."
    )
    coverage = tuple(
        (photo.name, share, colour)
        for photo, share, colour in zip(
            photos, textured.seen_share_by_photo, textured.coverage_colours, strict=True
        )
    )
    picture = encode_jpeg(
        textured.coverage_picture(), PREVIEW_QUALITY, COVERAGE_SIDE_PX
    )
    return Texture(
        preview_glb(textured),
        job.cameras,
        job.config,
        summary,
        picture,
        coverage,
        doubts,
        masks=job.masks,
    )


def preview_glb(textured: TexturedMesh) -> bytes:
    """The model in page axes as a GLB file, with a JPEG texture, drawn without light.

    The photos hold the light of the place already; lit again they would look wrong.
    """
    atlas, frame = textured.atlas, DisplayFrame.of(textured.mesh)
    file = GlbFile()
    attributes = {
        "POSITION": file.positions(
            frame.to_page(textured.mesh.vertices)[atlas.uv_vertex]
        ),
        # glTF's v runs downwards.
        "TEXCOORD_0": file.floats(
            np.column_stack([atlas.uv[:, 0], 1 - atlas.uv[:, 1]])
        ),
    }
    material = file.picture(
        encode_jpeg(textured.texture, PREVIEW_QUALITY, PREVIEW_SIDE_PX)
    )
    file.primitive(attributes, atlas.uv_faces, material)
    return file.content()
