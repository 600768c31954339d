"""Meshes in: one module a format, and what reads by the suffix."""

from photoreg.formats.meshes.read import MESH_SUFFIXES as MESH_SUFFIXES
from photoreg.formats.meshes.read import load_mesh as load_mesh
