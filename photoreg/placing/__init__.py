"""Cameras found without a click, from outlines and colours; not yet precise."""
