"""Files of photoreg and of other programs, read and written, one module a format."""
