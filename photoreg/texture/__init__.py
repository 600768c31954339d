"""Photos baked into one texture of the mesh."""

from photoreg.texture.bake import BakingStep as BakingStep
from photoreg.texture.bake import TexturedMesh as TexturedMesh
from photoreg.texture.bake import bake_texture as bake_texture
from photoreg.texture.bake import baking as baking
from photoreg.texture.blend import TextureConfig as TextureConfig
