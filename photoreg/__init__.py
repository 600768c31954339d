"""photoreg lays photographs onto a scanned 3-D surface, precisely."""

__version__ = "0.1.0"
