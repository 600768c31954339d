"""The exceptions photoreg raises on purpose.

    PhotoregError
    ├── InputError       what was given cannot be used: a file, an array, a setting
    ├── OutputError      the result cannot be written where it was asked for
    └── RefinementError  the search cannot start or go on with these inputs

Each message is one sentence or two for the person who asked: what was expected,
what came, where, and what to do.
"""


class PhotoregError(Exception):
    """Base of every error that photoreg raises on purpose."""


class InputError(PhotoregError):
    """What was given cannot be used: a file, an array or a setting."""


class OutputError(PhotoregError):
    """The result cannot be written where it was asked for."""


class RefinementError(PhotoregError):
    """The search cannot start, or cannot go on, with these inputs."""
