"""Whether a value has the type of a field's annotation; no other is read from a project.

A database is untrusted input. Text where a number should be would be passed on until it
breaks something, or runs as a script in a page.
"""

import dataclasses
import functools
import math
import reprlib
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import AbstractArray, jaxtyped

from photoreg.checks import Measured
from photoreg.errors import InputError
from photoreg.names import presentable

INTEGERS = range(-(2**63), 2**64)
"""Integers that can be sent and stored."""

MAX_SHOWN = 60
"""Length to which a wrong value is shown."""

Test = Callable[[Any], bool]


def check_fields(kind: type, content: Mapping[str, Any]) -> None:
    """Checks values that a dataclass is about to be made of.

    Args:
        kind: The dataclass.
        content: Values by the names of their fields.

    Raises:
        InputError: if one is not what its field is declared as.
    """
    hints = _hints(kind)
    # Within it a letter in the shapes of several arrays means one number.
    with jaxtyped("context"):
        for name, value in content.items():
            check_value(value, hints[name], f"{kind.__name__}.{name}")


def check_value(value: Any, hint: Any, name: str) -> None:
    """Checks one value.

    Args:
        value: The value.
        hint: What it should be: a type, a union, a Literal, a tuple, an array.
        name: What it is called.

    Raises:
        InputError: if it is something else.
    """
    if not _test(hint)(value):
        raise InputError(
            f"The project's database is damaged: {name} should be {_words(hint)}, but is "
            f"{_shown(value)}."
        )


def fits(value: Any, hint: Any) -> bool:
    """Whether a value is what an annotation says."""
    return _test(hint)(value)


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind, include_extras=True)


@functools.cache
def _test(hint: Any) -> Test:
    if hint is Any or hint is object:
        return lambda _: True
    if hint == Measured:
        return _is_number
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return _test(parts[0])
    if origin is Literal:
        # Of the same type, too: True is not 1.
        known = {(type(part), part) for part in parts}
        return lambda value: (
            isinstance(value, str | int | bytes | None)
            and (type(value), value) in known
        )
    if origin in (typing.Union, types.UnionType):
        tests = [_test(part) for part in parts]
        return lambda value: any(test(value) for test in tests)
    if origin is tuple and parts[-1] is Ellipsis:
        each = _test(parts[0])
        return lambda value: isinstance(value, tuple) and all(map(each, value))
    if origin is tuple:
        tests = [_test(part) for part in parts]
        return lambda value: (
            isinstance(value, tuple)
            and len(value) == len(tests)
            and all(test(item) for test, item in zip(tests, value, strict=True))
        )
    if origin is not None:
        return lambda value: isinstance(value, origin)
    simple = {float: _is_finite, int: _is_integer, str: _is_text}
    return simple.get(hint) or (lambda value: isinstance(value, hint))


def _is_number(value: Any) -> bool:
    return isinstance(value, float) or _is_integer(value)


def _is_finite(value: Any) -> bool:
    return _is_number(value) and math.isfinite(value)


def _is_integer(value: Any) -> bool:
    return type(value) is int and value in INTEGERS


def _is_text(value: Any) -> bool:
    if not isinstance(value, str):
        return False
    try:
        value.encode()
    except UnicodeEncodeError:  # Half a character can be neither sent nor stored.
        return False
    return True


def _words(hint: Any) -> str:
    simple = {
        float: "a finite number",
        Measured: "a number",
        int: "an integer of at most 64 bits",
        str: "text",
        bool: "true or false",
        bytes: "bytes",
        type(None): "nothing",
        Path: "a path",
    }
    if hint in simple:
        return simple[hint]
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return _words(parts[0])
    if origin is Literal:
        return f"one of {', '.join(map(repr, parts))}"
    if origin in (typing.Union, types.UnionType):
        return " or ".join(map(_words, parts))
    if origin is tuple and parts[-1] is Ellipsis:
        return f"a list of which each is {_words(parts[0])}"
    if origin is tuple:
        return f"{len(parts)} values ({', '.join(map(_words, parts))})"
    if isinstance(hint, type) and issubclass(hint, AbstractArray):
        return f"an array {hint.__name__}"
    return f"a {getattr(hint, '__name__', hint)}"


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} of shape {value.shape}"
    if dataclasses.is_dataclass(value):
        return f"a {type(value).__name__}"
    return presentable(reprlib.repr(value))[:MAX_SHOWN]
