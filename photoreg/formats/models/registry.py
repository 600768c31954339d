"""A textured model out, in the format of the suffix, to files or into one zip."""

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from photoreg.errors import OutputError
from photoreg.formats.archives import zipped
from photoreg.formats.models.encode_texture import PictureKind
from photoreg.formats.models.glb import save_textured_glb
from photoreg.formats.models.obj import obj_files, save_textured_obj
from photoreg.formats.models.ply import ply_files, save_coloured_ply, save_textured_ply
from photoreg.formats.models.usdz import check_usd_core, save_textured_usdz
from photoreg.formats.writing import NOTHING, Content, check_suffix
from photoreg.texture.bake import TexturedMesh

_Save = Callable[
    [Path, TexturedMesh, PictureKind, bool, Mapping[Path, Content]], list[Path]
]
TEXTURED_FORMATS: dict[str, _Save] = {
    ".obj": save_textured_obj,
    ".glb": save_textured_glb,
    ".ply": save_textured_ply,
    ".usdz": save_textured_usdz,
}
"""Suffix to what writes it and returns the files, the model first."""


def textured_files(
    path: Path | str, at_vertices: bool = False, picture: PictureKind = "png"
) -> list[Path]:
    """The files that `save_textured` will write, the model first.

    Raises:
        OutputError: if the suffix is none that it writes, or what writes it is not
            installed.
    """
    path = check_suffix(path, (".ply",) if at_vertices else tuple(TEXTURED_FORMATS))
    match path.suffix.lower():
        case ".obj":
            return obj_files(path, picture)
        case ".ply" if not at_vertices:
            return ply_files(path, picture)
        case ".usdz":
            check_usd_core()
    return [path]


def save_textured(
    path: Path | str,
    textured: TexturedMesh,
    at_vertices: bool = False,
    picture: PictureKind = "png",
    overwrite: bool = False,
    beside: Mapping[Path, Content] = NOTHING,
) -> list[Path]:
    """Writes a textured model: .obj (with MTL and picture), .glb, .usdz or .ply (with picture).

    Args:
        path: Where the model goes.
        textured: What `bake_texture` returned.
        at_vertices: For .ply: colours at the vertices instead of a texture.
        picture: How the texture is written; JPEG is several times smaller.
        overwrite: Whether files without photoreg's mark may be replaced.
        beside: Other files that are written with it, all or none.

    Returns:
        The files written, the model first.

    Raises:
        OutputError: if the suffix is another, or the files cannot be written there,
            or others are there.
    """
    path = Path(path)
    save = TEXTURED_FORMATS.get(path.suffix.lower())
    if save is None:
        raise OutputError(
            f"Cannot write {path}: its suffix should be "
            f"{' or '.join(TEXTURED_FORMATS)}, but is {path.suffix or 'missing'}."
        )
    if at_vertices:
        if save is not save_textured_ply:
            raise OutputError(
                f"Cannot write {path}: colours at the vertices go into a .ply file."
            )
        return save_coloured_ply(path, textured, overwrite, beside)
    return save(path, textured, picture, overwrite, beside)


def textured_download(
    name: str,
    textured: TexturedMesh,
    at_vertices: bool = False,
    picture: PictureKind = "png",
) -> tuple[str, bytes]:
    """What `save_textured` writes as one file for a download: zipped if there are more.

    Args:
        name: File name of the model, with suffix.
        textured: What `bake_texture` returned.
        at_vertices: As in `save_textured`.
        picture: As in `save_textured`.

    Returns:
        The download's file name and bytes.
    """
    with tempfile.TemporaryDirectory(prefix="photoreg-") as folder:
        files = save_textured(Path(folder) / name, textured, at_vertices, picture)
        if len(files) == 1:
            return name, files[0].read_bytes()
        archive = zipped(Path(folder), files)
    return f"{Path(name).stem}-textured.zip", archive
