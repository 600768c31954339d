"""Shapes and types checked at every call, as the annotations of photoreg promise them.

With the environment variable PHOTOREG_CHECK_SHAPES the tests run so. `make test-shapes`
does it for the rooms that are arithmetic. It is too much for every run: 33 s of a
processor instead of 13 for the tests of cameras, rasteriser, photos and resection. The functions that numba compiles are left as they are: it takes plain
functions, and checks the types of what it is given itself.
"""

import inspect
import os
from collections.abc import Callable
from typing import Any

import jaxtyping
import numba
from beartype import BeartypeConf, beartype

# An int will do for a float, as for pyright.
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))


def install() -> None:
    """Has every module of photoreg that is imported from now on checked."""
    if not os.environ.get("PHOTOREG_CHECK_SHAPES"):
        return
    numba.njit = _of_plain_functions(numba.njit)
    jaxtyping.install_import_hook("photoreg", "tests.shape_checks.checked")


def _of_plain_functions(njit: Callable[..., Any]) -> Callable[..., Any]:
    def unwrapping(*args: Any, **options: Any) -> Any:
        if args and callable(args[0]):
            return njit(inspect.unwrap(args[0]), *args[1:], **options)
        compile = njit(*args, **options)
        return lambda function: compile(inspect.unwrap(function))

    return unwrapping
