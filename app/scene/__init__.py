"""The state written into viser's 3-D scene."""
