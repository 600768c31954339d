"""Textured models; `registry` knows them all."""
