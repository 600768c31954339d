"""`photoreg texture`."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from photoreg.cli.console import log, print_json, progress_bar
from photoreg.cli.scene import MeshPath, PhotoPaths, load_told
from photoreg.cli.stopping import asked_to_stop
from photoreg.formats.models.encode_texture import PictureKind, encode_picture
from photoreg.formats.models.registry import save_textured, textured_files
from photoreg.formats.writing import Content, check_outputs, check_suffix
from photoreg.imaging.photo import Photo
from photoreg.registration.texture_doubts import (
    check_cameras_of_texture,
    doubts_about_texture,
)
from photoreg.texture.bake import BakingStep, TexturedMesh, baking
from photoreg.texture.config import TextureConfig
from photoreg.words import percent


def texture_command(
    mesh: MeshPath,
    photos: PhotoPaths,
    /,
    *,
    cameras: Path,
    out: Path,
    at_vertices: bool = False,
    picture: PictureKind = "png",
    coverage: Path | None = None,
    overwrite: bool = False,
    config: Annotated[TextureConfig, tyro.conf.arg(name="")] = TextureConfig(),
    json: bool = False,
) -> int:
    """Lay the photos onto the mesh: a textured OBJ, GLB, USDZ or PLY.

    Args:
        mesh: The scanned surface.
        photos: The photos to lay onto it.
        cameras: Their refined cameras, in any format that `photoreg convert` reads.
        out: Where the model goes: .glb or .usdz (extra `usd`), all in one file; .obj, with
            MTL and PNG beside it; .ply, with a PNG.
        at_vertices: For .ply: colours at the vertices instead of a texture.
        picture: The texture as PNG, or as JPEG, which is several times smaller.
        coverage: Also write a picture (.png) of which photo each texel is from (hue) and
            how well it is seen (brightness).
        overwrite: Also replace files that photoreg did not make.
        config: How the texture is made.
        json: Print the figures as JSON on standard output.
    """
    targets = textured_files(out, at_vertices, picture)
    if coverage is not None:
        targets.append(check_suffix(coverage, (".png",)))
    check_outputs(targets, (mesh, *photos, cameras), overwrite)
    surface, pictures, _, exact = load_told(mesh, photos, cameras)
    verdict = check_cameras_of_texture(surface, pictures, exact)
    # Once more: the mesh may have named a material and a texture of its own.
    check_outputs(targets, (mesh, *photos, cameras), overwrite)
    began = time.perf_counter()
    with progress_bar() as bar, asked_to_stop() as stop:
        task = bar.add_task("getting ready", total=1.0, told="")
        textured = None
        for textured in baking(surface, pictures, exact, config):
            if isinstance(textured, BakingStep):
                bar.update(
                    task, completed=textured.fraction, description=textured.title
                )
                if stop.is_set():
                    log.print("Stopped. Nothing was written.")
                    return 1
    assert isinstance(textured, TexturedMesh)
    beside: dict[Path, Content] = {}
    if coverage is not None:
        beside[coverage] = encode_picture(textured.coverage_picture())
    written = save_textured(out, textured, at_vertices, picture, overwrite, beside)
    elapsed_s = time.perf_counter() - began
    height, width = textured.texture.shape[:2]
    log.print(
        f"{percent(textured.seen_share)} of the surface is painted from photos "
        f"({_shares(pictures, textured)}). Texture "
        f"{width}x{height}, {textured.layout_in_words}, {elapsed_s:.1f} s. "
        f"Written: {', '.join(str(path) for path in written)}."
    )
    for doubt in doubts_about_texture(textured, pictures, exact, verdict):
        log.print(f"Warning: {doubt}", markup=False)
    if told := _left_out(pictures, textured):
        log.print(told)
    if json:
        print_json(
            {
                "files": [str(path) for path in written],
                "texture": [width, height],
                "own_uv": textured.atlas.is_own,
                "seen_share": textured.seen_share,
                "seen_share_by_photo": dict(
                    zip(
                        (photo.name for photo in pictures),
                        textured.seen_share_by_photo,
                        strict=True,
                    )
                ),
                "left_out_share_by_photo": dict(
                    zip(
                        (photo.name for photo in pictures),
                        textured.left_out_share_by_photo,
                        strict=True,
                    )
                ),
                "elapsed_s": elapsed_s,
            }
        )
    return 0


def _shares(photos: Sequence[Photo], textured: TexturedMesh) -> str:
    shares = zip(photos, textured.seen_share_by_photo, strict=True)
    return ", ".join(f"{photo.name} {percent(share)}" for photo, share in shares)


def _left_out(photos: Sequence[Photo], textured: TexturedMesh) -> str:
    """What was not painted because other photos disagree; empty if nothing."""
    shares = zip(photos, textured.left_out_share_by_photo, strict=True)
    parts = [f"{photo.name} {percent(share)}" for photo, share in shares if share > 0.0]
    if not parts:
        return ""
    return (
        "Not painted, because other photos show something else there, for instance where "
        f"something is in front of the object: {', '.join(parts)} of what each photo sees."
    )
