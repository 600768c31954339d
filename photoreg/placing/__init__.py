"""Cameras found without a click, from outlines, colours and common points; not yet precise."""
