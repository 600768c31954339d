"""The browser app of photoreg. It imports photoreg, never the reverse."""
