"""A textured model out, in the format of the suffix."""

from collections.abc import Callable
from pathlib import Path

from photoreg.errors import OutputError
from photoreg.formats.glb import save_textured_glb
from photoreg.formats.obj import save_textured_obj
from photoreg.formats.ply import save_coloured_ply, save_textured_ply
from photoreg.texture import TexturedMesh

TEXTURED_FORMATS: dict[str, Callable[[Path, TexturedMesh], list[Path]]] = {
    ".obj": save_textured_obj,
    ".glb": save_textured_glb,
    ".ply": save_textured_ply,
}
"""Suffix to what writes it and returns the files, the model first."""


def save_textured(
    path: Path | str, textured: TexturedMesh, at_vertices: bool = False
) -> list[Path]:
    """Writes a textured model: .obj (with MTL and PNG), .glb or .ply (with PNG).

    Args:
        path: Where the model goes.
        textured: What `bake_texture` returned.
        at_vertices: For .ply: colours at the vertices instead of a texture.

    Returns:
        The files written, the model first.

    Raises:
        OutputError: if the suffix is another, or the files cannot be written there.
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
        save = save_coloured_ply
    return save(path, textured)
