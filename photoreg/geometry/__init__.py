"""Where things are and what sees what: cameras, meshes, rays, rasters."""
