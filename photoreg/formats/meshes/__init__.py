"""Meshes in: one module a format, and what reads by the suffix."""
