"""Lay photos with known cameras onto the mesh, and write one GLB file."""

from photoreg import load_cameras, load_mesh, load_photo
from photoreg.formats.models.registry import save_textured
from photoreg.texture import TextureConfig, bake_texture

mesh = load_mesh("shell.ply")
photos = [load_photo("shell-left.jpg"), load_photo("shell-right.jpg")]
cameras = load_cameras("cameras.json").of_photos(photos)
textured = bake_texture(mesh, photos, cameras, TextureConfig(size=1024))
print(f"{100 * textured.seen_share:.0f} % of the surface is seen by a photo.")
save_textured("shell.glb", textured)
