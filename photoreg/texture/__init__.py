"""Photos baked into one texture of the mesh."""

import importlib
from typing import TYPE_CHECKING, Any

from photoreg.texture.config import TextureConfig as TextureConfig

if TYPE_CHECKING:
    from photoreg.texture.bake import BakingStep as BakingStep
    from photoreg.texture.bake import TexturedMesh as TexturedMesh
    from photoreg.texture.bake import bake_texture as bake_texture
    from photoreg.texture.bake import baking as baking


def __getattr__(name: str) -> Any:
    # Lazy, so that the settings can be imported without what bakes.
    if name in ("BakingStep", "TexturedMesh", "bake_texture", "baking"):
        return getattr(importlib.import_module("photoreg.texture.bake"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
