"""Camera and mesh files of photoreg and of other programs, one module a format."""
